//! Spherical harmonics at probes: relight hits resolved to slots, irradiance → coefficients of the radiance at probes.

use std::collections::HashMap;
use std::f32::consts::PI;

use glam::{Vec3, Vec4};

use super::{ProbeBatch, ProbeKey, RelightHit};
use crate::harmonics::{MAX_BANDS, ShBasis, band_of, relight_direction};
use crate::relight::{
    Columns, DARK, Inconsistent, Irradiance, Panorama, Parallel, ReceiverTable, Sky, SlotTable,
};

/// A hit that is the sky.
pub const HIT_SKY: u32 = u32::MAX;
/// A hit that returns no radiance.
pub const HIT_DARK: u32 = DARK;

/// Probes and their relight rays' hits; λ has J coefficients for each, and for the sky behind them.
#[derive(Debug, Default)]
pub struct ProbeTable {
    /// Keys, in order.
    pub keys: Vec<ProbeKey>,
    /// Relight rays per probe K, a power of two.
    pub relight_rays: u32,
    /// Highest band.
    pub bands: u32,
    /// `4π/K · Y_j(ω_k)` at `k·J + j`.
    pub basis: Vec<f32>,
    /// Receiver slots, [`HIT_SKY`] or [`HIT_DARK`], probe-major: `hits[p·K + k]`.
    pub hits: Vec<u32>,
    by_key: HashMap<ProbeKey, u32>,
}

impl ProbeTable {
    /// Joins batches, which must share one number of rays; `relight_rays` is that of a bake without any.
    pub fn join(
        batches: &[ProbeBatch],
        relight_rays: u32,
        bands: u32,
        slots: &SlotTable,
    ) -> Result<Self, Inconsistent> {
        let rays = batches.first().map_or(relight_rays, |batch| batch.relight_rays);
        if !rays.is_power_of_two() || bands as usize > MAX_BANDS {
            let problem = format!("{rays} relight rays and {bands} bands");
            return Err(Inconsistent::new("settings", problem));
        }
        let basis = relight_basis(rays, rays, bands);
        let mut table = Self { relight_rays: rays, bands, basis, ..Self::default() };
        for (index, batch) in batches.iter().enumerate() {
            let named = |problem| Inconsistent::new(format!("probe batch {index}"), problem);
            table.push(batch, slots).map_err(named)?;
        }
        Ok(table)
    }

    /// Probes.
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// The K hits of probe `probe`.
    pub fn hits_of(&self, probe: usize) -> &[u32] {
        let rays = self.relight_rays as usize;
        &self.hits[probe * rays..(probe + 1) * rays]
    }

    fn push(&mut self, batch: &ProbeBatch, slots: &SlotTable) -> Result<(), String> {
        if batch.relight_rays != self.relight_rays {
            return Err(format!("has {} rays per probe, the bake {}", batch.relight_rays, self.relight_rays));
        }
        if batch.hits.len() != batch.probes.len() * batch.relight_rays as usize {
            return Err(format!("has {} hits for {} probes", batch.hits.len(), batch.probes.len()));
        }
        for probe in &batch.probes {
            if self.by_key.insert(probe.key, self.keys.len() as u32).is_some() {
                return Err(format!("probe {:016x} is there twice", probe.key));
            }
            self.keys.push(probe.key);
        }
        let blocks = slots.block_indices(&batch.blocks)?;
        for hit in &batch.hits {
            self.hits.push(match hit {
                RelightHit::Sky => HIT_SKY,
                RelightHit::Dark => HIT_DARK,
                RelightHit::Receiver { block, texel } => {
                    let found =
                        blocks.get(usize::from(*block)).ok_or_else(|| format!("a ray hits block {block}"))?;
                    // The baker leaves out receivers that no light can reach.
                    slots.slot(*found, *texel).unwrap_or(HIT_DARK)
                }
            });
        }
        Ok(())
    }
}

impl Columns for ProbeTable {
    fn bands(&self) -> u32 {
        self.bands
    }

    fn lambda_count(&self) -> usize {
        (self.len() + 1) * self.coefficients()
    }

    fn index(&self, key: u64) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    fn sky_index(&self) -> Option<u32> {
        Some(self.len() as u32)
    }

    fn sky_lambda(&self, sky: Sky) -> Vec<Vec4> {
        sky_coefficients(sky, self.bands)
    }

    fn panorama_lambda(&self, panorama: &Panorama) -> Vec<Vec4> {
        panorama.coefficients(self.bands)
    }

    /// `λ_pj = 4π/K Σ_k L(y_pk) Y_j(ω_k)`, probe-major, W·m⁻²·sr⁻¹; \[Sedlacek2019\] §3.3.1.
    ///
    /// Rays that meet the sky add nothing to a probe, as the sky has columns of its own. We differ: emission is left out.
    fn surface_lambda(
        &self,
        parallel: &impl Parallel,
        receivers: &ReceiverTable,
        irradiance: Irradiance<'_>,
    ) -> Vec<Vec4> {
        let coefficients = self.coefficients();
        let of_probe = |probe: usize| {
            let mut lambda = vec![Vec4::ZERO; coefficients];
            for (hit, basis) in self.hits_of(probe).iter().zip(self.basis.chunks_exact(coefficients)) {
                let radiance = irradiance.radiance(receivers, *hit);
                for (lambda, y) in lambda.iter_mut().zip(basis) {
                    *lambda += radiance * *y;
                }
            }
            lambda
        };
        parallel.map(self.len(), of_probe).concat()
    }
}

/// The map from a probe's hit radiances to its coefficients: `basis[k·J + j] = 4π/K' · Y_j(ω_k)` for k < K'.
///
/// `rays` is K', the rays used; `rays_total` is K, which sets the directions (a batch decoded from a prefix has K' < K).
/// Both are powers of two, K' ≤ K. `bands` is D, J = (D+1)².
pub fn relight_basis(rays: u32, rays_total: u32, bands: u32) -> Vec<f32> {
    let sh = ShBasis::new(bands as usize);
    let coefficients = sh.coefficients();
    let solid_angle = 4.0 * PI / rays as f32;
    let mut basis = vec![0.0; rays as usize * coefficients];
    for (ray, row) in basis.chunks_exact_mut(coefficients).enumerate() {
        sh.evaluate(relight_direction(ray as u32, rays_total), row);
        row.iter_mut().for_each(|y| *y *= solid_angle);
    }
    basis
}

/// SH coefficients of the sky's radiance `L(ω) = horizon + (zenith − horizon)·max(ω_y, 0)`, y up.
///
/// Exact: by the Funk–Hecke theorem the coefficients of `max(ω_y, 0)` are `2π c_l Y_j(ŷ)` with
/// `c_l = ∫₀¹ t P_l(t) dt` = 1/2, 1/3, 0 for odd l ≥ 3, and `(−1)^(l/2−1) (l−2)!/(2^l (l/2−1)! (l/2+1)!)` for even
/// l ≥ 2.
pub fn sky_coefficients(sky: Sky, bands: u32) -> Vec<Vec4> {
    let sh = ShBasis::new(bands as usize);
    let mut up = vec![0.0; sh.coefficients()];
    sh.evaluate(Vec3::Y, &mut up);
    let gradient = sky.zenith - sky.horizon;
    let coefficient = |(j, &y): (usize, &f32)| {
        let weight = 2.0 * std::f64::consts::PI * cosine_moment(band_of(j)) * f64::from(y);
        (gradient * weight as f32).extend(0.0)
    };
    let mut lambda: Vec<Vec4> = up.iter().enumerate().map(coefficient).collect();
    lambda[0] += ((4.0 * std::f64::consts::PI).sqrt() as f32 * sky.horizon).extend(0.0);
    lambda
}

/// `∫₀¹ t P_l(t) dt`.
fn cosine_moment(l: usize) -> f64 {
    match l {
        0 => 0.5,
        1 => 1.0 / 3.0,
        _ if l % 2 == 1 => 0.0,
        // c_2 = 1/8; c_{l+2}/c_l = −(l−1)/(l+4), from the closed form.
        _ => (2..l).step_by(2).fold(0.125, |c, l| -c * (l as f64 - 1.0) / (l as f64 + 4.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::sh::Probe;
    use crate::relight::tests::{BLOCK, close, cluster, joined, lambda};

    fn probes(
        hits: Vec<RelightHit>,
        bands: u32,
    ) -> impl FnOnce(&SlotTable) -> Result<ProbeTable, Inconsistent> {
        let probe = Probe { key: 3, position_m: [0.0; 3], radius_m: 1.0 };
        let rays = hits.len() as u32;
        let batch = ProbeBatch { probes: vec![probe], relight_rays: rays, blocks: vec![BLOCK], hits };
        move |slots| ProbeTable::join(&[batch], rays, bands, slots)
    }

    #[test]
    fn probe_in_uniform_radiance_has_the_constant_coefficient_alone() {
        let hit = RelightHit::Receiver { block: 0, texel: [1, 0] };
        let transport = joined(cluster(2), probes(vec![hit; 1024], 3)).unwrap();
        let lambda = lambda(&transport, &[Vec3::splat(9.0), Vec3::new(1.0, 2.0, 0.0)]);
        let constant = (4.0 * PI).sqrt();
        assert!(close(lambda[0].x, constant) && close(lambda[0].y, 2.0 * constant));
        assert!(lambda[1..].iter().all(|x| x.abs().max_element() < 0.02), "{lambda:?}");
    }

    #[test]
    fn sky_dark_hits_and_texels_without_receiver_add_nothing_to_a_probe() {
        let hits = vec![RelightHit::Sky, RelightHit::Dark, RelightHit::Receiver { block: 0, texel: [7, 0] }];
        let hits = [hits, vec![RelightHit::Dark]].concat();
        let transport = joined(cluster(1), probes(hits, 1)).unwrap();
        assert_eq!(lambda(&transport, &[Vec3::ONE]), vec![Vec4::ZERO; 8]);
    }

    #[test]
    fn half_the_rays_still_give_the_radiance() {
        let basis = relight_basis(256, 1024, 0);
        assert!(close(basis.iter().sum(), (4.0 * PI).sqrt()));
    }

    #[test]
    fn sky_coefficients_are_the_projection_of_the_gradient() {
        let sky = Sky { zenith: Vec3::new(1.0, 3.0, 0.0), horizon: Vec3::new(0.5, 1.0, 2.0) };
        let lambda = sky_coefficients(sky, 10);
        let (sh, rays) = (ShBasis::new(10), 16_384);
        let mut y = vec![0.0; sh.coefficients()];
        let mut wanted = vec![glam::DVec3::ZERO; sh.coefficients()];
        for ray in 0..rays {
            let direction = relight_direction(ray, rays);
            sh.evaluate(direction, &mut y);
            for (sum, &y) in wanted.iter_mut().zip(&y) {
                *sum +=
                    (sky.radiance(direction) * y).as_dvec3() * 4.0 * std::f64::consts::PI / f64::from(rays);
            }
        }
        for (j, (got, wanted)) in lambda.iter().zip(&wanted).enumerate() {
            let off = (got.truncate().as_dvec3() - *wanted).abs().max_element();
            assert!(off < 2e-3, "{j}: {got} {wanted}");
        }
    }
}
