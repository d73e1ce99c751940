//! Decoded content of chunks that kinds of bake share: plain arrays in the notation of METHOD.md §2.

mod cluster;
mod drawing;
mod near;
mod patches;
mod receivers;

pub use cluster::{ClusterTransport, ColumnKey, EmitterIrradiance, FactorSteps, TransportFactors};
pub use drawing::{Draw, Geometry};
pub use near::{NearHits, NearSurface};
pub use patches::{AreaCode, Patch, PatchKey, PatchSet};
pub use receivers::{BlockKey, COVERAGE_POINTS, COVERAGE_SIDE, LINKS, Receivers, Texel, TexelEdge};
