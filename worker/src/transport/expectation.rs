//! Expected variances of patches' radiance, before any light is known: near patches that face the same way shine alike, and
//! some light is everywhere.
//!
//! Radiance is taken for a sum of independent parts: one that all patches have in common, and one for each patch of the
//! tree that its own parts share, with the variance σ² that a patch's mean has about its parent's. The cut opens patches by
//! it. Columns are truncated by what light was found to be ([`column_deviation`]).
//!
//! [`column_deviation`]: lightkiln_proto::chunk::column_deviation

use crate::patches::PatchTree;

/// Share of the variance that all patches have in common.
const COMMON: f64 = 0.15;
/// Share of the sky's variance that all its parts have in common.
const SKY_COMMON: f64 = 0.3;
/// Distances in texels over which radiance is alike, a like part of it over each: lights and shadows are of every size.
const REACHES_TEXELS: [f64; 3] = [4.0, 16.0, 64.0];
/// Variance that a patch's mean has about its parent's, at least.
const OWN_MIN: f64 = 0.005;

/// Expected variances of a tree's patches.
#[derive(Clone, Copy)]
pub struct Expectation<'a> {
    tree: &'a PatchTree,
    texel_m: f32,
}

impl<'a> Expectation<'a> {
    /// Of a tree over texels of `texel_m`.
    pub fn new(tree: &'a PatchTree, texel_m: f32) -> Self {
        Self { tree, texel_m }
    }

    /// σ² of a patch: of its mean about that of its parent, or about the common mean.
    pub fn variance(&self, patch: u32, parent: Option<u32>) -> f64 {
        let within = |patch: u32| (1.0 - COMMON) * within(self.size_texels(patch));
        let about = parent.map_or(1.0 - COMMON, within);
        (about - within(patch)).max(OWN_MIN)
    }

    fn size_texels(&self, patch: u32) -> f64 {
        let [low_m, high_m] = self.tree.patches[patch as usize].bounds_m;
        f64::from(low_m.distance(high_m) / self.texel_m)
    }
}

/// Deviation of the part that all patches have in common.
pub fn common() -> f32 {
    COMMON.sqrt() as f32
}

/// Deviations of the part that all parts of the sky have in common, and of each one's own.
pub fn sky() -> [f32; 2] {
    [SKY_COMMON.sqrt() as f32, (1.0 - SKY_COMMON).sqrt() as f32]
}

/// Share of the variance that lies within a patch of a size.
fn within(size_texels: f64) -> f64 {
    let of_reach = |reach: f64| size_texels / (size_texels + reach);
    REACHES_TEXELS.into_iter().map(of_reach).sum::<f64>() / REACHES_TEXELS.len() as f64
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use lightkiln_proto::content::PatchKey;

    use super::*;
    use crate::patches::Patch;

    #[test]
    fn variances_from_a_root_to_a_leaf_sum_up_to_all_that_is_not_common_nor_within_the_leaf() {
        let sizes = [1000.0, 100.0, 10.0, 0.0];
        let patch = |(index, size): (usize, &f32)| Patch {
            key: PatchKey(index as u64),
            first_leaf: 0,
            leaf_count: 1,
            end: 4,
            bounds_m: [Vec3::ZERO, Vec3::X * *size],
            seen_texels: 1.0,
        };
        let patches = sizes.iter().enumerate().map(patch).collect();
        let tree = PatchTree { patches, ..PatchTree::default() };
        let expectation = Expectation::new(&tree, 1.0);
        let all: f64 = (0..4).map(|n: u32| expectation.variance(n, n.checked_sub(1))).sum();
        assert!((all - (1.0 - COMMON)).abs() < 1e-6, "{all}");
        assert!((0..4).all(|n: u32| expectation.variance(n, n.checked_sub(1)) > 0.01));
    }
}
