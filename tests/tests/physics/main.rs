//! The eight checks of a right bake (METHOD.md §4), on scenes of our own at small size, with either kind.
//!
//! Where the right answer is not known in closed form, it is the path tracer's at the same receivers: tolerances are of the
//! bake, and three standard errors of the reference come on top. Every test also asserts that the light it looks for is
//! there.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers of tests too")]

mod captured;
mod cavities;
mod contact;
mod corridor;
mod determinism;
mod edits;
mod energy;
mod field;
mod first_light;
mod glass;
mod leaks;
mod narrow;
mod pixels;
mod rims;
mod scale;
mod seams;
mod setup;
mod shown;
mod slopes;
mod smallest;
mod stripes;
mod transfer;
mod transforms;
mod voxels;
