//! Mean radiance of patches, on the processor.

use glam::Vec4;
use rayon::prelude::*;

use crate::bake::LoadedBake;
use crate::passes::relight::reference::{Irradiance, hit_radiance};

/// `lambda[s]`: mean of `L = ρ/π·(E_dir + E_emit + E_ind)` over the surface of patch s, W·m⁻²·sr⁻¹; `sky`, one entry per
/// part of the sky, comes last.
pub fn mean_radiance(bake: &LoadedBake, sky: &[Vec4], irradiance: Irradiance<'_>) -> Vec<Vec4> {
    let table = &bake.patches;
    let leaves: Vec<Vec4> = table
        .leaf_starts
        .par_windows(2)
        .map(|pair| {
            let of_leaf = pair[0] as usize..pair[1] as usize;
            let areas = &table.areas[of_leaf.clone()];
            let each = table.slots[of_leaf].iter().zip(areas);
            let sum: Vec4 = each.map(|(&slot, &area)| hit_radiance(bake, irradiance, slot) * area).sum();
            sum.truncate().extend(areas.iter().sum())
        })
        .collect();
    let mean = |patch: &crate::bake::PatchRow| {
        let leaves = &leaves[patch.first_leaf as usize..][..patch.leaf_count as usize];
        let sum: Vec4 = leaves.iter().sum();
        (sum.truncate() / sum.w).extend(0.0)
    };
    let mut lambda: Vec<Vec4> = table.patches.par_iter().map(mean).collect();
    lambda.extend(sky);
    lambda
}
