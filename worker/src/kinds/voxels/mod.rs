//! Voxels of a scene: elements by region and, of coarser levels, of all of it (METHOD.md §2.16).
//!
//! `voxels.region` for each cube with surfaces, and `voxels.top`, beside a kind's other tasks; each leaves a record of what it read, and a
//! later task takes its chunk over while that is as it was.

mod alone;
mod elements;
mod evaluated;
mod overlap;
mod plan;
mod sides;
mod task;
mod touches;

pub use alone::Voxels;
pub use evaluated::{DIRECTIONS, WalkedBake};
pub use plan::planned;
pub use task::{chunks, run, totals};
