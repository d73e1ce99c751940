//! Deterministic samples: seeds from identity, low-discrepancy points, and maps to sphere and hemisphere.

use glam::Vec3;

/// Mixes 64 bits so that every input bit reaches every output bit (\[Steele2014\], the finaliser of SplitMix64).
pub fn mix(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Seed of the identity `parts`, in order.
pub fn seed_of(parts: &[u64]) -> u64 {
    parts.iter().fold(0x6b69_6c6e, |seed, &part| mix(seed ^ part))
}

/// Pseudo-random numbers of one identity.
#[derive(Clone, Debug)]
pub struct Sequence(u64);

impl Sequence {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// Uniform in 0..1.
    pub fn next_f32(&mut self) -> f32 {
        (self.next_u64() >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Low-discrepancy points in the unit square: the R₂ sequence \[Roberts2018\], shifted by an identity's seed.
#[derive(Clone, Copy, Debug)]
pub struct R2 {
    shift: [f32; 2],
}

impl R2 {
    /// The point set of a seed.
    pub fn new(seed: u64) -> Self {
        let mut sequence = Sequence::new(seed);
        Self { shift: [sequence.next_f32(), sequence.next_f32()] }
    }

    /// Point `index`.
    pub fn point(&self, index: u32) -> [f32; 2] {
        const STEP: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053_3];
        let turn = |axis: usize| {
            let value = f64::from(index) * STEP[axis] + f64::from(self.shift[axis]);
            // Rounding to f32 may reach 1; the last float below keeps the point inside.
            ((value - value.floor()) as f32).min(1.0 - f32::EPSILON / 2.0)
        };
        [turn(0), turn(1)]
    }
}

/// Unit direction, uniform over the sphere, from a point of the unit square.
pub fn uniform_sphere(u: f32, v: f32) -> Vec3 {
    let z = 1.0 - 2.0 * u;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let (sine, cosine) = libm::sincosf(v * std::f32::consts::TAU);
    Vec3::new(radius * cosine, radius * sine, z)
}

/// Direction above a surface, uniform over the hemisphere about its normal, and its cosine to that.
pub fn uniform_hemisphere(normal: Vec3, [u, v]: [f32; 2]) -> (Vec3, f32) {
    let (tangent, bitangent) = tangent_frame(normal);
    let local = uniform_sphere(0.5 * u, v);
    (tangent * local.x + bitangent * local.y + normal * local.z, local.z)
}

/// Direction about +z with density cosθ/π, from a point of the unit square (concentric map, \[Shirley1997\]).
pub fn cosine_hemisphere([u, v]: [f32; 2]) -> Vec3 {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    if a == 0.0 && b == 0.0 {
        return Vec3::Z;
    }
    const QUARTER: f32 = std::f32::consts::FRAC_PI_4;
    let (radius, angle) =
        if a.abs() > b.abs() { (a, QUARTER * (b / a)) } else { (b, 2.0 * QUARTER - QUARTER * (a / b)) };
    let (sine, cosine) = libm::sincosf(angle);
    let (x, y) = (radius * cosine, radius * sine);
    Vec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}

/// Two unit vectors that complete `normal` to a right-handed frame (\[Duff2017\]).
pub fn tangent_frame(normal: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    (
        Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
    )
}

/// Point of a triangle, uniform over its area, as barycentric weights of corners 1 and 2 (\[Heitz2019\]).
pub fn uniform_triangle([u, v]: [f32; 2]) -> [f32; 2] {
    if v > u {
        let b1 = u * 0.5;
        [b1, v - b1]
    } else {
        let b2 = v * 0.5;
        [u - b2, b2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cosine_hemisphere_has_the_moments_of_its_density() {
        let points = R2::new(3);
        let count = 4096;
        let mean_z = (0..count).map(|i| cosine_hemisphere(points.point(i)).z).sum::<f32>() / count as f32;
        // E[cosθ] = ∫ cosθ · cosθ/π dω = 2/3.
        assert!((mean_z - 2.0 / 3.0).abs() < 2e-3, "{mean_z}");
    }

    #[test]
    fn tangent_frame_is_orthonormal_and_right_handed() {
        let points = R2::new(4);
        for index in 0..100 {
            let [u, v] = points.point(index);
            let n = uniform_sphere(u, v);
            let (t, b) = tangent_frame(n);
            assert!(t.dot(n).abs() < 1e-5 && b.dot(n).abs() < 1e-5 && t.dot(b).abs() < 1e-5);
            assert!((t.cross(b) - n).length() < 1e-5);
        }
    }

    #[test]
    fn triangle_samples_have_the_centroid_as_mean_and_stay_inside() {
        let points = R2::new(5);
        let (mut sum, count) = ([0.0; 2], 4096);
        for index in 0..count {
            let [b1, b2] = uniform_triangle(points.point(index));
            assert!(b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0 + 1e-6);
            sum = [sum[0] + b1, sum[1] + b2];
        }
        assert!(sum.iter().all(|s| (s / count as f32 - 1.0 / 3.0).abs() < 2e-3), "{sum:?}");
    }

    #[test]
    fn seeds_depend_on_every_part_and_its_place() {
        assert_ne!(seed_of(&[1, 2]), seed_of(&[2, 1]));
        assert_ne!(seed_of(&[1, 2]), seed_of(&[1, 3]));
    }
}
