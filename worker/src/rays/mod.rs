//! Rays against triangles: closest hits and occlusion, exact to the last tie.
//!
//! Nodes come from obvhs' BVH2 (its CWBVH loses rays that start on axis-aligned walls); triangles are tested by the
//! watertight test of \[Woop2013\], so that nothing leaks between two triangles that share an edge.

mod count;
mod tracer;
mod watertight;

pub mod sampling;

pub use count::{RayCount, counted, linking};
pub use tracer::{AlphaTest, Hit, Tracer};
