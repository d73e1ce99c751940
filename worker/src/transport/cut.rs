//! The cut through the tree of patches that rows of a cell tell apart.
//!
//! With A_n the share of patch n in a row, of receivers that in their view, and p its parent, `D_n = A_n − (area_n / area_p) A_p` is the excess
//! of n over its share of p's seen area, and `Σ_leaves A L = Σ_roots A L + Σ_others D L` for the mean radiances L of
//! patches: the field of transport in the unnormalised Haar basis of the tree. Where the D of a patch's parts are small for
//! all rows of the cell, the patch need not be opened. The gain of opening is `Σ_parts σ² Σ_r D²`, with σ² the variance
//! that the parts' radiance is expected to have about their parent's ([`super::expectation`]).
//!
//! D² of single rows is mostly chance, as few of their rays meet a part. With X as D, but of the rays of even number
//! less those of odd number, `D² − X²` is the product of two independent halves' estimates, and right in the mean (split-half
//! noise). The common part of all rows is known better: `Σ_r D² ≥ (Σ_r D)² / R`. It tells where a thing hides the same
//! parts from all of them, and the cell's energy hangs on it, as parts hidden from receivers often are from lamps.

use rayon::prelude::*;

use super::expectation::Expectation;
use crate::patches::PatchTree;

/// Deviations of chance by which a gain is lowered before it counts.
const CHANCE: f64 = 1.0;
/// Steps of the search for the least gain that a column must bring.
const SEARCH_STEPS: usize = 40;

/// Level of a patch above which gains take areas in steps: an edit within a large patch would change its area, and so the task of
/// every receiver that sees any of it.
pub const FINE_LEVEL: u64 = 4;
/// Steps of such areas in a doubling. More → truer gains, more tasks that an edit changes.
const AREA_STEPS: f64 = 64.0;

/// Area of a patch as gains of patches above [`FINE_LEVEL`] have it, in texels.
pub fn stepped_area(area_texels: f32) -> f64 {
    if area_texels <= 0.0 {
        return 0.0;
    }
    libm::exp2(libm::round(libm::log2(area_texels.into()) * AREA_STEPS) / AREA_STEPS)
}

/// Hits of a row's rays on a leaf, each of the weight that the ray has in the row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeafHits {
    /// Leaf patch.
    pub leaf: u32,
    /// Row.
    pub row: u32,
    /// Sum of weights: of receivers, whose rays weigh 1, their number.
    pub sum: f32,
    /// That of rays of even number less that of rays of odd number.
    pub excess: f32,
    /// Sum of squared weights.
    pub squares: f32,
}

/// Hits of rays by patch.
#[derive(Clone, Copy)]
pub struct PatchHits<'a> {
    /// All patches.
    pub tree: &'a PatchTree,
    /// Ascending by leaf, then row.
    pub leaves: &'a [LeafHits],
    /// Rows.
    pub rows: usize,
}

impl<'a> PatchHits<'a> {
    /// Hits on a patch's leaves.
    pub fn of(self, patch: u32) -> &'a [LeafHits] {
        let patch = &self.tree.patches[patch as usize];
        let start = self.leaves.partition_point(|hits| hits.leaf < patch.first_leaf);
        let end = self.leaves.partition_point(|hits| hits.leaf < patch.first_leaf + patch.leaf_count);
        &self.leaves[start..end]
    }

    /// Share of its parent's seen area that a part has.
    pub fn share(self, part: u32, parent: u32) -> f64 {
        let area = |patch: u32| f64::from(self.tree.patches[patch as usize].seen_texels);
        area(part) / area(parent)
    }

    /// The same as gains have it.
    fn share_in_gains(self, part: u32, parent: u32) -> f64 {
        if self.tree.patches[parent as usize].key.level() <= FINE_LEVEL {
            return self.share(part, parent);
        }
        let area = |patch: u32| stepped_area(self.tree.patches[patch as usize].seen_texels);
        area(part) / area(parent)
    }
}

/// `sum`, `excess` and `squares` of each row's hits on a patch.
struct Sums {
    of_row: Vec<[f64; 3]>,
    /// Rows with hits, ascending: most patches are met by few.
    met: Vec<u32>,
}

impl Sums {
    /// Sums of so many rows, none met.
    fn new(rows: usize) -> Self {
        Self { of_row: vec![[0.0; 3]; rows], met: Vec::new() }
    }

    /// Of those hits alone.
    fn take(&mut self, hits: &[LeafHits]) {
        self.met.drain(..).for_each(|row| self.of_row[row as usize] = [0.0; 3]);
        for hits in hits {
            let sums = &mut self.of_row[hits.row as usize];
            if *sums == [0.0; 3] {
                self.met.push(hits.row);
            }
            for (sum, more) in sums.iter_mut().zip([hits.sum, hits.excess, hits.squares]) {
                *sum += f64::from(more);
            }
        }
        self.met.sort_unstable();
        self.met.dedup();
    }
}

/// The patches of the cut, ascending: roots that were hit, and all parts of those whose opening pays. A column must
/// lower the loss, as a share of the rows' squared sums, by `error²/columns_max` at least; by more, where more than
/// `columns_max` do.
pub fn cut(hits: PatchHits<'_>, expectation: &Expectation, columns_max: usize, error: f32) -> Vec<u32> {
    let seen = Seen::new(hits, expectation);
    // Take the error relative to the rows' own energy, so that a dim corner is cut as finely as a bright room.
    let mut sums = vec![0.0; hits.rows];
    hits.leaves.iter().for_each(|of_leaf| sums[of_leaf.row as usize] += f64::from(of_leaf.sum));
    let total: f64 = sums.iter().map(|sum| sum * sum).sum();
    let least = total * f64::from(error).powi(2) / columns_max as f64;
    let mut best = seen.opened(least);
    if best.len() > columns_max {
        // Too many columns pay: raise the price of one until few enough do. The count falls with the price, so halve the
        // interval between a price that is too low and one that is not.
        let (mut low, mut high) = (least, total.max(least));
        for _ in 0..SEARCH_STEPS {
            let middle = (low * high).sqrt();
            if seen.opened(middle).len() > columns_max {
                low = middle;
            } else {
                high = middle;
            }
        }
        best = seen.opened(high);
    }
    best
}

/// The leaves that were hit, as patches, ascending.
pub fn leaves(tree: &PatchTree, leaf_hits: &[LeafHits]) -> Vec<u32> {
    let is_hit = |leaf: u32| leaf_hits.binary_search_by_key(&leaf, |hits| hits.leaf).is_ok();
    (0..tree.patches.len() as u32)
        .filter(|&patch| {
            let patch = &tree.patches[patch as usize];
            patch.leaf_count == 1 && is_hit(patch.first_leaf)
        })
        .collect()
}

/// Value of opening a patch by itself: `Σ_parts σ² Σ_r D²`, less chance. `of` is room for sums, of the patch and of a part.
fn gain(hits: PatchHits<'_>, expectation: &Expectation, patch: u32, of: &mut [Sums; 2]) -> f64 {
    let [of_whole, of_part] = of;
    of_whole.take(hits.of(patch));
    let seeing = of_whole.met.iter().filter(|row| of_whole.of_row[**row as usize][2] > 0.0).count() as f64;
    let mut sum = 0.0;
    for part in hits.tree.parts(patch) {
        let share = hits.share_in_gains(part, patch);
        of_part.take(hits.of(part));
        let (mut squares, mut all, mut variance) = (0.0, 0.0, 0.0);
        for &row in &of_whole.met {
            let [part, whole] = [&*of_part, of_whole].map(|of| &of.of_row[row as usize]);
            // D, and X of the same rays with alternating signs: D² − X² is free of the noise of counting.
            let [d, x] = [0, 1].map(|i| part[i] - share * whole[i]);
            squares += d * d - x * x;
            all += d;
            variance += part[2];
        }
        // D and X of chance alone have about the sum of squared weights for variance, D² − X² its square four times.
        let of_each = squares - CHANCE * 2.0 * variance / seeing.sqrt();
        // The common part is surer than its rows: a wall that hides the part from all of them shows here first.
        let of_all = (all * all - CHANCE * 2.0 * variance) / hits.rows as f64;
        sum += expectation.variance(part, Some(patch)) * of_each.max(of_all);
    }
    sum
}

/// The patches that were hit.
struct Seen<'a> {
    tree: &'a PatchTree,
    /// Ascending, so that parts come after their wholes.
    patches: Vec<SeenPatch>,
}

struct SeenPatch {
    patch: u32,
    /// Place among those seen of the patch that it is part of.
    parent: Option<usize>,
    /// Value of opening it by itself.
    gain: f64,
    /// Its parts, hit or not.
    parts: usize,
}

impl<'a> Seen<'a> {
    fn new(hits: PatchHits<'a>, expectation: &Expectation) -> Self {
        let tree = hits.tree;
        let mut patches = Vec::new();
        let mut next: Vec<(u32, Option<usize>)> = tree.roots().map(|root| (root, None)).collect();
        next.reverse();
        while let Some((patch, parent)) = next.pop() {
            if hits.of(patch).is_empty() {
                continue;
            }
            let own = patches.len();
            let parts: Vec<u32> = tree.parts(patch).collect();
            patches.push(SeenPatch { patch, parent, gain: 0.0, parts: parts.len() });
            next.extend(parts.into_iter().rev().map(|part| (part, Some(own))));
        }
        patches.par_iter_mut().filter(|seen| seen.parts > 0).for_each_init(
            || [(); 2].map(|()| Sums::new(hits.rows)),
            |room, seen| seen.gain = gain(hits, expectation, seen.patch, room),
        );
        Self { tree, patches }
    }

    /// Roots, and parts of patches whose opening, with everything that can be opened in them, brings `least` a column.
    fn opened(&self, least: f64) -> Vec<u32> {
        // Value net of columns, from the leaves up: a patch whose own opening brings little is opened for its parts' sake.
        let mut value = vec![0.0; self.patches.len()];
        for (index, seen) in self.patches.iter().enumerate().rev() {
            value[index] = (value[index] + seen.gain - least * seen.parts as f64).max(0.0);
            if let Some(parent) = seen.parent {
                value[parent] += value[index];
            }
        }
        // From the roots down, as a patch is only reached through open ones.
        let is_open = |index: usize| value[index] > 0.0;
        let mut found = Vec::new();
        let mut reached = vec![false; self.patches.len()];
        for (index, seen) in self.patches.iter().enumerate() {
            reached[index] = seen.parent.is_none_or(|parent| reached[parent] && is_open(parent));
            if !reached[index] {
                continue;
            }
            if seen.parent.is_none() {
                found.push(seen.patch);
            }
            if is_open(index) {
                found.extend(self.tree.parts(seen.patch));
            }
        }
        found.sort_unstable();
        found
    }
}

#[cfg(test)]
pub(super) mod tests {
    use glam::Vec3;
    use lightkiln_proto::content::PatchKey;

    use super::*;
    use crate::patches::Patch;

    /// A root of two parts, each of two leaves of one receiver, 1 m apart along x.
    pub fn tree() -> PatchTree {
        let patch = |key, first_leaf: u32, leaf_count: u32, end| Patch {
            key: PatchKey(key),
            first_leaf,
            leaf_count,
            end,
            bounds_m: [first_leaf, first_leaf + leaf_count - 1].map(|leaf| Vec3::X * leaf as f32),
            seen_texels: leaf_count as f32,
        };
        PatchTree {
            patches: vec![
                patch(0, 0, 4, 7),
                patch(1, 0, 2, 4),
                patch(2, 0, 1, 3),
                patch(3, 1, 1, 4),
                patch(4, 2, 2, 7),
                patch(5, 2, 1, 6),
                patch(6, 3, 1, 7),
            ],
            leaf_of_receiver: vec![0, 1, 2, 3],
            receivers: vec![0, 1, 2, 3],
            leaf_starts: vec![0, 1, 2, 3, 4],
            by_key: (0..7).collect(),
            ..PatchTree::default()
        }
    }

    /// Hits of row 0 by so many rays of weight 1, half of them of even number.
    fn hits(leaf: u32, count: u32) -> LeafHits {
        LeafHits { leaf, row: 0, sum: count as f32, excess: 0.0, squares: count as f32 }
    }

    fn evenly_hit() -> Vec<LeafHits> {
        (0..4).map(|leaf| hits(leaf, 100)).collect()
    }

    fn cut_of(leaf_hits: &[LeafHits], columns_max: usize) -> Vec<u32> {
        let tree = tree();
        let met = PatchHits { tree: &tree, leaves: leaf_hits, rows: 1 };
        cut(met, &Expectation::new(&tree, 0.1), columns_max, 0.01)
    }

    #[test]
    fn patch_hit_as_its_areas_promise_stays_whole() {
        assert_eq!(cut_of(&evenly_hit(), 100), [0]);
    }

    #[test]
    fn patch_is_opened_as_deep_as_its_parts_are_hit_otherwise() {
        let met = |counts: [u32; 4]| -> Vec<LeafHits> {
            (0..4)
                .zip(counts)
                .filter(|(_, count)| *count > 0)
                .map(|(leaf, count)| hits(leaf, count))
                .collect()
        };
        assert_eq!(cut_of(&met([200, 200, 0, 0]), 100), [0, 1, 4]);
        assert_eq!(cut_of(&met([200, 200, 200, 0]), 100), [0, 1, 4, 5, 6]);
        // Halves that are hit alike are opened for the sake of their parts.
        assert_eq!(cut_of(&met([200, 0, 200, 0]), 100), [0, 1, 2, 3, 4, 5, 6]);
    }

    #[test]
    fn differences_that_halves_of_the_rays_do_not_share_open_nothing() {
        let of_row =
            |row: u32| LeafHits { row, excess: 1.0 - 2.0 * (row / 4 % 2) as f32, ..hits(row % 4, 1) };
        let mut met: Vec<LeafHits> = (0..64).map(of_row).collect();
        met.sort_unstable_by_key(|hits| (hits.leaf, hits.row));
        let tree = tree();
        let met = PatchHits { tree: &tree, leaves: &met, rows: 64 };
        assert_eq!(cut(met, &Expectation::new(&tree, 0.1), 100, 0.01), [0]);
    }

    #[test]
    fn where_columns_are_few_only_the_best_are_there() {
        let skewed: Vec<LeafHits> = [300, 100, 30, 0]
            .into_iter()
            .zip(0..)
            .filter(|(count, _)| *count > 0)
            .map(|(count, leaf)| hits(leaf, count))
            .collect();
        assert_eq!(cut_of(&skewed, 100), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(cut_of(&skewed, 5), [0, 1, 2, 3, 4]);
        assert_eq!(cut_of(&skewed, 3), [0, 1, 4]);
        assert_eq!(cut_of(&skewed, 1), [0]);
    }

    #[test]
    fn columns_of_the_cut_give_what_its_leaves_give() {
        let tree = tree();
        let counts = [7.0, 1.0, 4.0, 0.0];
        let light = [0.3, 2.0, 5.0, 1.0];
        let of = |values: [f64; 4], patch: u32| -> f64 {
            let patch = &tree.patches[patch as usize];
            let leaves = patch.first_leaf as usize..(patch.first_leaf + patch.leaf_count) as usize;
            values[leaves].iter().sum()
        };
        let leaf_hits: Vec<LeafHits> = (0..3).map(|leaf| hits(leaf, counts[leaf as usize] as u32)).collect();
        let met = PatchHits { tree: &tree, leaves: &leaf_hits, rows: 1 };
        let mean = |patch: u32| of(light, patch) / f64::from(tree.patches[patch as usize].leaf_count);
        let sum_of = |patch: u32| met.of(patch).iter().map(|hits| f64::from(hits.sum)).sum::<f64>();
        let mut sum = sum_of(0) * mean(0);
        for (part, parent) in [(1, 0), (4, 0), (2, 1), (3, 1), (5, 4), (6, 4)] {
            let difference = sum_of(part) - met.share(part, parent) * sum_of(parent);
            sum += difference * mean(part);
        }
        let direct: f64 = counts.iter().zip(light).map(|(count, light)| count * light).sum();
        assert!((sum - direct).abs() < 1e-9, "{sum} {direct}");
    }
}
