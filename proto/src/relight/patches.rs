//! Surface patches, their receivers resolved to slots: irradiance → mean radiance of patches and parts of the sky.

use std::collections::HashMap;

use glam::Vec4;

use super::{
    ALWAYS, Columns, DARK, Inconsistent, Irradiance, Panorama, Parallel, ReceiverTable, Sky, SlotTable,
};
use crate::chunk::limits::SKY_PARTS_MAX;
use crate::content::{Patch, PatchKey, PatchSet};
use crate::harmonics::relight_direction;

/// A patch as shaders read it: a run of leaves.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PatchRow {
    /// First leaf.
    pub first_leaf: u32,
    /// Leaves.
    pub leaf_count: u32,
    /// The patch that it is part of, or [`NO_PATCH`].
    pub parent: u32,
}

/// Leaves in a row that are summed once for all patches, and such sums that are summed again. Roots have hundreds of thousands of leaves.
pub const LEAF_BLOCK: u32 = 64;

/// Stands for the patch that a root is part of.
pub const NO_PATCH: u32 = u32::MAX;

/// The surface patches of a bake, and the parts of its sky. λ has the radiance of each patch, then for each its difference
/// from that of the patch which it is part of (of a root, which is part of none, its radiance), then the sky's parts.
#[derive(Debug, Default)]
pub struct PatchTable {
    /// Patches.
    pub patches: Vec<PatchRow>,
    /// First entry of each leaf in `slots`, and the end.
    pub leaf_starts: Vec<u32>,
    /// Receiver slots, leaf by leaf, or [`DARK`].
    pub slots: Vec<u32>,
    /// Area of each in texels: its weight in the mean.
    pub areas: Vec<f32>,
    /// Parts of the sky.
    pub sky_parts: u32,
    by_key: HashMap<PatchKey, u32>,
}

/// Patches of a chain of parts and wholes at most: there are as many levels.
const DEPTH_MAX: usize = 16;

impl PatchTable {
    /// The set of a bake.
    pub fn new(set: &PatchSet, slots: &SlotTable) -> Result<Self, Inconsistent> {
        Self::resolve(set, slots).map_err(|problem| Inconsistent::new("patches", problem))
    }

    fn resolve(set: &PatchSet, slots: &SlotTable) -> Result<Self, String> {
        if set.sky_parts as usize > SKY_PARTS_MAX {
            return Err(format!("has {} parts of the sky", set.sky_parts));
        }
        let blocks = slots.block_indices(&set.blocks)?;
        let mut table =
            Self { leaf_starts: set.leaf_starts.clone(), sky_parts: set.sky_parts, ..Self::default() };
        table.areas = set.area.iter().map(|area| area.texels()).collect();
        for (&block, &texel) in set.block.iter().zip(&set.texel) {
            let found = blocks.get(block as usize).ok_or_else(|| format!("names block {block}"))?;
            // The baker leaves out receivers that no light can reach.
            table.slots.push(slots.standing(*found, texel).unwrap_or(DARK));
        }
        for (index, patch) in set.patches.iter().enumerate() {
            table.by_key.insert(patch.key, index as u32);
            let Patch { first_leaf, leaf_count, .. } = *patch;
            table.patches.push(PatchRow { first_leaf, leaf_count, parent: NO_PATCH });
        }
        for (row, parent) in table.patches.iter_mut().zip(parents(set)) {
            row.parent = parent;
        }
        let wholes = |patch: u32| {
            let parent = |at: &u32| table.patches.get(*at as usize).map(|row| row.parent);
            std::iter::successors(Some(patch), parent).take_while(|at| *at != NO_PATCH)
        };
        if let Some(patch) = (0..table.patches.len() as u32).find(|&of| wholes(of).nth(DEPTH_MAX).is_some()) {
            return Err(format!("patch {patch} is part of more than {DEPTH_MAX} others"));
        }
        Ok(table)
    }

    /// Number of a patch by its key.
    pub fn number(&self, key: PatchKey) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    /// Whether no light can reach a patch: the baker left all of its receivers out.
    pub fn is_dark(&self, patch: u32) -> bool {
        let Some(PatchRow { first_leaf, leaf_count, .. }) = self.patches.get(patch as usize) else {
            return true;
        };
        let [first, end] =
            [*first_leaf, first_leaf + leaf_count].map(|leaf| self.leaf_starts[leaf as usize] as usize);
        self.slots[first..end].iter().all(|slot| *slot == DARK)
    }

    /// The finest patch of each slot that is in one, [`NO_PATCH`] of others.
    pub fn finest_of_slots(&self) -> Vec<u32> {
        let slots =
            self.slots.iter().filter(|slot| **slot != DARK).max().map_or(0, |slot| *slot as usize + 1);
        let mut by_slot = vec![NO_PATCH; slots];
        // Those of fewer leaves lie within those of more, and are the last to be written.
        let mut coarse_first: Vec<usize> = (0..self.patches.len()).collect();
        coarse_first.sort_by_key(|&patch| std::cmp::Reverse(self.patches[patch].leaf_count));
        for patch in coarse_first {
            let PatchRow { first_leaf, leaf_count, .. } = self.patches[patch];
            let starts =
                [first_leaf, first_leaf + leaf_count].map(|leaf| self.leaf_starts[leaf as usize] as usize);
            for &slot in &self.slots[starts[0]..starts[1]] {
                if let Some(own) = by_slot.get_mut(slot as usize) {
                    *own = patch as u32;
                }
            }
        }
        by_slot
    }

    /// Numbers in λ.
    pub fn len(&self) -> usize {
        2 * self.patches.len() + self.sky_parts as usize
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Leaves.
    pub fn leaf_count(&self) -> usize {
        self.leaf_starts.len().saturating_sub(1)
    }

    /// Radiance summed over the surface of each leaf; the fourth component is the leaf's area.
    fn leaf_sums(
        &self,
        parallel: &impl Parallel,
        receivers: &ReceiverTable,
        irradiance: Irradiance<'_>,
    ) -> Vec<Vec4> {
        parallel.map(self.leaf_count(), |leaf| {
            let of_leaf = self.leaf_starts[leaf] as usize..self.leaf_starts[leaf + 1] as usize;
            let areas = &self.areas[of_leaf.clone()];
            let each = self.slots[of_leaf].iter().zip(areas);
            let sum: Vec4 = each.map(|(&slot, &area)| irradiance.radiance(receivers, slot) * area).sum();
            sum.truncate().extend(areas.iter().sum())
        })
    }
}

impl Columns for PatchTable {
    fn bands(&self) -> u32 {
        0
    }

    fn lambda_count(&self) -> usize {
        self.len()
    }

    fn index(&self, key: u64) -> Option<u32> {
        let key = PatchKey(key);
        let patches = self.patches.len() as u32;
        match key.sky() {
            Some(part) => (part < self.sky_parts).then(|| 2 * patches + part),
            None => {
                let first = if key.is_difference() { patches } else { 0 };
                self.by_key.get(&key.patch()).map(|patch| first + patch)
            }
        }
    }

    /// Of differences alone: without them, the mean of the patch around stands for each of its parts.
    fn level(&self, key: u64) -> u8 {
        let key = PatchKey(key);
        if key.is_difference() { key.level() as u8 } else { ALWAYS }
    }

    fn sky_index(&self) -> Option<u32> {
        None
    }

    /// Radiance of each part at its middle.
    fn sky_lambda(&self, sky: Sky) -> Vec<Vec4> {
        let part = |part| sky.radiance(relight_direction(part, self.sky_parts)).extend(0.0);
        (0..self.sky_parts).map(part).collect()
    }

    /// Mean radiance of each part.
    fn panorama_lambda(&self, panorama: &Panorama) -> Vec<Vec4> {
        panorama.part_means(self.sky_parts)
    }

    /// Area-weighted mean of L over each patch, W·m⁻²·sr⁻¹; then the differences.
    fn surface_lambda(
        &self,
        parallel: &impl Parallel,
        receivers: &ReceiverTable,
        irradiance: Irradiance<'_>,
    ) -> Vec<Vec4> {
        let leaves = self.leaf_sums(parallel, receivers, irradiance);
        let blocks = block_sums(&leaves);
        let large = block_sums(&blocks);
        let mut lambda = parallel.map(self.patches.len(), |patch| {
            let sum = run_sum([&leaves, &blocks, &large], &self.patches[patch]);
            (sum.truncate() / sum.w).extend(0.0)
        });
        let difference = |(patch, mean): (&PatchRow, &Vec4)| match lambda.get(patch.parent as usize) {
            Some(whole) => *mean - *whole,
            None => *mean,
        };
        let differences: Vec<Vec4> = self.patches.iter().zip(&lambda).map(difference).collect();
        lambda.extend(differences);
        lambda
    }
}

/// Sum of each so many numbers; the last may be of fewer.
fn block_sums(numbers: &[Vec4]) -> Vec<Vec4> {
    numbers.chunks(LEAF_BLOCK as usize).map(|block| block.iter().sum()).collect()
}

/// Sum over a patch's run of leaves, by sums of whole blocks where it holds some: of leaves, of blocks, of blocks of blocks.
fn run_sum([leaves, blocks, large]: [&[Vec4]; 3], patch: &PatchRow) -> Vec4 {
    let (mut at, end) = (patch.first_leaf, patch.first_leaf + patch.leaf_count);
    let mut sum = Vec4::ZERO;
    while at < end {
        let holds = |size: u32| at.is_multiple_of(size) && end - at >= size;
        let (part, size) = if holds(LEAF_BLOCK * LEAF_BLOCK) {
            (large[(at / (LEAF_BLOCK * LEAF_BLOCK)) as usize], LEAF_BLOCK * LEAF_BLOCK)
        } else if holds(LEAF_BLOCK) {
            (blocks[(at / LEAF_BLOCK) as usize], LEAF_BLOCK)
        } else {
            (leaves[at as usize], 1)
        };
        sum += part;
        at += size;
    }
    sum
}

/// The patch that each is part of: the smallest other run of leaves that holds its own; of equal runs, that of the next
/// higher level.
pub(super) fn parents(set: &PatchSet) -> Vec<u32> {
    let of = |patch: u32| &set.patches[patch as usize];
    let end = |patch: u32| u64::from(of(patch).first_leaf) + u64::from(of(patch).leaf_count);
    let mut order: Vec<u32> = (0..set.patches.len() as u32).collect();
    // Wholes come before their parts.
    order.sort_by_key(|&patch| {
        (of(patch).first_leaf, u64::MAX - end(patch), u64::MAX - of(patch).key.level())
    });
    let mut parents = vec![NO_PATCH; order.len()];
    let mut wholes: Vec<u32> = Vec::new();
    for patch in order {
        while wholes.last().is_some_and(|&whole| end(whole) < end(patch)) {
            wholes.pop();
        }
        parents[patch as usize] = wholes.last().copied().unwrap_or(NO_PATCH);
        wholes.push(patch);
    }
    parents
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_leaves_are_summed_by_whole_blocks_alone() {
        // Whole numbers: sums are exact in any order.
        let leaves: Vec<Vec4> = (0..9000_u32).map(|leaf| Vec4::splat((leaf * 7 % 11) as f32)).collect();
        let blocks = block_sums(&leaves);
        let large = block_sums(&blocks);
        assert_eq!([blocks.len(), large.len()], [141, 3]);
        for (first_leaf, leaf_count) in [
            (0, 9000),
            (0, 0),
            (8999, 1),
            (63, 2),
            (64, 64),
            (65, 127),
            (4095, 4098),
            (4096, 4096),
            (1, 8191),
        ] {
            let patch = PatchRow { first_leaf, leaf_count, parent: NO_PATCH };
            let wanted: Vec4 = leaves[first_leaf as usize..][..leaf_count as usize].iter().sum();
            assert_eq!(run_sum([&leaves, &blocks, &large], &patch), wanted, "{first_leaf} + {leaf_count}");
        }
    }
}
