//! What the radiance of patches is expected to be like, before any light is known: near patches that face the same way
//! shine alike, and some light is everywhere.
//!
//! With C the covariance of the patches' radiance and `C = L Lᵀ`, the error of irradiance that a truncation E of the matrix
//! is expected to give is ‖E L‖, so A L is what is truncated: chance that moves rays between neighbours then costs no rank.
//! We differ from METHOD's plain Frobenius norm, which is C = 1.

use glam::Vec3;
use lightkiln_proto::prt::{PatchKey, ProbeKey, Settings};
use lightkiln_proto::sh::relight_direction;
use rayon::prelude::*;

use crate::prt::world::World;

/// Share of the variance that all patches have in common.
const COMMON: f64 = 0.15;
/// Share that each patch has for itself.
const OWN: f64 = 0.05;
/// Distances in texels over which the rest falls off to 1/e, a like part of it over each: lights and shadows are of
/// every size.
const REACHES_TEXELS: [f32; 3] = [4.0, 16.0, 64.0];
/// How far off the sky is taken to be, in texels.
const SKY_TEXELS: f32 = 128.0;
/// Receivers of a patch that are asked for its middle.
const ASKED_MAX: usize = 64;

/// Middle of a patch in metres, and its unit normal.
struct Middle {
    is_sky: bool,
    position_m: Vec3,
    normal: Vec3,
}

/// L of the patches of `keys`, row by row; zero above the diagonal. Parts of the sky lie around `centre_m`.
pub fn root(world: &World, settings: &Settings, keys: &[ProbeKey], centre_m: Vec3) -> Vec<f32> {
    let texel_m = world.stage.texel_m;
    let middles: Vec<Middle> =
        keys.iter().map(|&key| middle(world, settings, PatchKey(key), centre_m)).collect();
    let covariance = |a: &Middle, b: &Middle| {
        // Nobody knows whether the sky shines when lamps do.
        if a.is_sky != b.is_sky {
            return 0.0;
        }
        let texels = a.position_m.distance(b.position_m) / texel_m;
        let fall = |reach: f32| libm::exp(-f64::from(texels / reach)) / REACHES_TEXELS.len() as f64;
        let alike = 0.5 * (1.0 + f64::from(a.normal.dot(b.normal)));
        COMMON + (1.0 - COMMON - OWN) * alike * REACHES_TEXELS.into_iter().map(fall).sum::<f64>()
    };
    let count = keys.len();
    let mut rows = vec![0.0_f64; count * count];
    rows.par_chunks_exact_mut(count.max(1)).enumerate().for_each(|(i, row)| {
        for j in 0..i {
            row[j] = covariance(&middles[i], &middles[j]);
        }
        row[i] = 1.0;
    });
    cholesky(&mut rows, count);
    rows.into_iter().map(|value| value as f32).collect()
}

fn middle(world: &World, settings: &Settings, key: PatchKey, centre_m: Vec3) -> Middle {
    if let Some(part) = key.sky() {
        let direction = relight_direction(part, settings.sky_parts);
        return Middle {
            is_sky: true,
            position_m: centre_m + direction * (SKY_TEXELS * world.stage.texel_m),
            normal: -direction,
        };
    }
    let tree = &world.stage.patches;
    let Some(patch) = tree.of_key(key) else {
        return Middle { is_sky: true, position_m: centre_m, normal: Vec3::Y };
    };
    let receivers = tree.receivers_of(patch);
    let step = receivers.len().div_ceil(ASKED_MAX).max(1);
    let asked = || receivers.iter().step_by(step).map(|&r| &world.stage.receivers[r as usize]);
    let count = asked().count() as f32;
    Middle {
        is_sky: false,
        position_m: asked().map(|receiver| receiver.position_m).sum::<Vec3>() / count,
        normal: asked().map(|receiver| receiver.face_normal).sum::<Vec3>().normalize_or(Vec3::Y),
    }
}

/// The lower triangle of a positive definite matrix to its Cholesky factor, in place.
fn cholesky(rows: &mut [f64], count: usize) {
    for i in 0..count {
        let (above, row) = rows.split_at_mut(i * count);
        let row = &mut row[..count];
        for j in 0..i {
            let other = &above[j * count..][..count];
            let sum: f64 = row[..j].iter().zip(&other[..j]).map(|(a, b)| a * b).sum();
            row[j] = (row[j] - sum) / other[j];
        }
        let sum: f64 = row[..i].iter().map(|value| value * value).sum();
        // Never below what each patch has for itself.
        row[i] = (row[i] - sum).max(OWN * 0.5).sqrt();
    }
}

/// A L, of rows of A.
pub fn weighed<'a>(
    rows: impl IndexedParallelIterator<Item = &'a [f32]>,
    root: &[f32],
    count: usize,
) -> Vec<Vec<f32>> {
    rows.map(|row| {
        let mut out = vec![0.0; count];
        for (i, value) in row.iter().take(count).enumerate().filter(|(_, value)| **value != 0.0) {
            out[..=i].iter_mut().zip(&root[i * count..]).for_each(|(out, root)| *out += value * root);
        }
        out
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factor_times_its_transpose_is_the_matrix() {
        let matrix = [4.0, 0.0, 0.0, 2.0, 5.0, 0.0, 0.4, 1.0, 3.0];
        let mut factor = matrix;
        cholesky(&mut factor, 3);
        for i in 0..3 {
            for j in 0..=i {
                let product: f64 = (0..=j).map(|k| factor[i * 3 + k] * factor[j * 3 + k]).sum();
                assert!((product - matrix[i * 3 + j]).abs() < 1e-12, "{i} {j}");
            }
        }
    }

    #[test]
    fn rows_are_weighed_by_the_lower_triangle() {
        let rows = [[1.0, 2.0].as_slice()];
        let found = weighed(rows.par_iter().copied(), &[1.0, 0.0, 3.0, 0.5], 2);
        assert_eq!(found, [[7.0, 1.0]]);
    }
}
