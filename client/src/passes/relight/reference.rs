//! Radiance at the probes' hits, projected to spherical harmonics, on the processor.

use std::f32::consts::FRAC_1_PI;

use glam::Vec4;
use rayon::prelude::*;

use super::RelightTable;
use crate::bake::LoadedBake;

/// Irradiance at receivers, by slot, in W·m⁻².
#[derive(Clone, Copy, Debug)]
pub struct Irradiance<'a> {
    /// From lights.
    pub dir: &'a [Vec4],
    /// Straight from emissive surfaces.
    pub emit: &'a [Vec4],
    /// From everything else, of the frame before.
    pub ind: &'a [Vec4],
}

/// `λ_pj = 4π/K Σ_k L(y_pk) Y_j(ω_k)` with `L = ρ/π·(E_dir + E_emit + E_ind)`; METHOD §2 "Relight".
///
/// `lambda[p·J + j]` in W·m⁻²·sr⁻¹; the sky's coefficients come last. Rays that meet the sky add nothing to a probe, as
/// the sky has columns of its own. We differ from [Sedlacek2019] §3.3.1: emission is left out, as its irradiance is
/// baked with its own shadow rays.
pub fn relight(bake: &LoadedBake, table: &RelightTable, irradiance: Irradiance<'_>) -> Vec<Vec4> {
    let coefficients = table.coefficients;
    let mut lambda = vec![Vec4::ZERO; bake.probes.len() * coefficients];
    lambda.par_chunks_mut(coefficients).enumerate().for_each(|(probe, lambda)| {
        let rays = bake.probes.hits_of(probe).iter().zip(table.basis.chunks_exact(coefficients));
        for (hit, basis) in rays {
            let radiance = hit_radiance(bake, irradiance, *hit);
            for (lambda, y) in lambda.iter_mut().zip(basis) {
                *lambda += radiance * *y;
            }
        }
    });
    lambda.extend(&table.sky);
    lambda
}

/// Radiance that a hit sends back; the sky and dark hits lie above all slots.
pub(in crate::passes) fn hit_radiance(bake: &LoadedBake, irradiance: Irradiance<'_>, hit: u32) -> Vec4 {
    let slot = hit as usize;
    match bake.receivers.albedo.get(slot) {
        None => Vec4::ZERO,
        Some(albedo) => {
            *albedo * FRAC_1_PI * (irradiance.dir[slot] + irradiance.emit[slot] + irradiance.ind[slot])
        }
    }
}
