//! Rows over surface patches and parts of the sky: rays' hits, summed over the patches of a cut that suits the rows.
//!
//! A row is whatever is linear in the light that its rays bring, each with a weight of its own: 1 for irradiance at a
//! receiver, a spherical harmonic for a coefficient at a point in free space.

use glam::Vec3;
use lightkiln_proto::chunk::column_deviation;
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::harmonics::relight_direction;
use rayon::prelude::*;

use super::cut::{LeafHits, PatchHits, cut, leaves};
use super::expectation::{self, Expectation};
use crate::lightmap::{Found, Numbering, Surface, World};
use crate::patches::PatchTree;
use crate::rays::Hit;

/// Leaves for each hit up to which a table of leaves sorts faster than comparisons.
const TABLE_SHARE: usize = 4;

/// Sources of light as rays meet them.
pub struct Sources<'a> {
    world: &'a World,
    tree: &'a PatchTree,
    /// Directions of the parts of the sky.
    sky: Vec<Vec3>,
}

/// A hit's source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// The hit, and the receivers that stand for it.
    pub found: Found,
    /// Leaf patch of the receiver that it is linked to.
    pub leaf: Option<u32>,
    /// Share of the ray that light can come along, carried by the leaf or lost: 1, or 0 where nothing returns any. Of no colour,
    /// so that a material's leaves the rays as they are.
    pub lit: f32,
}

impl<'a> Sources<'a> {
    /// Sources of a scene whose sky has so many parts.
    pub fn new(world: &'a World, tree: &'a PatchTree, sky_parts: u32) -> Self {
        Self { world, tree, sky: (0..sky_parts).map(|part| relight_direction(part, sky_parts)).collect() }
    }

    /// Part of the sky in a direction: the nearest, of equally near ones the first.
    pub fn sky(&self, direction: Vec3) -> u32 {
        let mut best = (0, f32::NEG_INFINITY);
        for (index, other) in self.sky.iter().enumerate() {
            let cosine = direction.dot(*other);
            if cosine > best.1 {
                best = (index, cosine);
            }
        }
        best.0 as u32
    }

    /// Source at a hit, `point_m` being its place in metres.
    pub fn at(&self, hit: &Hit, point_m: Vec3) -> Met {
        let found = self.world.found_at(hit, point_m);
        let (leaf, lit) = match (found.read, found.own) {
            (Surface::Receiver(met), _) => (Some(self.tree.leaf_of_receiver[met as usize]), 1.0),
            // Walls stand between the hit and all texels around it: no texel stands for it.
            (_, Surface::Receiver(_)) => (None, 1.0),
            _ => (None, if self.world.is_in_cavity(hit) { 1.0 } else { 0.0 }),
        };
        Met { found, leaf, lit }
    }
}

/// A ray's hit on a leaf patch or a part of the sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Leaf, or part of the sky.
    pub at: u32,
    /// Whether the ray's number is even: the noise of a row is in the difference of its halves.
    pub is_even: bool,
    /// Weight of the ray in the row.
    pub weight: f32,
}

/// Hits of one row's rays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowHits {
    /// On leaf patches.
    pub leaves: Vec<RayHit>,
    /// On parts of the sky.
    pub sky: Vec<RayHit>,
}

impl RowHits {
    /// Sums run by source, odd rays first, in the order of the rays.
    fn sort(&mut self) {
        for hits in [&mut self.leaves, &mut self.sky] {
            hits.sort_by_key(|hit| (hit.at, hit.is_even));
        }
    }
}

/// Bounds of a cut, for rows that are truncated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutBounds {
    /// Most patches.
    pub columns_max: usize,
    /// Error by taking patches whole, as a share of the rows' root of squares.
    pub error: f32,
}

/// Rows over the patches of a cut.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchRows {
    /// Patches of the cut and parts of the sky, ascending; those of the sky come last.
    pub keys: Vec<u64>,
    /// In the order of the hits.
    pub rows: Vec<PatchRow>,
    /// Patches of the cut whose parts are told by their shares of its area: nothing else hangs on areas exactly.
    pub by_share: Vec<u32>,
}

/// One row over patches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchRow {
    /// α, in the order of the keys.
    pub alpha: Vec<f32>,
    /// Importance-weighted columns ([`column_deviation`]), which are truncated, and the split-half noise in them: the values by
    /// rays of even number less those by rays of odd number. One column more for the common part of all patches, before the
    /// sky's, and one for all of the sky, after them. Empty where nothing is truncated.
    pub importance: [Vec<f32>; 2],
}

impl PatchRow {
    /// A row over such keys, patches' before the sky's, that is known exactly.
    pub fn without_noise(keys: &[u64], alpha: Vec<f32>) -> Self {
        let [of_all, of_part] = expectation::sky();
        let common = keys.partition_point(|&key| PatchKey(key).sky().is_none());
        let mut values = vec![0.0; keys.len() + 2];
        for (column, (&key, &alpha)) in keys.iter().zip(&alpha).enumerate() {
            if column < common {
                values[column] = column_deviation(key) * alpha;
                values[common] +=
                    if PatchKey(key).is_difference() { 0.0 } else { expectation::common() * alpha };
            } else {
                values[column + 1] = of_part * alpha;
                values[keys.len() + 1] += of_all * alpha;
            }
        }
        Self { importance: [values, vec![0.0; keys.len() + 2]], alpha }
    }
}

/// Sums hits, which it sorts, over the patches of the cut that suits all rows; without bounds over all leaves that were hit, for rows that
/// are not truncated. `scale` is the value of a ray of weight 1, `texel_m` the texel's size in metres.
pub fn patch_rows(
    tree: &PatchTree,
    texel_m: f32,
    hits_of_rows: &mut [RowHits],
    scale: f32,
    bounds: Option<CutBounds>,
) -> PatchRows {
    hits_of_rows.par_iter_mut().for_each(RowHits::sort);
    let mut leaf_hits: Vec<LeafHits> = Vec::new();
    for (row, hits) in hits_of_rows.iter().enumerate() {
        leaf_hits.extend(hits.leaves.chunk_by(|a, b| a.at == b.at).map(|same| LeafHits {
            leaf: same[0].at,
            row: row as u32,
            sum: same.iter().map(|hit| hit.weight).sum(),
            excess: same.iter().map(|hit| if hit.is_even { hit.weight } else { -hit.weight }).sum(),
            squares: same.iter().map(|hit| hit.weight * hit.weight).sum(),
        }));
    }
    let leaf_hits = by_leaf(leaf_hits, tree.leaf_starts.len());
    let hits = PatchHits { tree, leaves: &leaf_hits, rows: hits_of_rows.len() };
    let expectation = Expectation::new(tree, texel_m);
    let patches = match bounds {
        Some(CutBounds { columns_max, error }) => cut(hits, &expectation, columns_max, error),
        None => leaves(tree, &leaf_hits),
    };
    let sky = Numbering::of(hits_of_rows.iter().flat_map(|hits| &hits.sky).map(|hit| hit.at));
    let columns = PatchColumns::of(hits, &patches);
    let of_patches = columns.columns.iter().map(|column| column.key.0);
    let of_sky = sky.values().iter().map(|&part| PatchKey::of_sky(part).0);
    let keys = Numbering::of(of_patches.chain(of_sky));
    let mut table = Table { sky, scale, is_truncated: bounds.is_some(), keys, rows: Vec::new() };
    table.begin(hits_of_rows);
    table.add_patches(hits, &columns);
    PatchRows { keys: table.keys.into_values(), rows: table.rows, by_share: columns.by_share }
}

/// Hits, which come by row, in the order of leaves, and those on one leaf in that of rows. Few of many leaves are sorted, as a table of all
/// would cost more.
fn by_leaf(mut hits: Vec<LeafHits>, leaves: usize) -> Vec<LeafHits> {
    if hits.len() * TABLE_SHARE < leaves {
        hits.sort_unstable_by_key(|hits| (hits.leaf, hits.row));
        return hits;
    }
    let mut ends = vec![0; leaves + 1];
    hits.iter().for_each(|hits| ends[hits.leaf as usize + 1] += 1_u32);
    let mut before = 0;
    for end in &mut ends {
        before += *end;
        *end = before;
    }
    let Some(&any) = hits.first() else { return Vec::new() };
    let mut sorted = vec![any; hits.len()];
    for hits in &hits {
        let place = &mut ends[hits.leaf as usize];
        sorted[*place as usize] = *hits;
        *place += 1;
    }
    sorted
}

/// A column of patches.
struct PatchColumn {
    /// Its key.
    key: PatchKey,
    patch: u32,
    /// Of a difference: the part that has no column, and this part's share of area over that part's.
    against: Option<(u32, f32)>,
}

/// Columns of the patches of a cut.
///
/// With A_n the share of patch n in a row, the parts n of an opened patch p give `Σ_n A_n L_n = A_p L_p + Σ_n A_n (L_n − L_p)`. The
/// differences' sum by area is 0, so that of the part l of the largest area follows from the others: it has no column,
/// and theirs are `A_n − (area_n / area_l) A_l`. Numbers are small where rows meet parts as their areas promise, and an error
/// in them counts by differences of light alone.
///
/// An opened patch with a part that no row meets has no column, and its parts have their light in full: else the light of
/// the hidden part, however bright, would be in sums that only exact numbers cancel.
struct PatchColumns {
    columns: Vec<PatchColumn>,
    /// Patches of the cut that are part of no other.
    roots: Vec<u32>,
    /// Opened patches whose parts' shares of area were read.
    by_share: Vec<u32>,
}

impl PatchColumns {
    /// Of a cut, ascending.
    fn of(hits: PatchHits<'_>, cut: &[u32]) -> Self {
        let tree = hits.tree;
        let parents = parents(tree, cut);
        let parts = |whole: u32| tree.parts(whole);
        let is_open = |index: usize| parents.get(index + 1) == Some(&Some(index));
        // Rows meet all parts of the patch, and all of theirs. Parts come after their wholes.
        let mut is_whole = vec![true; cut.len()];
        for index in (0..cut.len()).rev() {
            let is_met = !hits.of(cut[index]).is_empty();
            if let Some(parent) = parents[index] {
                is_whole[parent] &= is_met && is_whole[index];
            }
        }
        let mut found = Self { columns: Vec::new(), roots: Vec::new(), by_share: Vec::new() };
        for (index, &patch) in cut.iter().enumerate() {
            let key = tree.patches[patch as usize].key;
            if parents[index].is_none() {
                found.roots.push(patch);
            }
            if is_open(index) && is_whole[index] {
                found.by_share.push(patch);
            }
            match parents[index].filter(|&parent| is_whole[parent]).map(|parent| cut[parent]) {
                Some(whole) => {
                    let largest = |a: &u32, b: &u32| {
                        hits.share(*a, whole).total_cmp(&hits.share(*b, whole)).then(b.cmp(a))
                    };
                    let left_out = parts(whole).max_by(largest).unwrap_or(patch);
                    if left_out != patch {
                        let ratio = (hits.share(patch, whole) / hits.share(left_out, whole)) as f32;
                        let against = Some((left_out, ratio));
                        found.columns.push(PatchColumn { key: key.difference(), patch, against });
                    }
                }
                None if is_open(index) && !is_whole[index] => {}
                None => found.columns.push(PatchColumn { key, patch, against: None }),
            }
        }
        found
    }
}

/// Index in an ascending cut of the patch that each of its patches is part of.
fn parents(tree: &PatchTree, cut: &[u32]) -> Vec<Option<usize>> {
    let mut wholes: Vec<usize> = Vec::new();
    let mut parents = Vec::with_capacity(cut.len());
    for (index, &patch) in cut.iter().enumerate() {
        while wholes.last().is_some_and(|&whole| tree.patches[cut[whole] as usize].end <= patch) {
            wholes.pop();
        }
        parents.push(wholes.last().copied());
        wholes.push(index);
    }
    parents
}

/// Rows while they are filled.
struct Table {
    /// Parts of the sky that were hit.
    sky: Numbering<u32>,
    /// Value of a ray of weight 1.
    scale: f32,
    is_truncated: bool,
    /// Those of the sky come last.
    keys: Numbering<u64>,
    rows: Vec<PatchRow>,
}

impl Table {
    fn column(&self, key: PatchKey) -> usize {
        self.keys.place(key.0)
    }

    /// Rows with the sky's columns. Importance-weighted columns stand in the order of keys; the common part of all patches
    /// follows theirs, and that of all of the sky follows the sky's.
    fn begin(&mut self, hits_of_rows: &[RowHits]) {
        let [of_all, of_part] = expectation::sky();
        let of_parts = self.sky.values().iter();
        let columns: Vec<usize> = of_parts.map(|&part| self.column(PatchKey::of_sky(part))).collect();
        for hits in hits_of_rows {
            let mut row = PatchRow { alpha: vec![0.0; self.keys.len()], ..PatchRow::default() };
            if self.is_truncated {
                row.importance = [(); 2].map(|()| vec![0.0; self.keys.len() + 2]);
            }
            for hit in &hits.sky {
                let column = columns[self.sky.place(hit.at)];
                let value = self.scale * hit.weight;
                row.alpha[column] += value;
                let signs = [1.0, if hit.is_even { 1.0 } else { -1.0 }];
                for (weighted, sign) in row.importance.iter_mut().zip(signs) {
                    if let [.., last] = &mut weighted[..] {
                        *last += of_all * value * sign;
                        weighted[column + 1] += of_part * value * sign;
                    }
                }
            }
            self.rows.push(row);
        }
    }

    /// The columns of patches.
    fn add_patches(&mut self, hits: PatchHits<'_>, columns: &PatchColumns) {
        for PatchColumn { key, patch, against } in &columns.columns {
            let column = self.column(*key);
            self.add(hits.of(*patch), column, key.0, 1.0);
            if let Some((left_out, ratio)) = against {
                self.add(hits.of(*left_out), column, key.0, -ratio);
            }
        }
        if self.is_truncated {
            let common = self.keys.len() - self.sky.len();
            for hits in columns.roots.iter().flat_map(|&root| hits.of(root)) {
                let [values, noise] = &mut self.rows[hits.row as usize].importance;
                values[common] += expectation::common() * self.scale * hits.sum;
                noise[common] += expectation::common() * self.scale * hits.excess;
            }
        }
    }

    /// Adds hits to a column, `factor` times.
    fn add(&mut self, hits: &[LeafHits], column: usize, key: u64, factor: f32) {
        let deviation = column_deviation(key);
        for hits in hits {
            let row = &mut self.rows[hits.row as usize];
            let [seen, excess] = [hits.sum, hits.excess].map(|sum| sum * self.scale * factor);
            row.alpha[column] += seen;
            if self.is_truncated {
                row.importance[0][column] += deviation * seen;
                row.importance[1][column] += deviation * excess;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::cut::tests::tree;
    use super::*;

    /// Columns of a row that meets the leaves with so many rays, as patch, whether it is a difference, and α.
    fn columns(counts: [u32; 4]) -> Vec<(u64, bool, f32)> {
        let ray = |at: u32, ray: u32| RayHit { at, is_even: ray.is_multiple_of(2), weight: 1.0 };
        let of_leaf = |leaf: u32| (0..counts[leaf as usize]).map(move |index| ray(leaf, index));
        let hits = RowHits { leaves: (0..4).flat_map(of_leaf).collect(), sky: Vec::new() };
        let bounds = CutBounds { columns_max: 100, error: 0.01 };
        let found = patch_rows(&tree(), 0.1, &mut [hits], 1.0, Some(bounds));
        let keys = found.keys.iter().map(|&key| PatchKey(key));
        let columns = keys.zip(&found.rows[0].alpha);
        columns.map(|(key, &alpha)| (key.patch().0, key.is_difference(), alpha)).collect()
    }

    #[test]
    fn parts_that_are_met_are_differences_but_for_the_largest() {
        assert_eq!(columns([400, 200, 150, 150]), [(0, false, 900.0), (3, true, -200.0), (4, true, -300.0)]);
    }

    #[test]
    fn hits_come_by_leaf_and_keep_their_order_of_rows() {
        let hit = |leaf: u32, row: u32| LeafHits { leaf, row, sum: 1.0, excess: 0.0, squares: 1.0 };
        let by_row = [hit(2, 0), hit(4, 0), hit(0, 1), hit(4, 1), hit(2, 5)];
        for leaves in [5, 1000] {
            let sorted = by_leaf(by_row.to_vec(), leaves);
            assert_eq!(sorted, [hit(0, 1), hit(2, 0), hit(2, 5), hit(4, 0), hit(4, 1)]);
            assert_eq!(by_leaf(Vec::new(), leaves), []);
        }
    }

    #[test]
    fn hidden_part_is_in_no_column_and_neither_is_anything_that_holds_it() {
        assert_eq!(columns([600, 0, 150, 150]), [(2, false, 600.0), (3, false, 0.0), (4, false, 300.0)]);
    }

    #[test]
    fn columns_of_differences_give_what_leaves_give() {
        let (counts, light) = ([7.0, 1.0, 4.0, 5.0], [0.3, 2.0, 5.0, 1.0]);
        let mean = |patch: u64| match patch {
            0 => light.iter().sum::<f32>() / 4.0,
            1 => (light[0] + light[1]) / 2.0,
            4 => (light[2] + light[3]) / 2.0,
            leaf => light[[0, 0, 0, 1, 0, 2, 3][leaf as usize]],
        };
        let parent = [0, 0, 1, 1, 0, 4, 4];
        let found = columns(counts.map(|count| (100.0 * count) as u32));
        assert!(found.iter().filter(|column| column.1).count() == 3, "{found:?}");
        let read = |(patch, is_difference, alpha): &(u64, bool, f32)| {
            let less = if *is_difference { mean(parent[*patch as usize]) } else { 0.0 };
            alpha * (mean(*patch) - less)
        };
        let sum: f32 = found.iter().map(read).sum();
        let direct: f32 = counts.iter().zip(light).map(|(count, light)| 100.0 * count * light).sum();
        assert!((sum - direct).abs() < 1e-2, "{sum} {direct}");
    }
}
