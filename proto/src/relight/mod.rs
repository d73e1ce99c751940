//! The run time of baked light on the processor: the normative form of the client's passes, as pure functions over flat
//! arrays in a fixed order of summation (METHOD.md §2.9, §2.10).
//!
//! ```text
//! L_r  = ρ_r/π · (E_dir + E_emit + E_ind)           radiance      of receiver r
//! λ    = mean of L over each patch, or 4π/K Σ L Y_j  Columns       numbers that a cluster's columns read
//! b_c  = s (ΣVᵀ) λ|_c                                basis         k numbers a cluster; s, U's steps, in them
//! N_r  = w_r Σ_y ρ/π · (E_dir(y) + E_emit + E_ind)   gather        from near hits
//! N_r += w Σ ±λ                                     walked        from the ends of walks, of receivers that have some
//! E_r  = max(N_r + U_r · b_c, −E_emit)               reconstruct   E_ind at receivers, W·m⁻²
//! ```
//! Receivers have **slots**: the clusters' receivers one after the other, in the manifest's order. Chunks name a
//! receiver by block and texel; [`Transport::join`] resolves every name to its slot, once.
//!
//! Emission is left out of L, as its irradiance is baked with its own shadows. Linear RGB stands in the first three
//! components of a [`Vec4`], the fourth is 0, so that adapters read the arrays as they are.
//!
//! ```
//! use lightkiln_proto::content::{ClusterTransport, PatchSet, Receivers, TexelEdge};
//! use lightkiln_proto::relight::{Incoming, Limit, PatchTable, Serial, Transport};
//!
//! let receivers = Receivers {
//!     blocks: vec![7],
//!     block: vec![0],
//!     texel: vec![[0, 0]],
//!     position_m: vec![[0.0; 3]],
//!     normal: vec![[0.0, 1.0, 0.0]],
//!     albedo: vec![[0.5; 3]],
//!     links: vec![0],
//!     coverage: vec![u16::MAX],
//!     edge: vec![TexelEdge::NONE],
//!     ..Receivers::default()
//! };
//! let cluster = ClusterTransport { receivers, ..ClusterTransport::default() };
//! let patches = PatchSet { leaf_starts: vec![0], ..PatchSet::default() };
//! let columns = |slots: &_| PatchTable::new(&patches, slots);
//! let transport = Transport::join([(7, [1, 1])], 0, &[cluster], columns).unwrap();
//! let lamp = transport.receivers.normal.clone();
//! let incoming = Incoming { dir: &lamp, near: &[], sky: Default::default(), panorama: None, emitter_scale: &[], ..Incoming::default() };
//! let settled = transport.settle(&Serial, &incoming, Limit::default());
//! assert!(settled.converged && settled.ind.len() == 1);
//! ```

mod clusters;
mod lod;
mod near;
mod packed;
mod panorama;
mod panorama_image;
mod parallel;
mod patches;
mod receivers;
mod settle;
mod sky;
mod sky_rows;
mod slots;
mod stand_ins;
mod taps;
mod texels;
mod transport;
mod walked;

#[cfg(test)]
pub(crate) mod tests;

use std::f32::consts::FRAC_1_PI;

use glam::Vec4;
use thiserror::Error;

pub use clusters::{Cluster, ClusterTable, Column, EmitterPart, EmitterTable, MAX_RANK};
pub use lod::{
    Detail, LOD_LEVELS, LevelCount, Lod, LodDistance, LodError, LodEye, LodLevel, LodPlan, LodTable, LodView,
    MAX_INTERVAL, NO_STAND_IN, StandIn,
};
pub use near::{NearHit, NearRow, NearTable, OWN_SURFACE, OwnSurface};
pub use packed::Packing;
pub use panorama::Panorama;
pub use panorama_image::{PANORAMA_PIXELS_MAX, PanoramaImage};
pub use parallel::{Parallel, Serial};
pub use patches::{LEAF_BLOCK, NO_PATCH, PatchRow, PatchTable};
pub use receivers::{MAX_RECEIVERS, ReceiverTable};
pub use settle::{Incoming, Limit, Settled};
pub use sky::Sky;
pub use sky_rows::SkyRows;
pub use slots::{DARK, MAX_TEXELS, SlotTable};
pub use stand_ins::{CoarsePatches, STAND_IN_LEVEL, stand_in};
pub use taps::{Taps, TexelKind, tap_weights};
pub use texels::{EXTENSION_TEXELS, LightmapTexels, taps_around};
pub use transport::{ALWAYS, Columns, DirectAt, Transport};
pub use walked::{Ends, TAKEN, WalkedRow, WalkedTable};

/// Chunks that contradict the manifest or each other, or exceed a limit.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{place}: {problem}")]
pub struct Inconsistent {
    /// Block or chunk.
    pub place: String,
    /// The contradiction.
    pub problem: String,
}

impl Inconsistent {
    /// A contradiction at a place.
    pub fn new(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { place: place.into(), problem: problem.into() }
    }
}

/// Irradiance at receivers by slot, in W·m⁻².
#[derive(Clone, Copy, Debug)]
pub struct Irradiance<'a> {
    /// From lights, E_dir.
    pub dir: &'a [Vec4],
    /// Straight from emissive surfaces, E_emit.
    pub emit: &'a [Vec4],
    /// From everything else, E_ind, of the bounce before.
    pub ind: &'a [Vec4],
}

impl Irradiance<'_> {
    /// `L = ρ/π · (E_dir + E_emit + E_ind)` of the receiver at `slot`, W·m⁻²·sr⁻¹; 0 past the last slot, as for [`DARK`].
    pub fn radiance(&self, receivers: &ReceiverTable, slot: u32) -> Vec4 {
        let slot = slot as usize;
        match receivers.albedo.get(slot) {
            None => Vec4::ZERO,
            Some(albedo) => *albedo * FRAC_1_PI * (self.dir[slot] + self.emit[slot] + self.ind[slot]),
        }
    }
}

fn four([x, y, z]: [f32; 3]) -> Vec4 {
    Vec4::new(x, y, z, 0.0)
}
