//! Contrast of light at two places (\[Sukys2014\] §3.1.3): the most by which irradiance differs, over 26 normals and all colours.
//!
//! `c = max |a − b| / (a + b + 1e-3 Ē)`. The normals are the sums of one to three of the axes' directions.

use std::sync::LazyLock;

use glam::{IVec3, Vec3};
use lightkiln_proto::harmonics::ShBasis;
use lightkiln_proto::kinds::field::PROBE_ROWS;

/// Normals at which irradiance is compared.
const NORMALS: usize = 26;
/// Share of the mean irradiance that is added to sums, so that dark places do not contrast by noise.
const FLOOR: f32 = 1e-3;

/// Irradiance by normal and colour.
pub type Samples = [[f32; 3]; NORMALS];

/// The normals.
fn normals() -> impl Iterator<Item = Vec3> {
    let ways = (0..27).filter(|way| *way != 13);
    ways.map(|way: i32| (IVec3::new(way % 3, way / 3 % 3, way / 9) - 1).as_vec3().normalize())
}

/// Irradiance at the normals, of coefficients by row; at least 0.
pub fn samples(coefficients: &[[f32; 3]; PROBE_ROWS]) -> Samples {
    static HARMONICS: LazyLock<[[f32; PROBE_ROWS]; NORMALS]> = LazyLock::new(|| {
        let basis = ShBasis::new(2);
        let mut all = [[0.0; PROBE_ROWS]; NORMALS];
        for (harmonics, normal) in all.iter_mut().zip(normals()) {
            basis.evaluate(normal, harmonics);
        }
        all
    });
    HARMONICS.map(|harmonics| {
        let of_colour = |colour: usize| {
            let rows = harmonics.iter().zip(coefficients);
            rows.map(|(harmonic, coefficient)| harmonic * coefficient[colour]).sum::<f32>().max(0.0)
        };
        [0, 1, 2].map(of_colour)
    })
}

/// c of two places in a scene of some mean irradiance: 0 of places alike, 1 beside darkness.
pub fn contrast(a: &Samples, b: &Samples, mean: f32) -> f32 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    let of_pair = |(a, b): (&f32, &f32)| (a - b).abs() / (a + b + FLOOR * mean).max(f32::MIN_POSITIVE);
    pairs.map(of_pair).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_are_distinct_units_in_opposite_pairs() {
        let all: Vec<Vec3> = normals().collect();
        assert_eq!(all.len(), NORMALS);
        for (index, normal) in all.iter().enumerate() {
            assert!((normal.length() - 1.0).abs() < 1e-6);
            assert_eq!(all.iter().filter(|other| other.distance(-*normal) < 1e-6).count(), 1);
            assert!(all[..index].iter().all(|other| other.distance(*normal) > 0.1));
        }
    }

    #[test]
    fn contrast_is_that_of_the_normal_and_colour_that_differ_most() {
        let even = [[2.0; 3]; NORMALS];
        let mut other = even;
        assert_eq!(contrast(&even, &other, 2.0), 0.0);
        other[17][1] = 6.0;
        let wanted = 4.0 / (8.0 + 2e-3);
        assert!((contrast(&even, &other, 2.0) - wanted).abs() < 1e-6);
        assert_eq!(contrast(&other, &even, 2.0), contrast(&even, &other, 2.0));
        // Darkness is alike darkness, and unlike light.
        let dark = [[0.0; 3]; NORMALS];
        assert_eq!(contrast(&dark, &dark, 0.0), 0.0);
        assert!(contrast(&dark, &even, 2.0) > 0.99);
        assert!(contrast(&dark, &[[1e-6; 3]; NORMALS], 2.0) < 1e-3);
    }

    #[test]
    fn samples_are_irradiance_of_light_from_one_side() {
        // Radiance `1 + z`: E = π + 2π/3 n_z.
        let basis = ShBasis::new(2);
        let mut coefficients = [[0.0; 3]; PROBE_ROWS];
        let count = 4096;
        for ray in 0..count {
            let direction = lightkiln_proto::harmonics::relight_direction(ray, count);
            let mut harmonics = [0.0; PROBE_ROWS];
            basis.evaluate(direction, &mut harmonics);
            let weights = crate::kinds::field::irradiance_weights(direction);
            for (sum, weight) in coefficients.iter_mut().zip(weights) {
                let light = (1.0 + direction.z) * 4.0 * std::f32::consts::PI / count as f32;
                sum.iter_mut().for_each(|sum| *sum += weight * light);
            }
        }
        for (found, normal) in samples(&coefficients).iter().zip(normals()) {
            let wanted = std::f32::consts::PI * (1.0 + 2.0 / 3.0 * normal.z);
            assert!((found[0] - wanted).abs() < 0.01, "{normal}: {} for {wanted}", found[0]);
        }
    }
}
