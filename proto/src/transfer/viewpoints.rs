//! Points of an object from which its surroundings are looked at.

use glam::Vec3;

use super::surroundings::Surroundings;

/// Share of an object's bounds at whose corners light is looked for.
const WITHIN: f32 = 0.9;
/// Least distance of a corner from the middle along an axis, in halves of the object's largest side: the viewpoints of a rug lie off the floor.
const FLAT: f32 = 0.05;

/// Least share of the way along an axis where those that are nearer see nothing.
const ASIDE: f32 = 0.1;

/// Surroundings as an object's viewpoints see them: its middle alone, or the corners of its bounds where it is so long that they differ.
#[derive(Clone, Debug, Default)]
pub struct Viewpoints {
    middle_m: Vec3,
    /// From the middle to a corner.
    half_m: Vec3,
    /// Of each; none of one that lies in geometry or behind a wall.
    seen: Vec<Option<Surroundings>>,
}

/// Middle of an object's viewpoints, and the way from there to a corner.
pub fn viewpoint_bounds(box_m: [[f32; 3]; 2]) -> [Vec3; 2] {
    let [low, high] = box_m.map(Vec3::from);
    let least_m = 0.5 * FLAT * (high - low).max_element();
    [0.5 * (low + high), (0.5 * WITHIN * (high - low)).max(Vec3::splat(least_m))]
}

/// Viewpoints of an object of such bounds in its own space: the middle, or corners.
pub fn viewpoint_places(box_m: [[f32; 3]; 2], are_corners_seen: bool) -> Vec<Vec3> {
    let [middle_m, half_m] = viewpoint_bounds(box_m);
    let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
    let at = |corner: u32| middle_m + half_m * Vec3::new(sign(corner, 0), sign(corner, 1), sign(corner, 2));
    if are_corners_seen { (0..8).map(at).collect() } else { vec![middle_m] }
}

impl Viewpoints {
    /// Of an object of such bounds in its own space; `look` gives what is seen from a point of it, reached from its middle.
    pub fn new(
        box_m: [[f32; 3]; 2],
        are_corners_seen: bool,
        look: impl Fn(Vec3) -> Option<Surroundings>,
    ) -> Self {
        let [middle_m, half_m] = viewpoint_bounds(box_m);
        let places = viewpoint_places(box_m, are_corners_seen);
        let seen = places.into_iter().map(look).collect();
        Self { middle_m, half_m, seen }
    }

    /// Those that see something.
    pub fn seen(&self) -> impl Iterator<Item = &Surroundings> {
        self.seen.iter().flatten()
    }

    /// Weight of each of those that see something, at a place of the object: trilinear between corners.
    pub fn weights(&self, at_m: Vec3) -> Vec<f32> {
        if self.seen.len() != 8 {
            return vec![1.0; self.seen().count()];
        }
        let share = (0.5 + 0.5 * (at_m - self.middle_m) / self.half_m).clamp(Vec3::ZERO, Vec3::ONE);
        let weights_of = |least: f32| -> Vec<f32> {
            let along = |corner: usize, axis: usize| {
                let share = if corner >> axis & 1 == 1 { share[axis] } else { 1.0 - share[axis] };
                share.max(least)
            };
            let is_there = |corner: &usize| self.seen[*corner].is_some();
            let of = |corner: usize| (0..3).map(|axis| along(corner, axis)).product::<f32>();
            let weights: Vec<f32> = (0..8).filter(is_there).map(of).collect();
            let total: f32 = weights.iter().sum();
            if total < 1e-3 { Vec::new() } else { weights.iter().map(|weight| weight / total).collect() }
        };
        let exact = weights_of(0.0);
        // Beside corners that see nothing, the nearest others count.
        if exact.is_empty() { weights_of(ASIDE) } else { exact }
    }
}
