//! What Lightkiln is tested with: scenes of our own, and the harness that bakes them.

pub mod harness;
pub mod scenes;
