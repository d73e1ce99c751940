//! The relightable bake (METHOD.md §2): import → prepare → relight, transport → assemble.
//!
//! Every task is a pure function of its inputs. A receiver's or probe's random numbers come from its identity, sums
//! run in a fixed order, so the bytes do not depend on threads, workers or the order of tasks.

pub mod artefact;
mod assemble;
pub mod factor;
mod import;
mod prepare;
mod rebuild;
mod relight;
mod runner;
pub mod stage;
mod transport;
mod world;

pub use runner::PrtRunner;
pub(crate) use transport::{CellRows, Detail, Piece, Row, pieces, rows};
pub use world::{Geometry, Surface, World};
pub(crate) use world::{corners_of, weights_of};
