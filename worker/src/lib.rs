//! Lightkiln's bake maths.
pub mod assemble;
pub mod draw;
pub mod emitters;
pub mod evaluate;
pub mod factors;
pub mod geometry;
pub mod kinds;
pub mod lightmap;
pub mod patches;
pub mod rays;
pub mod reference;
pub mod runtime;
pub mod scene;
pub mod task;
pub mod transport;
pub mod unwrap;
pub mod vantage;
