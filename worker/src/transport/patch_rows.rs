//! Rows over surface patches and parts of the sky: rays' hits, summed over the patches of a cut that suits the rows.
//!
//! A row is whatever is linear in the light that its rays bring, each with a weight of its own: 1 for irradiance at a
//! receiver, a spherical harmonic for a coefficient at a point in free space.

use glam::Vec3;
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::harmonics::relight_direction;

use super::cut::{LeafHits, PatchHits, cut, leaves};
use super::expectation::Expectation;
use crate::lightmap::{Found, Numbering, Surface, World};
use crate::patches::PatchTree;
use crate::rays::Hit;

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
        let (leaf, lit) = match (found.linked, found.own) {
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
    /// Importance-weighted columns (see `expectation.rs`), which are truncated, and the split-half noise in them: the values by
    /// rays of even number less those by rays of odd number. One column more for the common part of all patches, before the
    /// sky's, and one for all of the sky, after them. Empty where nothing is truncated.
    pub importance: [Vec<f32>; 2],
}

/// Sums hits over the patches of the cut that suits all rows; without bounds over all leaves that were hit, for rows that
/// are not truncated. `scale` is the value of a ray of weight 1, `texel_m` the texel's size in metres.
pub fn patch_rows(
    tree: &PatchTree,
    texel_m: f32,
    mut hits_of_rows: Vec<RowHits>,
    scale: f32,
    bounds: Option<CutBounds>,
) -> PatchRows {
    hits_of_rows.iter_mut().for_each(RowHits::sort);
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
    leaf_hits.sort_unstable_by_key(|hits| (hits.leaf, hits.row));
    let hits = PatchHits { tree, leaves: &leaf_hits, rows: hits_of_rows.len() };
    let expectation = Expectation::new(tree, texel_m);
    let patches = match bounds {
        Some(CutBounds { columns_max, error }) => cut(hits, &expectation, columns_max, error),
        None => leaves(tree, &leaf_hits),
    };
    let sky = Numbering::of(hits_of_rows.iter().flat_map(|hits| &hits.sky).map(|hit| hit.at));
    let of_patches = patches.iter().map(|&patch| tree.patches[patch as usize].key.0);
    let of_sky = sky.values().iter().map(|&part| PatchKey::of_sky(part).0);
    let keys = Numbering::of(of_patches.chain(of_sky));
    let is_truncated = bounds.is_some();
    let mut table = Table { hits, expectation, patches, sky, scale, is_truncated, keys, rows: Vec::new() };
    table.begin(&hits_of_rows);
    let by_share = table.add_patches();
    PatchRows { keys: table.keys.into_values(), rows: table.rows, by_share }
}

/// Rows while they are filled.
struct Table<'a> {
    hits: PatchHits<'a>,
    expectation: Expectation<'a>,
    /// Patches of the cut, ascending.
    patches: Vec<u32>,
    /// Parts of the sky that were hit.
    sky: Numbering<u32>,
    /// Value of a ray of weight 1.
    scale: f32,
    is_truncated: bool,
    /// Those of the sky come last.
    keys: Numbering<u64>,
    rows: Vec<PatchRow>,
}

impl Table<'_> {
    fn column(&self, key: PatchKey) -> usize {
        self.keys.place(key.0)
    }

    /// Rows with the sky's columns. Importance-weighted columns stand in the order of keys; the common part of all patches
    /// follows theirs, and that of all of the sky follows the sky's.
    fn begin(&mut self, hits_of_rows: &[RowHits]) {
        let [of_all, of_part] = Expectation::sky();
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

    /// The columns of patches: a patch that is part of another one of the cut has the difference from its share of that.
    /// An opened patch with a part that no row meets has an empty column, and its parts have their light in full: else the
    /// light of the hidden part, however bright, would be in sums that only exact numbers cancel. Gives the patches whose parts'
    /// shares were read.
    fn add_patches(&mut self) -> Vec<u32> {
        let mut by_share = Vec::new();
        let common = self.keys.len() - self.sky.len();
        for index in 0..self.patches.len() {
            let patch = self.patches[index];
            let own = self.column(self.key(patch));
            let parts: Vec<(usize, f32)> = self
                .parts(index)
                .map(|part| (self.column(self.key(part)), self.hits.share(part, patch) as f32))
                .collect();
            let is_whole = self.is_whole(index);
            if is_whole && !parts.is_empty() {
                by_share.push(patch);
            }
            let parent = self.parent(index);
            let deviation = self.expectation.variance(patch, parent).sqrt() as f32;
            for hits in self.hits.of(patch) {
                let row = &mut self.rows[hits.row as usize];
                let [seen, excess] = [hits.sum, hits.excess].map(|sum| sum * self.scale);
                if is_whole {
                    row.alpha[own] += seen;
                    parts.iter().for_each(|&(part, share)| row.alpha[part] -= share * seen);
                }
                if self.is_truncated {
                    for (weighted, value) in row.importance.iter_mut().zip([seen, excess]) {
                        weighted[own] += deviation * value;
                        if parent.is_none() {
                            weighted[common] += Expectation::common() * value;
                        }
                    }
                }
            }
        }
        by_share
    }

    /// Rows meet all parts of a patch of the cut, and all of theirs.
    fn is_whole(&self, index: usize) -> bool {
        self.parts(index).all(|part| {
            let is_met = !self.hits.of(part).is_empty();
            is_met && self.patches.binary_search(&part).is_ok_and(|part| self.is_whole(part))
        })
    }

    fn key(&self, patch: u32) -> PatchKey {
        self.hits.tree.patches[patch as usize].key
    }

    /// Parts of a patch of the cut, if they are in it, as all or none are.
    fn parts(&self, index: usize) -> impl Iterator<Item = u32> + '_ {
        let patch = self.patches[index];
        let is_open = self.patches.get(index + 1) == Some(&(patch + 1))
            && self.hits.tree.patches[patch as usize].end > patch + 1;
        self.hits.tree.parts(patch).take_while(move |_| is_open)
    }

    /// The patch of the cut that a patch of it is part of.
    fn parent(&self, index: usize) -> Option<u32> {
        let patch = self.patches[index];
        // Of those before it whose ends are beyond it, the last.
        self.patches[..index]
            .iter()
            .rev()
            .copied()
            .find(|&other| self.hits.tree.patches[other as usize].end > patch)
    }
}

#[cfg(test)]
mod tests {
    use super::super::cut::tests::tree;
    use super::*;

    /// α of a row that meets the leaves with so many rays, over the root, its first part with both leaves, and its second.
    fn alpha(counts: [u32; 4]) -> Vec<f32> {
        let ray = |at: u32, ray: u32| RayHit { at, is_even: ray.is_multiple_of(2), weight: 1.0 };
        let of_leaf = |leaf: u32| (0..counts[leaf as usize]).map(move |index| ray(leaf, index));
        let hits = RowHits { leaves: (0..4).flat_map(of_leaf).collect(), sky: Vec::new() };
        let bounds = CutBounds { columns_max: 100, error: 0.01 };
        let found = patch_rows(&tree(), 0.1, vec![hits], 1.0, Some(bounds));
        assert_eq!(found.keys, [0, 1, 2, 3, 4]);
        found.rows[0].alpha.clone()
    }

    #[test]
    fn parts_that_are_met_are_differences_from_their_share() {
        assert_eq!(alpha([400, 200, 150, 150]), [900.0, 150.0, 100.0, -100.0, -150.0]);
    }

    #[test]
    fn hidden_part_is_in_no_column_and_neither_is_anything_that_holds_it() {
        assert_eq!(alpha([600, 0, 150, 150]), [0.0, 0.0, 600.0, 0.0, 300.0]);
    }
}
