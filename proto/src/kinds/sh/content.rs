//! Probes and what their relight rays meet, decoded.

use serde::{Deserialize, Serialize};

use crate::content::{BlockKey, Texel};

/// Identity of a probe: first eight bytes of the digest of its lattice cell.
pub type ProbeKey = u64;

/// A batch of probes and what their relight rays meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeBatch {
    /// Probes, ascending by key.
    pub probes: Vec<Probe>,
    /// Relight rays per probe K; directions are [`crate::harmonics::relight_direction`].
    pub relight_rays: u32,
    /// Blocks that hits name.
    pub blocks: Vec<BlockKey>,
    /// Hits, probe-major: `hits[p·K + k]`.
    pub hits: Vec<RelightHit>,
}

/// A probe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    /// Identity.
    pub key: ProbeKey,
    /// Position in metres.
    pub position_m: [f32; 3],
    /// Support radius in metres.
    pub radius_m: f32,
}

/// Surface that a relight ray meets, or the sky.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RelightHit {
    /// A receiver: index into the batch's `blocks`, and its texel there.
    Receiver {
        /// Index into [`ProbeBatch::blocks`].
        block: u16,
        /// Texel in the block. Where no cluster has a receiver of it, no light reaches it: it counts as dark.
        texel: Texel,
    },
    /// Nothing: the sky.
    Sky,
    /// The back of a single-sided surface or a surface without receivers: no radiance.
    Dark,
}
