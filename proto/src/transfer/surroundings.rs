//! Light that arrives at an object without the object: radiance of parts of the sphere, each from one walk.

use glam::{Mat3, Vec3, Vec4};

use crate::harmonics::relight_direction;
use crate::voxels::{Seen, Start, WalkLight, walk};

/// Tangent of a walk's half angle where so many walks share the sphere: `√(4/M)`.
pub const WALK_TANGENT: fn(u32) -> f32 = |walks| (4.0 / walks as f32).sqrt().min(1.0);

/// Radiance c of the parts of a sphere around an object, in its frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surroundings {
    /// Directions of the parts.
    directions: Vec<Vec3>,
    /// W·m⁻²·sr⁻¹.
    radiance: Vec<Vec4>,
}

impl Surroundings {
    /// What walks from a point in free space meet; `turn` is that of the object's frame.
    pub fn walked(light: &WalkLight<'_>, from_m: Vec3, turn: Mat3, parts: u32) -> Self {
        let (start, tangent) = (Start::free(from_m), WALK_TANGENT(parts));
        Self::new(parts, |direction| {
            let direction = turn * direction;
            let seen =
                walk(light.table(), &start, direction, tangent).map_or(Seen::Sky(direction), Seen::Hit);
            light.radiance(&seen)
        })
    }

    /// Of the radiance in each direction.
    pub fn new(parts: u32, radiance: impl Fn(Vec3) -> Vec3) -> Self {
        let directions: Vec<Vec3> = (0..parts).map(|part| relight_direction(part, parts)).collect();
        let radiance = directions.iter().map(|direction| radiance(*direction).extend(0.0)).collect();
        Self { directions, radiance }
    }

    /// Radiance by part.
    pub fn radiance(&self) -> &[Vec4] {
        &self.radiance
    }

    /// Mean radiance over a cap about an axis; `rim` is half the width of its edge, in cosine.
    pub fn mean(&self, axis: Vec3, cosine: f32, rim: f32) -> Vec3 {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (direction, radiance) in self.directions.iter().zip(&self.radiance) {
            let t = ((axis.dot(*direction) - cosine + rim) / (2.0 * rim)).clamp(0.0, 1.0);
            let weight = t * t * (3.0 - 2.0 * t);
            sum += radiance.truncate() * weight;
            total += weight;
        }
        if total > 0.0 { sum / total } else { Vec3::ZERO }
    }
}
