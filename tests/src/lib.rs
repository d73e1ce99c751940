//! Means of testing Lightkiln: scenes of our own, the harness that bakes them, measured studies, and a model of large farms.

pub mod ambient;
pub mod harness;
pub mod scale;
pub mod scenes;
pub mod studies;
