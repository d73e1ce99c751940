//! Rays against triangles: closest hits and occlusion, exact to the last tie.
//!
//! obvhs builds a binary tree (its CWBVH loses rays that start on axis-aligned walls); eight-wide nodes are made of it, and
//! triangles are tested by the watertight test of \[Woop2013\], so that nothing leaks between two triangles that share an
//! edge. Vectors come from fearless_simd: AVX-512, AVX2 or less, found at run time.

mod count;
mod lanes;
mod tracer;
mod tree;
mod vectors;
mod watertight;

pub mod sampling;

pub use count::{RayCount, counted, linking};
pub use tracer::{AlphaTest, Hit, Tracer};
pub use vectors::Vectors;
