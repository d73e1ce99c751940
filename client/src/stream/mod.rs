//! Light that comes piece by piece: first a bake's overview, then layers of its clusters, those first that the picture needs most, within
//! budgets of bytes and memory.

mod need;
mod plan;

use glam::Vec3;
use serde::Serialize;

pub use need::{Candidate, Lit, Rung, Step, by_need};
pub use plan::{Budget, Plan, plan};

/// Bytes of a bake's light that are there: its directory, and chunks but for meshes and textures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Streamed {
    /// Bytes so far.
    pub bytes: u64,
    /// Bytes of all.
    pub bytes_all: u64,
    /// Clusters that are there with some of their layers, without those of the overview.
    pub clusters: usize,
    /// Clusters that are there with all of their layers.
    pub whole: usize,
    /// All clusters.
    pub clusters_all: usize,
    /// Other chunks of light that come after clusters, and have not.
    pub rest: usize,
    /// Clusters of a bake under way whose bytes the server has lost: they come once they are baked again. Those of a cell whose page is
    /// lost are not known: the cell counts as one that is not baked.
    pub lost: usize,
    /// Memory that the light takes when it is lit, about, in bytes.
    pub memory: u64,
    /// Memory of all of it.
    pub memory_all: u64,
    /// Memory of the part that always stays.
    pub memory_least: u64,
    /// Progress of a bake under way, of whose light more is to come than is told here; none of one that is done.
    pub baked: Option<Baked>,
    /// Times that layers came or went.
    pub turns: u64,
}

impl Streamed {
    /// All is there.
    pub fn is_whole(&self) -> bool {
        self.baked.is_none() && self.whole == self.clusters_all && self.rest == 0
    }
}

/// Progress of a bake under way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Baked {
    /// Cells whose clusters are baked.
    pub cells: u64,
    /// All cells.
    pub cells_all: u64,
}

/// Point of view that light is fetched for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    /// The eye, in metres.
    pub eye_m: Vec3,
    /// Unit direction of the view.
    pub forward: Vec3,
}
