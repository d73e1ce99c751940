//! Level of detail of baked light by distance and view ([Sedlacek2019] §4.2, for patches): fewer columns, ranks, receivers and
//! bounces where the eye is far. We differ: receivers that are left out take the mean of coarser ones beside them on their side of all
//! walls, in the array of all receivers, so that patches, near hits and lightmaps read them as any other; and two levels of receivers
//! are blended in that array instead of at fragments. Columns, rank and interval change by whole cluster.
//!
//! ```text
//! plan       each cluster's level by the distance of its bounds  →  Detail: columns, ranks, rows, interval
//! bounce n   clusters with (n + index) % interval = 0 alone:  b_c of their columns, E_r of their rows
//! fill       level by level, coarsest first:  E_r ← mix(E_r, mean of E over its stand-ins, share)
//! ```
//! The share is 1 for rows that are left out, else by the receiver's own distance, so that it is 1 where a cluster of the next level
//! may begin.

mod bounce;
mod plan;
mod settings;
mod table;
#[cfg(test)]
mod tests;

pub(super) use bounce::BounceArrays;
pub use plan::{LevelCount, LodEye, LodPlan, LodView};
pub use settings::{LOD_LEVELS, Lod, LodDistance, LodError, LodLevel, MAX_INTERVAL};
pub use table::{LodTable, NO_STAND_IN, StandIn};

use super::Cluster;

/// The part of a cluster that bounces compute, as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Detail {
    /// Slot of its first receiver.
    pub first_row: u32,
    /// Its receivers.
    pub row_count: u32,
    /// Receivers that are computed: the first of its order in [`LodTable::order`].
    pub rows: u32,
    /// Wide columns of ΣVᵀ: the first.
    pub wide: u32,
    /// Columns of 8 bits: the first behind all wide ones.
    pub bytes: u32,
    /// Columns of 4 bits: the first behind all those of 8.
    pub rest: u32,
    /// Groups of ranks: the first.
    pub groups: u32,
    /// Receivers below this level are left out.
    pub level: u32,
    /// Bounces from one that it takes part in to the next.
    pub interval: u32,
}

impl Detail {
    /// All of a cluster, in each bounce.
    pub fn full(cluster: &Cluster) -> Self {
        let [wide, bytes, rest] = cluster.classes().map(|class| class.len() as u32);
        let row_count = cluster.row_count as u32;
        Self {
            first_row: cluster.first_row as u32,
            row_count,
            rows: row_count,
            wide,
            bytes,
            rest,
            groups: cluster.groups() as u32,
            level: 0,
            interval: 1,
        }
    }

    /// Whether the cluster at `index` takes part in a bounce.
    pub fn is_due(&self, index: usize, bounce: u32) -> bool {
        bounce.wrapping_add(index as u32).is_multiple_of(self.interval.max(1))
    }

    /// Columns that count.
    pub fn columns(&self) -> u32 {
        self.wide + self.bytes + self.rest
    }
}
