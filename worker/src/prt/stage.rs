//! The stage: everything that relight and transport tasks share besides the scene itself.

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::prt::{BlockKey, Probe, Texel};
use serde::{Deserialize, Serialize};

use crate::unwrap::Unwrap;

/// Magic of the stage artefact.
pub const MAGIC: &[u8; 4] = b"LKst";
/// No receiver, in [`StageBlock::receiver_of_texel`].
pub const NO_RECEIVER: u32 = u32::MAX;

/// What prepare gives to the tasks that it plans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// Imported scene that it belongs to.
    pub scene: Digest,
    /// Texel size in metres.
    pub texel_m: f32,
    /// Probe spacing in metres.
    pub probe_spacing_m: f32,
    /// Unwrap of each mesh instance.
    pub unwraps: Vec<Unwrap>,
    /// Index of the first block of each instance; its blocks follow part by part, front before back.
    pub first_block: Vec<u32>,
    /// Blocks.
    pub blocks: Vec<StageBlock>,
    /// Receivers, block by block in raster order.
    pub receivers: Vec<Receiver>,
    /// Probes, ascending by key.
    pub probes: Vec<Probe>,
    /// Receivers of each cluster cell.
    pub clusters: Vec<ClusterCell>,
}

/// The receivers of one side of one part of an instance's unwrap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageBlock {
    /// Identity: digest of path, part and side.
    pub key: BlockKey,
    /// Path, part and side in words.
    pub name: String,
    /// Width and height in texels.
    pub size: [u32; 2],
    /// Instance.
    pub instance: u32,
    /// Receiver that stands for each texel, row by row; [`NO_RECEIVER`] where the block is empty.
    pub receiver_of_texel: Vec<u32>,
}

/// A receiver r (METHOD.md §1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Receiver {
    /// Index into [`Stage::blocks`].
    pub block: u32,
    /// Texel in the block.
    pub texel: Texel,
    /// x_r: on the surface, or shifted out of geometry, in metres.
    pub position_m: Vec3,
    /// n_r: unit shading normal of the lit side.
    pub normal: Vec3,
    /// Unit normal of the triangle, of the lit side.
    pub face_normal: Vec3,
    /// ρ, linear, below 1.
    pub albedo: [f32; 3],
    /// Lₑ in W·m⁻²·sr⁻¹.
    pub emission: [f32; 3],
    /// Bits of `lightkiln_proto::prt::LINKS`.
    pub links: u8,
}

/// A world-aligned cell of receivers that are factorised together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClusterCell {
    /// Lower and upper corner in metres; the upper one is outside.
    pub bounds_m: [Vec3; 2],
    /// Ascending receiver indices.
    pub receivers: Vec<u32>,
}
