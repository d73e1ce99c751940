//! Lightkiln's bake maths.
pub mod evaluate;
pub mod prt;
pub mod rays;
pub mod reference;
pub mod runtime;
pub mod scene;
pub mod task;
pub mod unwrap;
