//! Contrast of light at two places (\[Sukys2014\] §3.1.3): the most by which irradiance differs, over 26 normals and all colours.
//!
//! `c = max |a − b| / (a + b + 1e-3 Ē)`. The normals are the sums of one to three of the axes' directions. *We differ:* S2 samples
//! spherical harmonics, which swing below 0 where little light comes from, and contrast there by that alone; ours are sums over rays.

use glam::{DVec3, IVec3, Vec3};

/// Normals at which irradiance is compared.
const NORMALS: usize = 26;
/// Share of the mean irradiance that is added to sums, so that dark places do not contrast by noise.
const FLOOR: f32 = 1e-3;

/// Irradiance by normal and colour.
pub type Samples = [[f32; 3]; NORMALS];

/// Irradiance at the normals while rays are added.
pub struct Gathered {
    normals: [Vec3; NORMALS],
    sums: [DVec3; NORMALS],
}

impl Gathered {
    /// None yet.
    pub fn new() -> Self {
        let ways = std::array::from_fn(|way| way as i32 + i32::from(way >= NORMALS / 2));
        let normals = ways.map(|way| (IVec3::new(way % 3, way / 3 % 3, way / 9) - 1).as_vec3().normalize());
        Self { normals, sums: [DVec3::ZERO; NORMALS] }
    }

    /// Adds radiance from a direction times the solid angle that it stands for.
    pub fn add(&mut self, direction: Vec3, light: DVec3) {
        for (sum, normal) in self.sums.iter_mut().zip(&self.normals) {
            *sum += light * f64::from(normal.dot(direction).max(0.0));
        }
    }

    /// The irradiance.
    pub fn samples(&self) -> Samples {
        self.sums.map(|sum| sum.as_vec3().to_array())
    }
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
        let all = Gathered::new().normals;
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
        let mut gathered = Gathered::new();
        let count = 4096;
        for ray in 0..count {
            let direction = lightkiln_proto::harmonics::relight_direction(ray, count);
            let share = 4.0 * std::f64::consts::PI / f64::from(count);
            gathered.add(direction, DVec3::splat(share * f64::from(1.0 + direction.z)));
        }
        for (found, normal) in gathered.samples().iter().zip(gathered.normals) {
            let wanted = std::f32::consts::PI * (1.0 + 2.0 / 3.0 * normal.z);
            assert!((found[0] - wanted).abs() < 0.01, "{normal}: {} for {wanted}", found[0]);
        }
    }
}
