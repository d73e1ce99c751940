//! Run time of relightable bakes on the processor.

pub mod reconstruct;

pub use crate::content::*;
pub use crate::kinds::sh::{Probe, ProbeBatch, ProbeKey, RelightHit};
