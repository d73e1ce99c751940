//! Surface patches with their receivers resolved to slots.

use std::collections::HashMap;

use lightkiln_proto::chunk::limits::SKY_PARTS_MAX;
use lightkiln_proto::prt::{PatchKey, PatchSet, ProbeKey};

use super::atlas::AtlasLayout;
use super::clusters::block_indices;
use super::probes::HIT_DARK;

/// A patch as shaders read it: a run of leaves.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PatchRow {
    /// First leaf.
    pub first_leaf: u32,
    /// Leaves.
    pub leaf_count: u32,
}

/// The surface patches of a bake, and the parts of its sky.
#[derive(Debug, Default)]
pub struct PatchTable {
    /// Patches.
    pub patches: Vec<PatchRow>,
    /// First entry of each leaf in `slots`, and the end.
    pub leaf_starts: Vec<u32>,
    /// Receiver slots, leaf by leaf, or [`HIT_DARK`].
    pub slots: Vec<u32>,
    /// Area of each, in texels: its weight in the means.
    pub areas: Vec<f32>,
    /// Parts of the sky.
    pub sky_parts: u32,
    by_key: HashMap<ProbeKey, u32>,
}

impl PatchTable {
    /// Index among patches and, after them, parts of the sky.
    pub fn index(&self, key: ProbeKey) -> Option<u32> {
        match PatchKey(key).sky() {
            Some(part) => (part < self.sky_parts).then(|| self.patches.len() as u32 + part),
            None => self.by_key.get(&key).copied(),
        }
    }

    /// Patches and parts of the sky.
    pub fn len(&self) -> usize {
        self.patches.len() + self.sky_parts as usize
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaf_starts.len().saturating_sub(1)
    }

    /// The set of a bake.
    pub(super) fn new(set: &PatchSet, atlas: &AtlasLayout) -> Result<Self, String> {
        if set.sky_parts as usize > SKY_PARTS_MAX {
            return Err(format!("has {} parts of the sky", set.sky_parts));
        }
        let blocks = block_indices(&set.blocks, atlas)?;
        let mut table =
            Self { leaf_starts: set.leaf_starts.clone(), sky_parts: set.sky_parts, ..Self::default() };
        table.areas = set.area.iter().map(|area| area.texels()).collect();
        for (&block, &texel) in set.block.iter().zip(&set.texel) {
            let found = blocks.get(usize::from(block)).ok_or_else(|| format!("names block {block}"))?;
            // The baker leaves out receivers that no light can reach.
            table.slots.push(atlas.slot(*found, texel).unwrap_or(HIT_DARK));
        }
        for (index, patch) in set.patches.iter().enumerate() {
            table.by_key.insert(patch.key.0, index as u32);
            table.patches.push(PatchRow { first_leaf: patch.first_leaf, leaf_count: patch.leaf_count });
        }
        Ok(table)
    }
}
