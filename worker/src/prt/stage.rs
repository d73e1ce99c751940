//! The stage: everything that relight and transport tasks share besides the scene itself.

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::prt::{AreaCode, BlockKey, PatchKey, Probe, Texel};
use serde::{Deserialize, Serialize};

use crate::unwrap::Unwrap;

/// Magic of the stage artefact.
pub const MAGIC: &[u8; 4] = b"LKst";
/// No receiver, in [`StageBlock::receiver_of_texel`].
pub const NO_RECEIVER: u32 = u32::MAX;
/// No receiver, as the texel lies in a cavity that nothing in the open sees.
pub const CAVITY: u32 = u32::MAX - 1;

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
    /// Surface patches; empty unless the basis is patches.
    pub patches: PatchTree,
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
    /// Receiver that stands for each texel, row by row; [`NO_RECEIVER`] where the block is empty, or [`CAVITY`].
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
    /// Surface that reads this texel, of one side.
    pub area: AreaCode,
}

/// Surface patches, coarse to fine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PatchTree {
    /// Patches, each before its parts; the leaves of a patch are `first_leaf..first_leaf + leaf_count`.
    pub patches: Vec<Patch>,
    /// Leaf of each receiver.
    pub leaf_of_receiver: Vec<u32>,
    /// Receivers, leaf by leaf.
    pub receivers: Vec<u32>,
    /// First entry of each leaf in `receivers`, and the end.
    pub leaf_starts: Vec<u32>,
    /// Indices of patches, ascending by key.
    pub by_key: Vec<u32>,
}

/// A surface patch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// Identity.
    pub key: PatchKey,
    /// First leaf.
    pub first_leaf: u32,
    /// Leaves.
    pub leaf_count: u32,
    /// Index after the last of its parts; its first part, if it has any, follows itself, and each part the end of the
    /// one before.
    pub end: u32,
    /// Lower and upper corner of its receivers' positions in metres.
    pub bounds_m: [Vec3; 2],
    /// Sum of its receivers' areas, in texels.
    pub area_texels: f32,
}

impl PatchTree {
    /// Indices of patches that are part of no other.
    pub fn roots(&self) -> impl Iterator<Item = u32> + '_ {
        self.siblings(0, self.patches.len() as u32)
    }

    /// Indices of a patch's parts.
    pub fn parts(&self, patch: u32) -> impl Iterator<Item = u32> + '_ {
        self.siblings(patch + 1, self.patches[patch as usize].end)
    }

    fn siblings(&self, first: u32, end: u32) -> impl Iterator<Item = u32> + '_ {
        let within = move |index: &u32| *index < end;
        std::iter::successors(Some(first).filter(within), move |&index| {
            Some(self.patches[index as usize].end).filter(within)
        })
    }

    /// The patch of a key.
    pub fn of_key(&self, key: PatchKey) -> Option<&Patch> {
        let place = self.by_key.binary_search_by_key(&key, |&index| self.patches[index as usize].key).ok()?;
        Some(&self.patches[self.by_key[place] as usize])
    }

    /// Receivers of a patch.
    pub fn receivers_of(&self, patch: &Patch) -> &[u32] {
        let at = |leaf: u32| self.leaf_starts[leaf as usize] as usize;
        &self.receivers[at(patch.first_leaf)..at(patch.first_leaf + patch.leaf_count)]
    }
}

/// A world-aligned cell of receivers that are factorised together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClusterCell {
    /// Lower and upper corner in metres; the upper one is outside.
    pub bounds_m: [Vec3; 2],
    /// Ascending receiver indices.
    pub receivers: Vec<u32>,
}
