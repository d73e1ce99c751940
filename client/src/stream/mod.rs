//! Light that comes piece by piece: first a bake's overview, then its clusters, those first that the picture needs most.

mod need;

use glam::Vec3;

pub use need::{Candidate, Lit, by_need};

/// Bytes of a bake's light that have come: its directory, and chunks but for meshes and textures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Streamed {
    /// Bytes so far.
    pub bytes: u64,
    /// Bytes of all.
    pub bytes_all: u64,
    /// Clusters so far, without those of the overview.
    pub clusters: usize,
    /// All clusters.
    pub clusters_all: usize,
}

/// Point of view that light is fetched for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// The eye, in metres.
    pub eye_m: Vec3,
    /// Unit direction of the view.
    pub forward: Vec3,
}
