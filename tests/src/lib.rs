//! Means of testing Lightkiln: scenes of our own, the harness that bakes them, and measured studies.

pub mod ambient;
pub mod harness;
pub mod scenes;
pub mod studies;
