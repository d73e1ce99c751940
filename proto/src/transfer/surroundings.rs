//! Light that arrives at an object without the object: radiance along walks from its middle, and of parts of the sphere, each from some.

use glam::{Mat3, Vec3, Vec4};

use crate::harmonics::relight_direction;
use crate::voxels::{Seen, Start, WalkLight, nearest_of_sky, walk};

/// Walks of each part of the sphere. More → lamps of their own size and energy, time in proportion.
pub const WALKS_OF_PART: u32 = 16;

/// Share of an object's bounds at whose corners light is looked for.
const WITHIN: f32 = 0.9;

/// Points of an object, in its own space, from which its surroundings are looked at: its middle, and the corners of its bounds where the object
/// is so long that they differ.
pub fn viewpoints_m(box_m: [[f32; 3]; 2], are_corners_seen: bool) -> Vec<Vec3> {
    let [low, high] = box_m.map(Vec3::from);
    let (middle, half) = (0.5 * (low + high), 0.5 * WITHIN * (high - low));
    if !are_corners_seen {
        return vec![middle];
    }
    let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
    (0..8)
        .map(|corner| middle + half * Vec3::new(sign(corner, 0), sign(corner, 1), sign(corner, 2)))
        .collect()
}

/// Weight of each of [`viewpoints_m`] at a point of the object.
pub fn view_weights(box_m: [[f32; 3]; 2], viewpoints: usize, at_m: Vec3) -> Vec<f32> {
    if viewpoints != 8 {
        return vec![1.0 / viewpoints.max(1) as f32; viewpoints];
    }
    let [low, high] = box_m.map(Vec3::from);
    let (middle, half) = (0.5 * (low + high), 0.5 * WITHIN * (high - low));
    let share =
        (0.5 + 0.5 * (at_m - middle) / half.max(Vec3::splat(f32::MIN_POSITIVE))).clamp(Vec3::ZERO, Vec3::ONE);
    let along =
        |corner: u32, axis: usize| if corner >> axis & 1 == 1 { share[axis] } else { 1.0 - share[axis] };
    (0..8).map(|corner| (0..3).map(|axis| along(corner, axis)).product()).collect()
}

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

impl Surroundings {
    /// What walks from a point in free space meet; `turn` is that of the object's frame.
    pub fn walked(light: &WalkLight<'_>, from_m: Vec3, turn: Mat3, parts: u32) -> Self {
        // As wide as its share of the sphere.
        let tangent = (4.0 / (WALKS_OF_PART * parts.max(1)) as f32).sqrt().min(1.0);
        let start = Start::free(from_m);
        Self::new(parts, |direction| {
            let direction = turn * direction;
            let seen =
                walk(light.table(), &start, direction, tangent).map_or(Seen::Sky(direction), Seen::Hit);
            light.radiance(&seen)
        })
    }

    /// Of the radiance in each direction.
    pub fn new(parts: u32, radiance: impl Fn(Vec3) -> Vec3) -> Self {
        let walks = WALKS_OF_PART * parts;
        let directions: Vec<Vec3> = (0..walks).map(|walk| relight_direction(walk, walks)).collect();
        let seen: Vec<Vec3> = directions.iter().map(|direction| radiance(*direction)).collect();
        let middles: Vec<Vec3> = (0..parts).map(|part| relight_direction(part, parts)).collect();
        let mut sums = vec![Vec4::ZERO; parts as usize];
        for (direction, seen) in directions.iter().zip(&seen) {
            if let Some(sum) = sums.get_mut(nearest_of_sky(&middles, *direction) as usize) {
                *sum += seen.extend(1.0);
            }
        }
        let mean = |sum: &Vec4| (sum.truncate() / sum.w.max(1.0)).extend(0.0);
        Self { directions, seen, radiance: sums.iter().map(mean).collect() }
    }

    /// Weighted mean of some with as many parts.
    pub fn mixed(of: &[Self], weights: &[f32]) -> Self {
        let Some(first) = of.first() else { return Self::default() };
        let mut mixed = Self {
            directions: first.directions.clone(),
            seen: vec![Vec3::ZERO; first.seen.len()],
            radiance: vec![Vec4::ZERO; first.radiance.len()],
        };
        for (own, weight) in of.iter().zip(weights) {
            mixed.seen.iter_mut().zip(&own.seen).for_each(|(sum, seen)| *sum += *weight * *seen);
            mixed.radiance.iter_mut().zip(&own.radiance).for_each(|(sum, part)| *sum += *weight * *part);
        }
        mixed
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
