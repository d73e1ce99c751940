//! Receivers that stand for those which are not there: while a bake's clusters come, a coarse patch has the light of the
//! receivers of it that are known.

use super::patches::parents;
use super::{Inconsistent, NO_PATCH, SlotTable};
use crate::content::{Patch, PatchSet, Texel};

/// Level of the patches in which receivers stand for each other: of eight texels. A patch has both sides of a wall only where they are
/// joined around its end.
pub const STAND_IN_LEVEL: u64 = 3;
/// Texels of one patch of this level are of one side of a wall. More → fewer steps in first light where two patches meet, and more
/// light around the ends of walls.
const SIDE_LEVEL: u64 = 4;
/// Of more receivers than this those around a place in stored order alone are asked for the nearest.
const ASKED_MAX: usize = 256;

/// Patches of a level and above, and those below it that are part of none of that level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CoarsePatches {
    /// Patch that each is part of, or [`NO_PATCH`].
    pub parents: Vec<u32>,
    /// Coarse patch that each patch lies in: itself, if it is one.
    pub whole: Vec<u32>,
    /// The smallest coarse patch that each leaf lies in.
    pub of_leaf: Vec<u32>,
}

impl CoarsePatches {
    /// Those of `level` and above.
    pub fn new(set: &PatchSet, level: u64) -> Self {
        let parents = parents(set);
        let level_of = |patch: u32| set.patches.get(patch as usize).map(|patch| patch.key.level());
        let mut whole = vec![NO_PATCH; set.patches.len()];
        let mut path = Vec::new();
        for first in 0..set.patches.len() as u32 {
            let mut patch = first;
            while whole[patch as usize] == NO_PATCH {
                path.push(patch);
                match parents[patch as usize] {
                    parent if level_of(parent).is_some_and(|of_parent| of_parent <= level) => patch = parent,
                    _ => whole[patch as usize] = patch,
                }
            }
            let found = whole[patch as usize];
            path.drain(..).for_each(|patch| whole[patch as usize] = found);
        }
        let mut order: Vec<u32> = (0..set.patches.len() as u32).filter(|&p| whole[p as usize] == p).collect();
        // Parts overwrite their wholes.
        order.sort_by_key(|&p| {
            let patch = &set.patches[p as usize];
            (std::cmp::Reverse(patch.leaf_count), std::cmp::Reverse(patch.key.level()), p)
        });
        let mut of_leaf = vec![NO_PATCH; set.leaf_starts.len().saturating_sub(1)];
        for patch in order {
            let Patch { first_leaf, leaf_count, .. } = set.patches[patch as usize];
            of_leaf[first_leaf as usize..][..leaf_count as usize].fill(patch);
        }
        Self { parents, whole, of_leaf }
    }

    /// Runs of receivers in one coarse patch, as ranges of the set's arrays.
    pub fn runs(&self, set: &PatchSet) -> Vec<std::ops::Range<usize>> {
        let mut runs: Vec<std::ops::Range<usize>> = Vec::new();
        for (leaf, patch) in self.of_leaf.iter().enumerate() {
            let [start, end] = [leaf, leaf + 1].map(|leaf| set.leaf_starts[leaf] as usize);
            let goes_on = leaf > 0 && self.of_leaf[leaf - 1] == *patch;
            match runs.last_mut() {
                Some(run) if goes_on => run.end = end,
                _ => runs.push(start..end),
            }
        }
        runs
    }
}

/// Squared distance of two receivers of a set in texels; those of another block are farther than all of one.
fn distance(set: &PatchSet, a: usize, b: usize) -> u64 {
    let along = |axis: usize| u64::from(set.texel[a][axis].abs_diff(set.texel[b][axis])).pow(2);
    u64::from(set.block[a] != set.block[b]) << 40 | (along(0) + along(1))
}

/// The nearest of `standing`, ascending places in the set's arrays, to the receiver at a place.
fn nearest(set: &PatchSet, place: usize, standing: &[usize]) -> Option<usize> {
    let around = standing.partition_point(|&other| other < place);
    let first = around.saturating_sub(ASKED_MAX / 2).min(standing.len().saturating_sub(ASKED_MAX));
    let asked = standing.iter().skip(first).take(ASKED_MAX);
    asked.copied().min_by_key(|&other| (distance(set, place, other), other))
}

/// Makes the nearest receiver of its coarse patch stand for each receiver of the set that has no slot. Where a coarse patch
/// has none, its texels stay dark. Texels of one patch of level 4 are of one side of walls.
pub fn stand_in(set: &PatchSet, slots: &mut SlotTable) -> Result<(), Inconsistent> {
    let wrong = |problem| Inconsistent::new("patches", problem);
    let blocks = slots.block_indices(&set.blocks).map_err(wrong)?;
    let name = |place: usize| -> Result<(u32, Texel), Inconsistent> {
        let block = blocks.get(set.block[place] as usize);
        Ok((*block.ok_or_else(|| wrong(format!("names block {}", set.block[place])))?, set.texel[place]))
    };
    let sides = CoarsePatches::new(set, SIDE_LEVEL);
    for (leaf, side) in sides.of_leaf.iter().enumerate() {
        for place in set.leaf_starts[leaf] as usize..set.leaf_starts[leaf + 1] as usize {
            let (block, texel) = name(place)?;
            slots.set_side(block, texel, *side);
        }
    }
    for run in CoarsePatches::new(set, STAND_IN_LEVEL).runs(set) {
        let mut standing = Vec::new();
        for place in run.clone() {
            let (block, texel) = name(place)?;
            if slots.slot(block, texel).is_some() {
                standing.push(place);
            }
        }
        if standing.len() == run.len() {
            continue;
        }
        for place in run {
            let Some(nearest) = nearest(set, place, &standing) else { continue };
            if nearest != place {
                let [(block, texel), (of_block, of_texel)] = [name(place)?, name(nearest)?];
                if let Some(slot) = slots.slot(of_block, of_texel) {
                    slots.stand_in(block, texel, slot);
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::{AreaCode, PatchKey};

    /// A wall of four texels, the last of which a wall parts from the others: a patch each, and one of level 3 of the first three.
    fn wall() -> PatchSet {
        let key = |level, x| PatchKey::of_cell(level, [x, 0, 0], 1, 0);
        let patch = |key, first_leaf, leaf_count| Patch { key, first_leaf, leaf_count };
        PatchSet {
            patches: vec![
                patch(key(0, 0), 0, 1),
                patch(key(0, 1), 1, 1),
                patch(key(0, 2), 2, 1),
                patch(key(0, 3), 3, 1),
                patch(key(3, 0), 0, 3),
            ],
            leaf_starts: vec![0, 1, 2, 3, 4],
            blocks: vec![7],
            block: vec![0; 4],
            texel: vec![[0, 0], [1, 0], [2, 0], [3, 0]],
            area: vec![AreaCode::ONE; 4],
            sky_parts: 4,
        }
    }

    /// Slots of receivers at these texels, in their order.
    fn with_receivers(texels: &[Texel]) -> SlotTable {
        let mut slots = SlotTable::new([(7, [4, 1])]).unwrap();
        texels.iter().zip(0..).for_each(|(texel, slot)| slots.enter(0, *texel, slot).unwrap());
        slots
    }

    #[test]
    fn coarse_patches_are_those_of_the_level_and_parts_of_none_of_it() {
        let set = wall();
        let coarse = CoarsePatches::new(&set, STAND_IN_LEVEL);
        assert_eq!(coarse.whole, [4, 4, 4, 3, 4]);
        assert_eq!(coarse.of_leaf, [4, 4, 4, 3]);
        assert_eq!(coarse.runs(&set), [0..3, 3..4]);
        assert_eq!(CoarsePatches::new(&set, 0).of_leaf, [0, 1, 2, 3]);
        // The patch around the first three is of level 3: it is no whole of level 2.
        assert_eq!(CoarsePatches::new(&set, 2).whole, [0, 1, 2, 3, 4]);
    }

    #[test]
    fn the_nearest_of_the_patch_stands_for_others_but_through_no_wall() {
        let set = wall();
        let mut slots = with_receivers(&[[0, 0], [2, 0]]);
        stand_in(&set, &mut slots).unwrap();
        let standing = [0, 1, 2, 3].map(|x| slots.standing(0, [x, 0]));
        assert_eq!(standing, [Some(0), Some(0), Some(1), None]);
        assert_eq!([1, 3].map(|x| slots.slot(0, [x, 0])), [None; 2], "they are no receivers");
    }

    #[test]
    fn texels_amid_their_side_are_known() {
        let texel: Vec<Texel> = (0..16).map(|i| [i % 4, i / 4]).collect();
        let key = |level, x| PatchKey::of_cell(level, [x, 0, 0], 1, 0);
        // The last column is another patch's.
        let order: Vec<Texel> =
            [0, 1, 2, 3].iter().flat_map(|x| texel.iter().filter(move |t| t[0] == *x)).copied().collect();
        let set = PatchSet {
            patches: vec![
                Patch { key: key(3, 0), first_leaf: 0, leaf_count: 1 },
                Patch { key: key(3, 1), first_leaf: 1, leaf_count: 1 },
            ],
            leaf_starts: vec![0, 12, 16],
            block: vec![0; 16],
            texel: order,
            area: vec![AreaCode::ONE; 16],
            ..wall()
        };
        let mut slots = SlotTable::new([(7, [4, 4])]).unwrap();
        slots.enter(0, [0, 0], 5).unwrap();
        slots.enter(0, [3, 0], 6).unwrap();
        stand_in(&set, &mut slots).unwrap();
        let inside: Vec<Texel> =
            texel.iter().filter(|texel| slots.standing_inside(0, **texel).is_some()).copied().collect();
        assert_eq!(inside, [[1, 1], [1, 2]]);
        assert_eq!([[1, 1], [3, 3]].map(|texel| slots.standing(0, texel)), [Some(5), Some(6)]);
    }

    #[test]
    fn nobody_stands_for_others_where_all_are_there() {
        let set = wall();
        let mut slots = with_receivers(&set.texel);
        stand_in(&set, &mut slots).unwrap();
        assert_eq!([0, 1, 2, 3].map(|x| slots.standing(0, [x, 0])), [Some(0), Some(1), Some(2), Some(3)]);
        let lost = PatchSet { blocks: vec![8], ..set };
        assert!(stand_in(&lost, &mut slots).is_err());
    }

    #[test]
    fn of_many_the_nearest_in_stored_order_are_asked() {
        let texel: Vec<Texel> = (0..5000).map(|x| [x, 0]).collect();
        let set = PatchSet { block: vec![0; texel.len()], texel, ..wall() };
        let standing: Vec<usize> = (0..5000).step_by(2).collect();
        assert_eq!(nearest(&set, 4321, &standing), Some(4320));
        assert_eq!(nearest(&set, 4999, &standing), Some(4998));
        assert_eq!(nearest(&set, 1, &standing), Some(0));
        assert_eq!(nearest(&set, 1, &[]), None);
    }
}
