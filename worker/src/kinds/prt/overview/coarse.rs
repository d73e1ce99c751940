//! Columns of coarse patches, and the receivers that an overview has.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap, HashSet};

use lightkiln_proto::content::{BlockKey, Patch, PatchKey, PatchSet, Texel};
use lightkiln_proto::relight::{CoarsePatches, NO_PATCH};

/// Name of a receiver.
pub type Name = (BlockKey, Texel);

/// The patches of an overview.
pub struct OverviewPatches<'a> {
    set: &'a PatchSet,
    coarse: CoarsePatches,
    /// Leaf of each receiver.
    leaf_of: HashMap<Name, u32>,
}

impl<'a> OverviewPatches<'a> {
    /// Patches of `level` and above, and those below it that are part of none of that level.
    pub fn new(set: &'a PatchSet, level: u64) -> Self {
        let mut patches = Self {
            set,
            coarse: CoarsePatches::new(set, level),
            leaf_of: HashMap::with_capacity(set.block.len()),
        };
        for leaf in 0..patches.coarse.of_leaf.len() {
            let [start, end] = [leaf, leaf + 1].map(|leaf| set.leaf_starts[leaf] as usize);
            for entry in start..end {
                patches.leaf_of.insert(patches.name(entry), leaf as u32);
            }
        }
        patches
    }

    fn name(&self, entry: usize) -> Name {
        (self.set.blocks[self.set.block[entry] as usize], self.set.texel[entry])
    }

    /// Columns of the radiance of the coarse patch that a receiver lies in.
    pub fn columns_at(&self, name: Name) -> Option<Vec<PatchKey>> {
        self.leaf_of.get(&name).map(|&leaf| self.columns_of(self.coarse.of_leaf[leaf as usize]))
    }

    /// Columns whose sum is what a column of the bake reads, as far as the overview has it: a patch is that which it lies in, and a
    /// difference below those is nothing.
    pub fn columns(&self, key: PatchKey) -> Vec<PatchKey> {
        if key.sky().is_some() {
            return vec![key];
        }
        let found = self.set.patches.binary_search_by_key(&key.patch(), |patch| patch.key);
        let Ok(patch) = found.map(|index| index as u32) else { return Vec::new() };
        let whole = self.coarse.whole[patch as usize];
        match key.is_difference() {
            false => self.columns_of(whole),
            true if whole == patch => vec![key],
            true => Vec::new(),
        }
    }

    /// The radiance of a coarse patch: that of the root around it, and the differences from there on. Differences that are
    /// lost lose no energy.
    fn columns_of(&self, mut patch: u32) -> Vec<PatchKey> {
        let mut columns = Vec::new();
        while let Some(Patch { key, .. }) = self.set.patches.get(patch as usize) {
            patch = self.coarse.parents[patch as usize];
            columns.push(if patch == NO_PATCH { *key } else { key.difference() });
        }
        columns
    }

    /// Those of `present` that an overview has: of every coarse patch one of each square of `stride` texels, whichever far surfaces
    /// see well and lies near its middle. Squares with a quarter of their receivers or fewer have none, but a patch has one at least.
    pub fn chosen(&self, present: &HashSet<Name>, stride: u16) -> HashSet<Name> {
        let mut chosen = HashSet::new();
        for run in self.coarse.runs(self.set) {
            let mut squares: BTreeMap<(u32, Texel), Vec<usize>> = BTreeMap::new();
            for entry in run.filter(|&entry| present.contains(&self.name(entry))) {
                let square = self.set.texel[entry].map(|at| at / stride);
                squares.entry((self.set.block[entry], square)).or_default().push(entry);
            }
            let few = usize::from(stride) * usize::from(stride) / 4;
            let most = squares.values().map(Vec::len).max().unwrap_or_default();
            let counts =
                squares.into_values().filter(|entries| entries.len() > few.min(most.saturating_sub(1)));
            chosen.extend(
                counts.filter_map(|entries| self.middle(&entries, stride)).map(|entry| self.name(entry)),
            );
        }
        chosen
    }

    /// Of receivers of one square that which far surfaces see best, to a factor of two, and of these the nearest to the middle.
    fn middle(&self, entries: &[usize], stride: u16) -> Option<usize> {
        let away = |entry: usize| -> u32 {
            let along = |at: u16| u32::from((2 * (at % stride) + 1).abs_diff(stride)).pow(2);
            self.set.texel[entry].map(along).iter().sum()
        };
        let rank = |&entry: &usize| (self.set.area[entry].0 / 16, Reverse(away(entry)), Reverse(entry));
        entries.iter().copied().max_by_key(rank)
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::content::AreaCode;

    use super::*;

    /// A wall of two texels: a patch each, and one of both.
    fn wall() -> PatchSet {
        let key = |level, x| PatchKey::of_cell(level, [x, 0, 0], 1, 0);
        let patch = |key, first_leaf, leaf_count| Patch { key, first_leaf, leaf_count };
        PatchSet {
            patches: vec![patch(key(0, 0), 0, 1), patch(key(0, 1), 1, 1), patch(key(1, 0), 0, 2)],
            leaf_starts: vec![0, 1, 2],
            blocks: vec![7],
            block: vec![0, 0],
            texel: vec![[0, 0], [1, 0]],
            area: vec![AreaCode::ONE; 2],
            sky_parts: 4,
        }
    }

    #[test]
    fn columns_of_a_part_sum_up_to_its_radiance_as_far_as_patches_are_kept() {
        let set = wall();
        let [part, whole] = [set.patches[0].key, set.patches[2].key];
        let fine = OverviewPatches::new(&set, 0);
        assert_eq!(fine.columns(part), [part.difference(), whole]);
        assert_eq!(fine.columns(part.difference()), [part.difference()]);
        assert_eq!(fine.columns_at((7, [1, 0])), Some(vec![set.patches[1].key.difference(), whole]));
        let coarse = OverviewPatches::new(&set, 1);
        assert_eq!(coarse.columns(part), [whole]);
        assert_eq!(coarse.columns(part.difference()), []);
        assert_eq!(coarse.columns(PatchKey::of_sky(3)), [PatchKey::of_sky(3)]);
        assert_eq!(coarse.columns_at((7, [5, 0])), None);
    }

    #[test]
    fn an_overview_has_a_receiver_of_each_square_that_is_seen_and_near_its_middle() {
        let mut set = wall();
        set.texel = (0..16).map(|i| [i % 4, 8 + i / 4]).chain([[4, 8]]).collect();
        (set.block, set.area) = (vec![0; 17], vec![AreaCode::ONE; 17]);
        set.leaf_starts = vec![0, 9, 17];
        let all: HashSet<Name> = set.texel.iter().map(|texel| (7, *texel)).collect();
        // The square on the right has one of its receivers alone.
        let found = OverviewPatches::new(&set, 1).chosen(&all, 4);
        assert_eq!(found, HashSet::from([(7, [1, 9])]));
        // Those in the middle are hidden in a fold.
        for hidden in [5, 6, 9, 10] {
            set.area[hidden] = AreaCode(32);
        }
        assert_eq!(OverviewPatches::new(&set, 1).chosen(&all, 4), HashSet::from([(7, [1, 8])]));
        // A patch has one at least.
        let right: HashSet<Name> = [(7, [4, 8])].into();
        assert_eq!(OverviewPatches::new(&set, 1).chosen(&right, 4), right);
        assert!(OverviewPatches::new(&set, 1).chosen(&HashSet::new(), 4).is_empty());
    }
}
