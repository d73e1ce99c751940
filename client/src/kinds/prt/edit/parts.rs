//! Patches of one bake as sums of patches of another.

use std::collections::HashMap;

use lightkiln_proto::content::{Patch, PatchSet};
use lightkiln_proto::relight::{NO_PATCH, PatchTable};
use rayon::prelude::*;

use super::Name;

/// Patches and their shares of a whole, which add up to 1.
pub(super) type Parts = Vec<(u32, f32)>;

/// Least share of a patch's receivers that a whole has of it, if the patch is one of its parts: what is new in it may differ.
const SHARE_MIN: f32 = 0.875;
/// The same of a patch that has no parts.
const LEAF_SHARE_MIN: f32 = 0.5;

/// Parts of a patch at most: each is a column.
const PARTS_MAX: usize = 32;

/// Patches of a bake with their parts.
struct Tree<'a> {
    set: &'a PatchSet,
    /// Parts of each patch, and, last, those that are part of none, by place.
    parts: Vec<Vec<u32>>,
    /// Area before each receiver of the set, in texels, and all of it.
    areas: Vec<f64>,
}

/// By patch of `before`: the patches of another bake, each as large as may be, that its receivers make up now; none where all are gone. Keys alone do
/// not tell: those of a place are numbered, so that a thing that comes or goes gives others its number, and surfaces become one patch or two as
/// they see each other.
pub(super) fn parts_of(before: &PatchSet, set: &PatchSet, columns: &PatchTable) -> Vec<Parts> {
    let places: HashMap<Name, u32> =
        (0..).zip(0..set.texel.len()).filter_map(|(place, at)| Some((name(set, at)?, place))).collect();
    let place_of = |at| places.get(&name(before, at)?).copied();
    let place_of: Vec<Option<u32>> = (0..before.texel.len()).map(place_of).collect();
    let tree = Tree::new(set, columns);
    let of = |patch: &Patch| {
        let [first, end] = run(before, patch);
        let mut left: Vec<u32> =
            place_of.get(first..end).unwrap_or_default().iter().flatten().copied().collect();
        left.sort_unstable();
        let mut found = Vec::new();
        tree.enter(None, &left, &mut found);
        if found.len() > PARTS_MAX {
            // The largest stand for all.
            found.sort_by(|a: &(u32, f64), b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            found.truncate(PARTS_MAX);
            found.sort_unstable_by_key(|(patch, _)| *patch);
        }
        let all: f64 = found.iter().map(|(_, area)| area).sum();
        let share = |area: f64| if all > 0.0 { area / all } else { 1.0 / found.len() as f64 };
        found.iter().map(|(patch, area)| (*patch, share(*area) as f32)).collect()
    };
    before.patches.par_iter().map(of).collect()
}

/// Receiver at a place of a set.
fn name(set: &PatchSet, at: usize) -> Option<Name> {
    Some((*set.blocks.get(*set.block.get(at)? as usize)?, *set.texel.get(at)?))
}

/// Places of a patch's receivers in its set.
fn run(set: &PatchSet, patch: &Patch) -> [usize; 2] {
    [patch.first_leaf, patch.first_leaf + patch.leaf_count]
        .map(|leaf| set.leaf_starts.get(leaf as usize).map_or(0, |start| *start as usize))
}

impl<'a> Tree<'a> {
    fn new(set: &'a PatchSet, columns: &PatchTable) -> Self {
        let mut parts = vec![Vec::new(); set.patches.len() + 1];
        for (patch, row) in (0..).zip(&columns.patches) {
            let whole = if row.parent == NO_PATCH { set.patches.len() } else { row.parent as usize };
            parts[whole].push(patch);
        }
        for of in &mut parts {
            of.sort_by_key(|patch| run(set, &set.patches[*patch as usize]));
        }
        let mut area = 0.0;
        let before = |of: &f32| {
            let before = area;
            area += f64::from(*of);
            before
        };
        let mut areas: Vec<f64> = columns.areas.iter().map(before).collect();
        areas.push(area);
        Self { set, parts, areas }
    }

    /// Adds the parts of receivers, by ascending place, that lie in a patch, or in any, with their areas.
    fn enter(&self, patch: Option<u32>, mut left: &[u32], found: &mut Vec<(u32, f64)>) {
        let Some(parts) = self.parts.get(patch.map_or(self.set.patches.len(), |patch| patch as usize)) else {
            return;
        };
        while let Some(&at) = left.first() {
            let run_of = |part: &u32| run(self.set, &self.set.patches[*part as usize]);
            let next = parts.partition_point(|part| run_of(part)[1] <= at as usize);
            let Some(&part) = parts.get(next) else { return };
            let [first, end] = run_of(&part);
            let (own, rest) = left.split_at(left.partition_point(|at| (*at as usize) < end));
            left = rest;
            let share = own.len() as f32 / (end - first).max(1) as f32;
            let is_leaf = self.parts[part as usize].is_empty();
            if share >= if is_leaf { LEAF_SHARE_MIN } else { SHARE_MIN } {
                found.push((part, self.areas[end] - self.areas[first]));
            } else if !is_leaf {
                self.enter(Some(part), own, found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lightkiln_proto::content::{AreaCode, PatchKey};
    use lightkiln_proto::relight::SlotTable;

    /// Patches over receivers of one block, by their first and last texel: wholes before parts; the smallest are leaves.
    fn set(patches: &[(u64, [u16; 2])], texels: &[u16]) -> PatchSet {
        let mut set = PatchSet { blocks: vec![7], ..PatchSet::default() };
        let is_leaf = |at: usize| {
            let [low, high] = patches[at].1;
            !patches.iter().enumerate().any(|(other, (_, [a, b]))| other != at && *a >= low && *b <= high)
        };
        for at in (0..patches.len()).filter(|at| is_leaf(*at)) {
            set.leaf_starts.push(set.texel.len() as u32);
            for texel in texels.iter().filter(|texel| (patches[at].1[0]..=patches[at].1[1]).contains(texel)) {
                set.block.push(0);
                set.texel.push([*texel, 0]);
                set.area.push(AreaCode::of(1.0));
            }
        }
        set.leaf_starts.push(set.texel.len() as u32);
        let leaf_of = |texel: u16| {
            let place = set.texel.iter().position(|[x, _]| *x == texel).unwrap() as u32;
            set.leaf_starts.iter().rposition(|start| *start <= place).unwrap() as u32
        };
        let all = patches.iter().map(|(level, [low, high])| {
            let within: Vec<u16> = texels.iter().copied().filter(|at| (low..=high).contains(&at)).collect();
            let (first_leaf, last) = (leaf_of(within[0]), leaf_of(within[within.len() - 1]));
            let key = PatchKey::of_cell(*level as u32, [i32::from(*low), 0, 0], 0, 0);
            Patch { key, first_leaf, leaf_count: last + 1 - first_leaf }
        });
        set.patches = all.collect();
        set
    }

    fn found(before: &PatchSet, after: &PatchSet) -> Vec<Parts> {
        let columns = PatchTable::new(after, &SlotTable::new([(7, [8, 1])]).unwrap()).unwrap();
        parts_of(before, after, &columns)
    }

    #[test]
    fn patch_is_itself_where_nothing_is_another() {
        let of = set(&[(2, [0, 7]), (1, [0, 3]), (1, [4, 7])], &[0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(found(&of, &of), [[(0, 1.0)], [(1, 1.0)], [(2, 1.0)]]);
    }

    #[test]
    fn whole_of_which_one_part_is_left_is_that_part() {
        let all = [0, 1, 2, 3, 4, 5, 6, 7];
        let before = set(&[(2, [0, 7]), (1, [0, 3]), (1, [4, 7])], &all);
        let after = set(&[(1, [0, 3])], &all[..4]);
        assert_eq!(found(&before, &after), [vec![(0, 1.0)], vec![(0, 1.0)], vec![]]);
    }

    #[test]
    fn whole_that_has_become_part_of_a_larger_one_is_its_parts_by_their_areas() {
        let all = [0, 1, 2, 3, 4, 5, 6, 7];
        let before = set(&[(2, [0, 5]), (1, [0, 3]), (1, [4, 5])], &all[..6]);
        // Two are one with what was another patch.
        let after = set(&[(3, [0, 7]), (1, [0, 3]), (1, [4, 5]), (1, [6, 7])], &all);
        let third = 1.0 / 3.0;
        assert_eq!(
            found(&before, &after),
            [vec![(1, 2.0 * third), (2, third)], vec![(1, 1.0)], vec![(2, 1.0)]]
        );
    }
}
