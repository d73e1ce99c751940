//! Points of an object from which its surroundings are looked at.

use glam::{UVec3, Vec3};

use super::surroundings::Surroundings;

/// Most viewpoints along an axis. More → light of what is near falls on the right part of an object, time with its cube.
pub const VIEWPOINTS_A_SIDE: u32 = 4;
/// Least distance of viewpoints in metres: nearer ones see the same.
const SPACING_M: f32 = 0.3;
/// Share of an object's bounds over which they stand.
const WITHIN: f32 = 0.97;
/// Least distance of a corner from the middle along an axis, in halves of the object's largest side: the viewpoints of a rug lie off the floor.
const FLAT: f32 = 0.05;
/// Least share of the way along an axis where those that are nearer see nothing.
const ASIDE: f32 = 0.02;
/// Least sum of the weights of those that see something; below it the others around count.
const TOTAL_MIN: f32 = 1e-3;

/// Viewpoints of an object, a lattice over its bounds in its own space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewpointLattice {
    /// Middle.
    pub middle_m: Vec3,
    /// From the middle to a corner.
    pub half_m: Vec3,
    /// Viewpoints along each axis, two at least.
    pub counts: UVec3,
}

/// Surroundings as an object's viewpoints see them.
#[derive(Clone, Debug, Default)]
pub struct Viewpoints {
    lattice: ViewpointLattice,
    /// Of each; none of one that lies in geometry or behind a wall.
    seen: Vec<Option<Surroundings>>,
}

impl ViewpointLattice {
    /// Of an object of such bounds in its own space, whose size is scaled: as many as its sides ask for.
    pub fn new(box_m: [[f32; 3]; 2], scale: f32) -> Self {
        let corners = Self::of_corners(box_m);
        let spaces = (2.0 * scale / SPACING_M * corners.half_m).as_uvec3();
        Self { counts: (spaces + 1).clamp(UVec3::splat(2), UVec3::splat(VIEWPOINTS_A_SIDE)), ..corners }
    }

    /// The corners alone.
    pub fn of_corners(box_m: [[f32; 3]; 2]) -> Self {
        let [low, high] = box_m.map(Vec3::from);
        let least_m = 0.5 * FLAT * (high - low).max_element();
        let half_m = (0.5 * WITHIN * (high - low)).max(Vec3::splat(least_m));
        Self { middle_m: 0.5 * (low + high), half_m, counts: UVec3::splat(2) }
    }

    /// Places, x fastest.
    pub fn places(&self) -> impl Iterator<Item = Vec3> {
        let Self { middle_m, half_m, counts } = *self;
        self.steps().map(move |step| middle_m + half_m * (2.0 * step / (counts - 1).as_vec3() - 1.0))
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.counts.element_product() as usize
    }

    fn steps(&self) -> impl Iterator<Item = Vec3> {
        let counts = self.counts;
        (0..counts.element_product())
            .map(move |index| {
                UVec3::new(index % counts.x, index / counts.x % counts.y, index / (counts.x * counts.y))
            })
            .map(|step| step.as_vec3())
    }

    /// Weight of each at a place: trilinear between those that are there.
    fn weights(&self, at_m: Vec3, is_there: impl Fn(usize) -> bool) -> Vec<f32> {
        let share = (0.5 + 0.5 * (at_m - self.middle_m) / self.half_m).clamp(Vec3::ZERO, Vec3::ONE);
        let at = share * (self.counts - 1).as_vec3();
        let of = |least: f32| -> Vec<f32> {
            let weight = |(index, step): (usize, Vec3)| {
                let along = (1.0 - (at - step).abs()).max(Vec3::splat(least));
                if is_there(index) { along.element_product() } else { 0.0 }
            };
            self.steps().enumerate().map(weight).collect()
        };
        let exact = of(0.0);
        // Beside those that see nothing, the nearest others count.
        let weights = if exact.iter().sum::<f32>() < TOTAL_MIN { of(ASIDE) } else { exact };
        let total = weights.iter().sum::<f32>().max(f32::MIN_POSITIVE);
        weights.into_iter().map(|weight| weight / total).collect()
    }
}

impl Viewpoints {
    /// Of a lattice; `look` gives what is seen from a point of it.
    pub fn new(lattice: ViewpointLattice, look: impl Fn(Vec3) -> Option<Surroundings>) -> Self {
        Self { lattice, seen: lattice.places().map(look).collect() }
    }

    /// Surroundings that each sees, none where it sees nothing.
    pub fn seen(&self) -> &[Option<Surroundings>] {
        &self.seen
    }

    /// Weight of each at a place of the object; all 0 where none sees anything.
    pub fn weights(&self, at_m: Vec3) -> Vec<f32> {
        self.lattice.weights(at_m, |index| self.seen[index].is_some())
    }
}
