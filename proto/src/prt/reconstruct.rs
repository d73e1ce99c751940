//! The run time of a relightable bake on the CPU: the normative form of what the client's passes compute
//! (METHOD.md §2 "Relight", "Reconstruct", "Clusters and factors"). Pure functions in a fixed order of summation.
//!
//! ```text
//! λ_pj = 4π/K · Σ_k L(y_pk) Y_j(ω_k)      relight          probes' coefficients
//! b_c  = (ΣVᵀ) λ|_c                        cluster_basis    k numbers per cluster
//! N_r  = Σ_y w_r L_y                       near_irradiance  from hits in narrow places
//! E_r  = max(0, N_r + U_r · b_c + Σ_e s_e E_re)  irradiance  at receivers, W·m⁻²
//! ```
//! A cluster decoded from a prefix of its chunk has fewer bands, ranks or receivers; everything here takes it as it
//! is, with the probes' full coefficients.

use std::ops::Range;

use glam::Vec3;

use super::{
    BlockKey, ClusterTransport, NearHits, Patch, PatchKey, PatchSet, ProbeBatch, ProbeKey, RelightHit, Texel,
};
use crate::sh::{ShBasis, relight_direction};

/// A linear RGB quantity.
pub type Rgb = [f32; 3];

/// The map from a probe's hit radiances to its coefficients: `basis[k·J + j] = 4π/K' · Y_j(ω_k)` for k < K'.
///
/// `rays` is K', how many rays are used; `rays_total` is K, from which directions come (a batch decoded from a prefix
/// has K' < K). Both are powers of two, K' ≤ K. `bands` is D, J = (D+1)².
pub fn relight_basis(rays: u32, rays_total: u32, bands: u32) -> Vec<f32> {
    let sh = ShBasis::new(bands as usize);
    let coefficients = sh.coefficients();
    let solid_angle = 4.0 * std::f32::consts::PI / rays as f32;
    let mut basis = vec![0.0; rays as usize * coefficients];
    for (ray, row) in basis.chunks_exact_mut(coefficients).enumerate() {
        sh.evaluate(relight_direction(ray as u32, rays_total), row);
        row.iter_mut().for_each(|y| *y *= solid_angle);
    }
    basis
}

/// Relight: `λ_pj = 4π/K · Σ_k L(y_pk) Y_j(ω_k)`, probe-major, `λ[p·J + j]`.
///
/// `basis` is [`relight_basis`] of the batch's rays; `radiance` gives L in W·m⁻²·sr⁻¹ of a receiver by block and texel.
/// Rays that meet the sky add nothing here, as the sky has columns of its own in every cluster; dark hits add nothing.
pub fn relight(
    batch: &ProbeBatch,
    basis: &[f32],
    mut radiance: impl FnMut(BlockKey, Texel) -> Rgb,
) -> Vec<Rgb> {
    let rays = batch.relight_rays as usize;
    let coefficients = basis.len() / rays.max(1);
    let mut lambda = vec![[0.0; 3]; batch.probes.len() * coefficients];
    if coefficients == 0 {
        return lambda;
    }
    for (hits, out) in batch.hits.chunks_exact(rays).zip(lambda.chunks_exact_mut(coefficients)) {
        for (hit, row) in hits.iter().zip(basis.chunks_exact(coefficients)) {
            if let RelightHit::Receiver { block, texel } = *hit {
                let radiance = radiance(batch.blocks[usize::from(block)], texel);
                out.iter_mut().zip(row).for_each(|(sum, &y)| add_scaled(sum, y, radiance));
            }
        }
    }
    lambda
}

/// Mean radiance of every patch of a set, by area, in the set's order, by key; then of the parts of the sky.
///
/// `radiance` gives L in W·m⁻²·sr⁻¹ of a receiver by block and texel; the sky is that of [`sky_part_radiance`].
pub fn patch_radiance(
    set: &PatchSet,
    mut radiance: impl FnMut(BlockKey, Texel) -> Rgb,
    sky: [Rgb; 2],
) -> Vec<(PatchKey, Rgb)> {
    let mut receivers = set.block.iter().zip(&set.texel).zip(&set.area);
    let leaves: Vec<(Rgb, f32)> = set
        .leaf_starts
        .windows(2)
        .map(|pair| {
            let count = pair[1] - pair[0];
            let (mut sum, mut area) = ([0.0; 3], 0.0);
            for ((&block, &texel), weight) in receivers.by_ref().take(count as usize) {
                add_scaled(&mut sum, weight.texels(), radiance(set.blocks[usize::from(block)], texel));
                area += weight.texels();
            }
            (sum, area)
        })
        .collect();
    let mean = |patch: &Patch| {
        let (mut sum, mut whole) = ([0.0; 3], 0.0);
        for (leaf, area) in &leaves[patch.first_leaf as usize..][..patch.leaf_count as usize] {
            add_scaled(&mut sum, 1.0, *leaf);
            whole += area;
        }
        (patch.key, sum.map(|channel| channel / whole))
    };
    let sky = sky_part_radiance(set.sky_parts, sky)
        .zip(0..)
        .map(|(radiance, part)| (PatchKey::of_sky(part), radiance));
    set.patches.iter().map(mean).chain(sky).collect()
}

/// Radiance of the parts of the sky, each at its middle: `L(ω) = horizon + (zenith − horizon)·max(ω_y, 0)`, y up.
pub fn sky_part_radiance(sky_parts: u32, [zenith, horizon]: [Rgb; 2]) -> impl Iterator<Item = Rgb> {
    (0..sky_parts).map(move |part| {
        let up = relight_direction(part, sky_parts).y.max(0.0);
        [0, 1, 2].map(|c| horizon[c] + (zenith[c] - horizon[c]) * up)
    })
}

/// SH coefficients of the sky's radiance `L(ω) = horizon + (zenith − horizon)·max(ω_y, 0)`, y up.
///
/// Exact: by the Funk–Hecke theorem the coefficients of `max(ω_y, 0)` are `2π c_l Y_j(ŷ)` with
/// `c_l = ∫₀¹ t P_l(t) dt` = 1/2, 1/3, 0 for odd l ≥ 3, and `(−1)^(l/2−1) (l−2)!/(2^l (l/2−1)! (l/2+1)!)` for even
/// l ≥ 2. The colours are radiances in W·m⁻²·sr⁻¹.
pub fn sky_coefficients(zenith: Rgb, horizon: Rgb, bands: u32) -> Vec<Rgb> {
    let sh = ShBasis::new(bands as usize);
    let mut up = vec![0.0; sh.coefficients()];
    sh.evaluate(Vec3::Y, &mut up);
    let mut lambda = vec![[0.0; 3]; sh.coefficients()];
    for (j, (coefficient, &y)) in lambda.iter_mut().zip(&up).enumerate() {
        let weight = 2.0 * std::f64::consts::PI * cosine_moment(crate::sh::band_of(j)) * f64::from(y);
        *coefficient = [0, 1, 2].map(|c| (zenith[c] - horizon[c]) * weight as f32);
    }
    let constant = (4.0 * std::f64::consts::PI).sqrt() as f32;
    add_scaled(&mut lambda[0], constant, horizon);
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

/// Basis of a cluster: `b_i = Σ_p Σ_j (ΣVᵀ)_i,pj λ_pj + Σ_j (ΣVᵀ)_i,sky,j λ_sky,j`, one RGB per rank.
///
/// `lambda_of` gives a probe's coefficients; bands above the cluster's are left out, bands that are missing are dark.
/// A probe for which it gives nothing (not fetched yet) counts as dark. `lambda_sky` may be empty where there is no sky.
pub fn cluster_basis<'a>(
    cluster: &ClusterTransport,
    lambda_of: impl Fn(ProbeKey) -> Option<&'a [Rgb]>,
    lambda_sky: &[Rgb],
) -> Vec<Rgb> {
    let coefficients = cluster.coefficients();
    let mut lambda = vec![[0.0; 3]; cluster.columns()];
    let mut columns = lambda.chunks_exact_mut(coefficients);
    for (&probe, column) in cluster.keys.iter().zip(columns.by_ref()) {
        if let Some(found) = lambda_of(probe) {
            column.iter_mut().zip(found).for_each(|(to, &from)| *to = from);
        }
    }
    if let Some(column) = columns.next() {
        column.iter_mut().zip(lambda_sky).for_each(|(to, &from)| *to = from);
    }
    let mut basis = vec![[0.0; 3]; cluster.rank as usize];
    for (sum, row) in basis.iter_mut().zip(cluster.vt.chunks_exact(cluster.columns().max(1))) {
        row.iter().zip(&lambda).for_each(|(&entry, &lambda)| add_scaled(sum, entry, lambda));
    }
    basis
}

/// Irradiance that a cluster's receivers get from their near hits: `N_r = Σ_y w_r L_y` in W·m⁻², in order of receivers;
/// nothing where no receiver has any.
///
/// `radiance` gives `L_y = ρ_t/π · (E_dir(y) + E_ind(t))` in W·m⁻²·sr⁻¹ of a hit by its number.
pub fn near_irradiance(near: &NearHits, mut radiance: impl FnMut(usize) -> Rgb) -> Vec<Rgb> {
    let of_receiver = |(hits, &weight): (Range<usize>, &f32)| {
        let mut sum = [0.0; 3];
        hits.for_each(|hit| add_scaled(&mut sum, weight, radiance(hit)));
        sum
    };
    near.ranges().zip(&near.weight).map(of_receiver).collect()
}

/// Irradiance at a cluster's receivers: `E_r = max(0, N_r + Σ_i U_ri b_i + Σ_e s_e E_re)` in W·m⁻², in order of receivers.
///
/// `near` is [`near_irradiance`]; `emitter_scale` gives s_e, the strength of an emitter (an index into the manifest's) relative to the bake. Negative
/// sums (ringing) are clamped at the very end, so that light is not gained by clamping parts.
pub fn irradiance(
    cluster: &ClusterTransport,
    basis: &[Rgb],
    near: Vec<Rgb>,
    emitter_scale: impl Fn(u16) -> f32,
) -> Vec<Rgb> {
    let rank = cluster.rank as usize;
    let mut irradiance = near;
    irradiance.resize(cluster.receivers.len(), [0.0; 3]);
    if rank > 0 {
        for (sum, row) in irradiance.iter_mut().zip(cluster.u.chunks_exact(rank)) {
            row.iter().zip(basis).for_each(|(&u, &b)| add_scaled(sum, u, b));
        }
    }
    for emitter in &cluster.emitters {
        let scale = emitter_scale(emitter.emitter);
        irradiance.iter_mut().zip(&emitter.irradiance).for_each(|(sum, &e)| add_scaled(sum, scale, e));
    }
    irradiance.iter_mut().for_each(|sum| *sum = sum.map(|e| e.max(0.0)));
    irradiance
}

fn add_scaled(sum: &mut Rgb, scale: f32, value: Rgb) {
    for channel in 0..3 {
        sum[channel] += scale * value[channel];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prt::{AreaCode, EmitterIrradiance, Probe, Receivers};
    use std::f32::consts::PI;

    fn close(a: f32, b: f32) -> bool {
        (a - b).abs() <= 1e-4 * (1.0 + b.abs())
    }

    fn batch_of(hits: Vec<RelightHit>) -> ProbeBatch {
        let probe = Probe { key: 7, position_m: [0.0; 3], radius_m: 1.0 };
        ProbeBatch { probes: vec![probe], relight_rays: hits.len() as u32, blocks: vec![40, 50], hits }
    }

    #[test]
    fn probe_in_uniform_radiance_has_the_constant_coefficient_alone() {
        let hit = RelightHit::Receiver { block: 1, texel: [3, 4] };
        let batch = batch_of(vec![hit; 1024]);
        let lambda = relight(&batch, &relight_basis(1024, 1024, 3), |block, texel| {
            assert_eq!((block, texel), (50, [3, 4]));
            [1.0, 2.0, 0.0]
        });
        let constant = (4.0 * PI).sqrt();
        assert!(close(lambda[0][0], constant) && close(lambda[0][1], 2.0 * constant));
        assert!(lambda[1..].iter().flatten().all(|x| x.abs() < 0.02), "{lambda:?}");
    }

    #[test]
    fn sky_and_dark_hits_add_nothing_to_a_probe() {
        let batch = batch_of(vec![RelightHit::Sky, RelightHit::Dark]);
        let lambda = relight(&batch, &relight_basis(2, 2, 1), |_, _| unreachable!());
        assert_eq!(lambda, vec![[0.0; 3]; 4]);
    }

    #[test]
    fn patch_has_the_mean_of_its_receivers_and_the_sky_its_own() {
        let patch = |key, first_leaf, leaf_count| Patch { key: PatchKey(key), first_leaf, leaf_count };
        let set = PatchSet {
            patches: vec![patch(1, 0, 1), patch(2, 1, 1), patch(3, 0, 2)],
            leaf_starts: vec![0, 1, 4],
            blocks: vec![7],
            block: vec![0; 4],
            texel: vec![[0, 0], [1, 0], [2, 0], [3, 0]],
            // The last has twice the area of the others.
            area: vec![AreaCode::ONE, AreaCode::ONE, AreaCode::ONE, AreaCode(AreaCode::ONE.0 + 16)],
            sky_parts: 16,
        };
        let sky = [[1.0, 2.0, 3.0]; 2];
        let found = patch_radiance(&set, |block, [x, _]| [block as f32, f32::from(x), 0.0], sky);
        assert_eq!(
            found[..3].iter().map(|(_, l)| *l).collect::<Vec<_>>(),
            [[7.0, 0.0, 0.0], [7.0, 2.25, 0.0], [7.0, 1.8, 0.0]]
        );
        assert_eq!(found.len(), 19);
        assert!(found[3..].iter().all(|(key, l)| key.sky().is_some() && *l == sky[0]));
    }

    #[test]
    fn half_the_rays_still_give_the_radiance() {
        let hit = RelightHit::Receiver { block: 0, texel: [0, 0] };
        let basis = relight_basis(256, 1024, 0);
        let lambda = relight(&batch_of(vec![hit; 256]), &basis, |_, _| [1.0; 3]);
        assert!(close(lambda[0][0], (4.0 * PI).sqrt()));
    }

    #[test]
    fn sky_coefficients_are_the_projection_of_the_gradient() {
        let (zenith, horizon) = ([1.0, 3.0, 0.0], [0.5, 1.0, 2.0]);
        let lambda = sky_coefficients(zenith, horizon, 10);
        let (sh, rays) = (ShBasis::new(10), 16_384);
        let mut y = vec![0.0; sh.coefficients()];
        let mut wanted = vec![[0.0_f64; 3]; sh.coefficients()];
        for ray in 0..rays {
            let direction = relight_direction(ray, rays);
            sh.evaluate(direction, &mut y);
            for (sum, &y) in wanted.iter_mut().zip(&y) {
                for c in 0..3 {
                    let radiance = horizon[c] + (zenith[c] - horizon[c]) * direction.y.max(0.0);
                    sum[c] += f64::from(radiance * y) * 4.0 * std::f64::consts::PI / f64::from(rays);
                }
            }
        }
        for (j, (got, wanted)) in lambda.iter().zip(&wanted).enumerate() {
            for c in 0..3 {
                assert!((f64::from(got[c]) - wanted[c]).abs() < 2e-3, "{j}: {got:?} {wanted:?}");
            }
        }
    }

    #[test]
    fn basis_and_irradiance_are_the_factors_times_the_coefficients() {
        let cluster = ClusterTransport {
            receivers: Receivers { texel: vec![[0, 0], [1, 0]], ..Receivers::default() },
            keys: vec![3, 9],
            bands: 0,
            sky: true,
            rank: 2,
            u: vec![1.0, 0.0, 2.0, -1.0],
            vt: vec![1.0, 10.0, 100.0, 0.5, 0.0, 4.0],
            emitters: vec![EmitterIrradiance { emitter: 5, irradiance: vec![[0.0; 3], [1.0, 2.0, 3.0]] }],
            ..ClusterTransport::default()
        };
        // More bands than the cluster has: the rest is left out.
        let lambda = [[2.0, 0.0, 1.0], [99.0; 3]];
        let of = |key: ProbeKey| (key == 3).then_some(&lambda[..]);
        let basis = cluster_basis(&cluster, of, &[[1.0, 0.0, 0.0]]);
        assert_eq!(basis, [[102.0, 0.0, 1.0], [5.0, 0.0, 0.5]]);
        let scale = |emitter: u16| if emitter == 5 { 2.0 } else { 0.0 };
        assert_eq!(irradiance(&cluster, &basis, Vec::new(), scale), [[102.0, 0.0, 1.0], [201.0, 4.0, 7.5]]);
        assert_eq!(irradiance(&cluster, &[[-1.0; 3], [0.0; 3]], Vec::new(), |_| 0.0), [[0.0; 3]; 2]);
    }

    #[test]
    fn a_cluster_that_nothing_reaches_is_exactly_dark() {
        let receivers = Receivers { texel: vec![[0, 0]], ..Receivers::default() };
        let cluster = ClusterTransport { receivers, ..ClusterTransport::default() };
        let basis = cluster_basis(&cluster, |_| None, &[]);
        assert_eq!(irradiance(&cluster, &basis, Vec::new(), |_| 1.0), [[0.0; 3]]);
    }
}
