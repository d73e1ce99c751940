//! Light that arrives at an object without the object: radiance along walks from its middle, and of parts of the sphere, each from some.

use std::cell::Cell;

use glam::{Mat3, Vec3, Vec4};

use crate::harmonics::relight_direction;
use crate::voxels::{Seen, Start, WalkLight, nearest_of_sky, walk};

/// Walks of each part of the sphere from a viewpoint. More → small bright things have their own energy, time in proportion; many viewpoints tell
/// more than many walks.
pub const WALKS_OF_PART: u32 = 4;

/// Share of walks that meet backs above which a viewpoint lies in geometry.
const BACKS_MAX: f32 = 0.25;

/// Radiance c of the parts of a sphere around an object, in its frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surroundings {
    /// Directions of walks.
    directions: Vec<Vec3>,
    /// Radiance that they meet, W·m⁻²·sr⁻¹.
    seen: Vec<Vec3>,
    /// Mean radiance of the parts, W·m⁻²·sr⁻¹.
    radiance: Vec<Vec4>,
}

/// Directions of walks, and the part of the sphere that each is of.
pub fn directions_of_walks(parts: u32) -> impl Iterator<Item = (Vec3, u32)> {
    let walks = WALKS_OF_PART * parts;
    let middles: Vec<Vec3> = (0..parts).map(|part| relight_direction(part, parts)).collect();
    (0..walks).map(move |walk| {
        let direction = relight_direction(walk, walks);
        (direction, nearest_of_sky(&middles, direction))
    })
}

/// Tangent of the half angle of walks: each is as wide as its share of the sphere.
pub fn tangent_of_walks(parts: u32) -> f32 {
    (4.0 / (WALKS_OF_PART * parts.max(1)) as f32).sqrt().min(1.0)
}

impl Surroundings {
    /// Radiance along walks from a point in free space; `turn` is that of the object's frame. `None` from a point in geometry.
    pub fn walked(light: &WalkLight<'_>, from_m: Vec3, turn: Mat3, parts: u32) -> Option<Self> {
        let tangent = tangent_of_walks(parts);
        let start = Start::free(from_m);
        let backs = Cell::new(0);
        let found = Self::new(parts, |direction| {
            let direction = turn * direction;
            let seen =
                walk(light.table(), &start, direction, tangent).map_or(Seen::Sky(direction), Seen::Hit);
            backs.set(backs.get() + u32::from(matches!(&seen, Seen::Hit(hit) if hit.is_back)));
            light.radiance(&seen)
        });
        (backs.get() as f32 <= BACKS_MAX * found.seen.len() as f32).then_some(found)
    }

    /// Of the radiance in each direction.
    pub fn new(parts: u32, radiance: impl Fn(Vec3) -> Vec3) -> Self {
        let (directions, of_parts): (Vec<Vec3>, Vec<u32>) = directions_of_walks(parts).unzip();
        let seen: Vec<Vec3> = directions.iter().map(|direction| radiance(*direction)).collect();
        let mut sums = vec![Vec4::ZERO; parts as usize];
        for (part, seen) in of_parts.iter().zip(&seen) {
            if let Some(sum) = sums.get_mut(*part as usize) {
                *sum += seen.extend(1.0);
            }
        }
        let mean = |sum: &Vec4| (sum.truncate() / sum.w.max(1.0)).extend(0.0);
        Self { directions, seen, radiance: sums.iter().map(mean).collect() }
    }

    /// Radiance by part.
    pub fn radiance(&self) -> &[Vec4] {
        &self.radiance
    }

    /// Mean radiance over a cap about an axis; `rim` is half the width of its edge, in cosine.
    pub fn mean(&self, axis: Vec3, cosine: f32, rim: f32) -> Vec3 {
        let (mut sum, mut total) = (Vec3::ZERO, 0.0);
        for (direction, seen) in self.directions.iter().zip(&self.seen) {
            let t = ((axis.dot(*direction) - cosine + rim) / (2.0 * rim)).clamp(0.0, 1.0);
            let weight = t * t * (3.0 - 2.0 * t);
            sum += *seen * weight;
            total += weight;
        }
        if total > 0.0 { sum / total } else { Vec3::ZERO }
    }
}
