//! Light of near hits, on the processor.

use std::f32::consts::FRAC_1_PI;

use glam::Vec4;
use rayon::prelude::*;

use crate::bake::{LoadedBake, NearRow};
use crate::passes::relight::reference::Irradiance;

/// `N(r) = w_r Σ_y ρ/π·(E_dir(y) + E_emit + E_ind)` by slot, in W·m⁻²; `dir` is E_dir by hit, `irradiance` that of texels.
pub fn near(bake: &LoadedBake, dir: &[Vec4], irradiance: Irradiance<'_>) -> Vec<Vec4> {
    let table = &bake.near;
    let sum_of = |row: &NearRow| -> Vec4 {
        let hits = row.first as usize..(row.first + row.count) as usize;
        let each = hits.map(|hit| {
            let slot = table.slots[hit] as usize;
            table.albedo[hit] * FRAC_1_PI * (dir[hit] + irradiance.emit[slot] + irradiance.ind[slot])
        });
        each.sum::<Vec4>() * row.weight
    };
    let sums: Vec<Vec4> = table.rows.par_iter().map(sum_of).collect();
    let mut all = vec![Vec4::ZERO; bake.receivers.len()];
    table.rows.iter().zip(sums).for_each(|(row, sum)| all[row.slot as usize] = sum);
    all
}
