//! A point of a surface that gathers light, and the directions that it gathers from.

use std::f64::consts::PI;

use glam::Vec3;

use crate::rays::sampling::{cosine_hemisphere, tangent_frame};

/// A point of a lit side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// x in metres.
    pub position_m: Vec3,
    /// n, the unit shading normal.
    pub normal: Vec3,
    /// Unit normal of the face, of the same side.
    pub face_normal: Vec3,
}

impl Site {
    /// The same point of the other side.
    pub fn turned(&self) -> Self {
        Self { normal: -self.normal, face_normal: -self.face_normal, ..*self }
    }

    /// Density K(ω)/π with which [`Site::direction`] gives a direction, per steradian; 0 below the face.
    pub fn density(&self, direction: Vec3) -> f64 {
        let above = direction.dot(self.face_normal);
        if above <= 0.0 {
            return 0.0;
        }
        let mirrored = direction - self.face_normal * (2.0 * above);
        f64::from(direction.dot(self.normal).max(0.0) + mirrored.dot(self.normal).max(0.0)) / PI
    }

    /// Cosine by which lamps in a direction count: `max(0, n·ω)`, 0 below the face.
    pub fn lamp_cosine(&self, direction: Vec3) -> f64 {
        if direction.dot(self.face_normal) > 0.0 {
            f64::from(direction.dot(self.normal).max(0.0))
        } else {
            0.0
        }
    }

    /// A direction of density K/π, from a point of the unit square.
    pub fn direction(&self, point: [f32; 2]) -> Vec3 {
        self.directions().at(point).0
    }

    /// Directions of density K/π.
    pub fn directions(&self) -> Directions {
        let Self { normal, face_normal, .. } = *self;
        let (tangent, bitangent) = tangent_frame(normal);
        Directions { tangent, bitangent, normal, face_normal }
    }

    /// Start of rays from here.
    pub fn ray_origin_m(&self, offset_m: f32) -> Vec3 {
        self.position_m + self.face_normal * offset_m
    }

    /// Bits that tell it from other sites: the seed of its random numbers.
    pub fn identity(&self) -> [u64; 6] {
        let bits = |v: Vec3| v.to_array().map(|axis| u64::from(axis.to_bits()));
        let ([px, py, pz], [nx, ny, nz]) = (bits(self.position_m), bits(self.normal));
        [px, py, pz, nx, ny, nz]
    }
}

/// Cosine-distributed directions about a shading normal, all above the face, see [`Site::directions`].
pub struct Directions {
    tangent: Vec3,
    bitangent: Vec3,
    normal: Vec3,
    face_normal: Vec3,
}

impl Directions {
    /// The direction of a point of the unit square, and whether it lay below the face and was mirrored above it.
    pub fn at(&self, point: [f32; 2]) -> (Vec3, bool) {
        let local = cosine_hemisphere(point);
        let direction = self.tangent * local.x + self.bitangent * local.y + self.normal * local.z;
        let above = direction.dot(self.face_normal);
        if above < 0.0 { (direction - self.face_normal * (2.0 * above), true) } else { (direction, false) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::R2;

    #[test]
    fn directions_of_a_leaning_normal_stay_above_the_face_and_keep_their_energy() {
        let normal = Vec3::new(0.8, 0.6, 0.0);
        let site = Site { position_m: Vec3::ZERO, normal, face_normal: Vec3::Y };
        let points = R2::new(1);
        let count = 20_000;
        // ∫ ω_x K/π dω by the sampler and by uniform directions with the stated density.
        let (mut sampled, mut weighted, mut total) = (0.0, 0.0, 0.0);
        for index in 0..count {
            let direction = site.direction(points.point(index));
            assert!(direction.y >= 0.0);
            sampled += f64::from(direction.x) / f64::from(count);
            let uniform = lightkiln_proto::harmonics::relight_direction(index % 16_384, 16_384);
            let share = site.density(uniform) * 4.0 * PI / 16_384.0;
            if index < 16_384 {
                weighted += f64::from(uniform.x) * share;
                total += share;
            }
        }
        assert!((total - 1.0).abs() < 2e-3, "{total}");
        assert!((sampled - weighted).abs() < 5e-3, "{sampled} {weighted}");
    }
}
