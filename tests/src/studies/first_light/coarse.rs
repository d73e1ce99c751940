//! Surface patches of a coarse level and above, and the receivers that stand for all others.

use std::collections::{HashMap, HashSet};

use lightkiln_proto::content::{AreaCode, BlockKey, Patch, PatchKey, PatchSet, Texel};
use lightkiln_proto::relight::NO_PATCH;

/// Name of a receiver.
pub type Name = (BlockKey, Texel);

/// The patches of an overview.
pub struct CoarsePatches<'a> {
    set: &'a PatchSet,
    /// Patch that each is part of, or [`NO_PATCH`].
    parents: Vec<u32>,
    /// Patch of the overview that each patch lies in; itself if it is one.
    whole: Vec<u32>,
    /// Patch of the overview that each leaf lies in.
    of_leaf: Vec<u32>,
    /// Leaf of each receiver.
    leaf_of: HashMap<Name, u32>,
}

impl<'a> CoarsePatches<'a> {
    /// Patches of `level` and above, and roots below it; `parents` are the patches that each is part of.
    pub fn new(set: &'a PatchSet, parents: Vec<u32>, level: u64) -> Self {
        let whole_of = |mut patch: u32| {
            while set.patches[patch as usize].key.level() < level && parents[patch as usize] != NO_PATCH {
                patch = parents[patch as usize];
            }
            patch
        };
        let whole: Vec<u32> = (0..set.patches.len() as u32).map(whole_of).collect();
        let mut order: Vec<u32> = (0..set.patches.len() as u32).filter(|&p| whole[p as usize] == p).collect();
        // Parts overwrite their wholes.
        order.sort_by_key(|&p| {
            let patch = &set.patches[p as usize];
            (std::cmp::Reverse(patch.leaf_count), std::cmp::Reverse(patch.key.level()), p)
        });
        let mut of_leaf = vec![NO_PATCH; set.leaf_starts.len() - 1];
        for patch in order {
            let Patch { first_leaf, leaf_count, .. } = set.patches[patch as usize];
            of_leaf[first_leaf as usize..][..leaf_count as usize].fill(patch);
        }
        let mut coarse =
            Self { set, parents, whole, of_leaf, leaf_of: HashMap::with_capacity(set.block.len()) };
        for leaf in 0..coarse.of_leaf.len() as u32 {
            for entry in coarse.entries(leaf, leaf + 1) {
                coarse.leaf_of.insert(coarse.name(entry), leaf);
            }
        }
        coarse
    }

    /// Receivers of leaves, as indices of the set's.
    fn entries(&self, first_leaf: u32, end_leaf: u32) -> std::ops::Range<usize> {
        let at = |leaf: u32| self.set.leaf_starts[leaf as usize] as usize;
        at(first_leaf)..at(end_leaf)
    }

    fn name(&self, entry: usize) -> Name {
        (self.set.blocks[self.set.block[entry] as usize], self.set.texel[entry])
    }

    /// Runs of leaves in one patch of the overview: first leaf and end.
    fn runs(&self) -> Vec<[u32; 2]> {
        let mut runs: Vec<[u32; 2]> = Vec::new();
        for leaf in 0..self.of_leaf.len() {
            let goes_on = leaf > 0 && self.of_leaf[leaf] == self.of_leaf[leaf - 1];
            match runs.last_mut() {
                Some(run) if goes_on => run[1] += 1,
                _ => runs.push([leaf as u32, leaf as u32 + 1]),
            }
        }
        runs
    }

    /// Columns of the radiance of the patch of the overview that a receiver lies in.
    pub fn columns_at(&self, name: Name) -> Option<Vec<PatchKey>> {
        self.leaf_of.get(&name).map(|&leaf| self.columns_of(self.of_leaf[leaf as usize]))
    }

    /// Columns whose sum is what a column of the bake reads, as far as the overview has it: a patch is that which it lies in, and a
    /// difference below those is nothing.
    pub fn columns(&self, key: PatchKey) -> Vec<PatchKey> {
        if key.sky().is_some() {
            return vec![key];
        }
        let found = self.set.patches.binary_search_by_key(&key.patch(), |patch| patch.key);
        let Ok(patch) = found.map(|index| index as u32) else { return Vec::new() };
        let whole = self.whole[patch as usize];
        match key.is_difference() {
            false => self.columns_of(whole),
            true if whole == patch => vec![key],
            true => Vec::new(),
        }
    }

    /// The radiance of a patch of the overview: that of the root around it, and the differences from there on. Differences that are
    /// lost lose no energy.
    fn columns_of(&self, mut patch: u32) -> Vec<PatchKey> {
        let mut columns = Vec::new();
        while let Some(Patch { key, .. }) = self.set.patches.get(patch as usize) {
            patch = self.parents[patch as usize];
            columns.push(if patch == NO_PATCH { *key } else { key.difference() });
        }
        columns
    }

    /// Those of `present` that stand for the others: of every run of leaves those on each `stride`-th texel, else the largest.
    pub fn chosen(&self, present: &HashSet<Name>, stride: u16) -> HashSet<Name> {
        let mut chosen = HashSet::new();
        for [first, end] in self.runs() {
            let here = || self.entries(first, end).filter(|&entry| present.contains(&self.name(entry)));
            let on_lattice = |&entry: &usize| self.set.texel[entry].iter().all(|at| at % stride == 0);
            let before = chosen.len();
            chosen.extend(here().filter(on_lattice).map(|entry| self.name(entry)));
            if chosen.len() == before {
                let largest = here().max_by_key(|&entry| (self.set.area[entry], std::cmp::Reverse(entry)));
                chosen.extend(largest.map(|entry| self.name(entry)));
            }
        }
        chosen
    }

    /// The patches with the chosen receivers alone: each has the area of those that it is the nearest to.
    pub fn patches(&self, chosen: &HashSet<Name>) -> PatchSet {
        let runs = self.runs();
        let mut patches =
            PatchSet { leaf_starts: vec![0], sky_parts: self.set.sky_parts, ..PatchSet::default() };
        let mut blocks: Vec<BlockKey> = Vec::new();
        let mut members: Vec<(Name, AreaCode)> = Vec::new();
        for &[first, end] in &runs {
            let entries = self.entries(first, end);
            let standing: Vec<usize> =
                entries.clone().filter(|&at| chosen.contains(&self.name(at))).collect();
            let mut texels = vec![0.0_f32; standing.len()];
            for entry in entries.clone() {
                let nearest = (0..standing.len()).min_by_key(|&at| self.distance(entry, standing[at]));
                if let Some(nearest) = nearest {
                    texels[nearest] += self.set.area[entry].texels();
                }
            }
            let areas = texels.into_iter().map(AreaCode::of);
            members.extend(standing.iter().map(|&entry| self.name(entry)).zip(areas));
            if standing.is_empty() {
                // No light reaches it.
                members.push((self.name(entries.start), self.set.area[entries.start]));
            }
            patches.leaf_starts.push(members.len() as u32);
        }
        blocks.extend(members.iter().map(|((block, _), _)| *block));
        blocks.sort_unstable();
        blocks.dedup();
        let place = |block: &BlockKey| blocks.partition_point(|other| other < block) as u32;
        patches.block = members.iter().map(|((block, _), _)| place(block)).collect();
        patches.texel = members.iter().map(|((_, texel), _)| *texel).collect();
        patches.area = members.iter().map(|(_, area)| *area).collect();
        patches.blocks = blocks;
        // Runs are whole in every patch.
        let run_of = |leaf: u32| runs.partition_point(|[_, end]| *end <= leaf) as u32;
        let kept = self.set.patches.iter().enumerate().filter(|(at, _)| self.whole[*at] == *at as u32);
        patches.patches = kept
            .map(|(_, patch)| {
                let first_leaf = run_of(patch.first_leaf);
                let last_leaf = run_of(patch.first_leaf + patch.leaf_count - 1);
                Patch { key: patch.key, first_leaf, leaf_count: last_leaf + 1 - first_leaf }
            })
            .collect();
        patches
    }

    /// Each receiver, the chosen one that stands for it, and its area in texels.
    pub fn stand_for(&self, chosen: &HashSet<Name>) -> Vec<(Name, Name, f32)> {
        let mut pairs = Vec::new();
        for [first, end] in self.runs() {
            let entries = self.entries(first, end);
            let standing: Vec<usize> =
                entries.clone().filter(|&at| chosen.contains(&self.name(at))).collect();
            for entry in entries {
                let nearest = standing.iter().min_by_key(|&&at| self.distance(entry, at));
                let pair =
                    nearest.map(|&at| (self.name(entry), self.name(at), self.set.area[entry].texels()));
                pairs.extend(pair);
            }
        }
        pairs
    }

    /// Squared distance of two receivers in texels; those of another block are farther than all of one.
    fn distance(&self, a: usize, b: usize) -> u64 {
        let squared =
            |axis: usize| u64::from(self.set.texel[a][axis].abs_diff(self.set.texel[b][axis])).pow(2);
        let other = u64::from(self.set.block[a] != self.set.block[b]);
        other << 40 | (squared(0) + squared(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of two texels: a patch each, and one of both.
    fn wall() -> (PatchSet, Vec<u32>) {
        let key = |level, x| PatchKey::of_cell(level, [x, 0, 0], 1, 0);
        let patch = |key, first_leaf, leaf_count| Patch { key, first_leaf, leaf_count };
        let set = PatchSet {
            patches: vec![patch(key(0, 0), 0, 1), patch(key(0, 1), 1, 1), patch(key(1, 0), 0, 2)],
            leaf_starts: vec![0, 1, 2],
            blocks: vec![7],
            block: vec![0, 0],
            texel: vec![[0, 0], [1, 0]],
            area: vec![AreaCode::ONE; 2],
            sky_parts: 4,
        };
        (set, vec![2, 2, NO_PATCH])
    }

    #[test]
    fn columns_of_a_part_sum_up_to_its_radiance_as_far_as_patches_are_kept() {
        let (set, parents) = wall();
        let [part, whole] = [set.patches[0].key, set.patches[2].key];
        let fine = CoarsePatches::new(&set, parents.clone(), 0);
        assert_eq!(fine.columns(part), [part.difference(), whole]);
        assert_eq!(fine.columns(part.difference()), [part.difference()]);
        let coarse = CoarsePatches::new(&set, parents, 1);
        assert_eq!(coarse.columns(part), [whole]);
        assert_eq!(coarse.columns(part.difference()), []);
        assert_eq!(coarse.columns(PatchKey::of_sky(3)), [PatchKey::of_sky(3)]);
    }

    #[test]
    fn receivers_that_stand_for_others_have_their_area() {
        let (set, parents) = wall();
        let coarse = CoarsePatches::new(&set, parents, 1);
        let all: HashSet<Name> = [(7, [0, 0]), (7, [1, 0])].into();
        let chosen = coarse.chosen(&all, 2);
        assert_eq!(chosen, HashSet::from([(7, [0, 0])]));
        let patches = coarse.patches(&chosen);
        assert_eq!(patches.patches, [Patch { key: set.patches[2].key, first_leaf: 0, leaf_count: 1 }]);
        assert_eq!((patches.texel, patches.area), (vec![[0, 0]], vec![AreaCode::of(2.0)]));
        // Where the lattice has no receiver, the largest there is stands for the patch.
        let right: HashSet<Name> = [(7, [1, 0])].into();
        assert_eq!(coarse.chosen(&right, 2), right);
    }
}
