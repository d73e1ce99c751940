//! The way of a walk: from box to box through faces, never through an edge or corner.
//!
//! A walk is at a **tick**, a sub-voxel of level 0, and leaves a box of 2^size ticks that holds it. The next tick lies beyond the face that
//! the walk leaves by, and within the box along the other two axes. So the boxes that a walk visits, of whatever sizes, share faces one with the
//! next, rounding or not: a surface all of whose boxes are marked is not passed. Ticks never go back, so that a walk ends.

use glam::{BVec3, IVec3, Vec3};

use super::super::content::SUBS;
use super::super::table::VoxelTable;

/// Least speed along an axis, in metres per metre: axes along which a walk does not move have faces 10¹² m away, not infinitely far.
const SPEED_MIN: f32 = 1e-12;

/// Where a walk is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Its tick.
    pub tick: IVec3,
    /// Its length so far in metres.
    pub t_m: f32,
}

/// The face by which a walk leaves a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exit {
    /// Axis across the face.
    pub axis: usize,
    /// Where the face is, in ticks.
    pub plane: i32,
    /// Length of the walk there in metres.
    pub t_m: f32,
}

/// A line in ticks.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    /// Its start in ticks.
    start: Vec3,
    /// Ticks per metre.
    speed: Vec3,
    /// Metres per tick.
    pace_m: Vec3,
    /// Axes along which it ascends.
    ascends: BVec3,
}

impl Path {
    /// From a point along a direction of length 1, through voxels of that side at level 0.
    pub fn new(from_m: Vec3, direction: Vec3, voxel_m: f32) -> Self {
        let ticks_per_m = SUBS as f32 / voxel_m;
        let ascends = direction.cmpge(Vec3::ZERO);
        let least = Vec3::select(ascends, Vec3::splat(SPEED_MIN), Vec3::splat(-SPEED_MIN));
        let moves = direction.abs().cmpge(Vec3::splat(SPEED_MIN));
        let speed = Vec3::select(moves, direction, least) * ticks_per_m;
        Self { start: from_m * ticks_per_m, speed, pace_m: 1.0 / speed, ascends }
    }

    /// Where it enters the box of all bricks; `None` where it misses that.
    pub fn enter(&self, table: &VoxelTable) -> Option<Place> {
        let start = Place { tick: self.start.floor().as_ivec3(), t_m: 0.0 };
        if table.holds(start.tick) {
            return Some(start);
        }
        let low = (table.low.as_vec3() - self.start) * self.pace_m;
        let high = (table.high.as_vec3() - self.start) * self.pace_m;
        let t_m = low.min(high).max_element().max(0.0);
        let tick = (self.start + self.speed * t_m).floor().as_ivec3().clamp(table.low, table.high - 1);
        (t_m <= low.max(high).min_element()).then_some(Place { tick, t_m })
    }

    /// Where it leaves the box of 2^size ticks that holds a place. A face's length depends on nothing else, so that boxes of all sizes agree on
    /// it.
    pub fn exit(&self, place: Place, size: u32) -> Exit {
        let planes = ((place.tick >> size) + IVec3::from(self.ascends)) << size;
        let t_m = (planes.as_vec3() - self.start) * self.pace_m;
        let other = if t_m.y <= t_m.z { 1 } else { 2 };
        let axis = if t_m.x <= t_m[other] { 0 } else { other };
        Exit { axis, plane: planes[axis], t_m: t_m[axis].max(place.t_m) }
    }

    /// The place beyond.
    pub fn leave(&self, place: Place, size: u32) -> Place {
        let exit = self.exit(place, size);
        let low = (place.tick >> size) << size;
        let high = low + ((1 << size) - 1);
        let on = (self.start + self.speed * exit.t_m).floor().as_ivec3().clamp(low, high);
        let mut tick = IVec3::select(self.ascends, place.tick.max(on), place.tick.min(on));
        tick[exit.axis] = exit.plane - i32::from(!self.ascends.test(exit.axis));
        Place { tick, t_m: exit.t_m }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::shells::Random;
    use super::*;

    /// Directions: random ones, axes and diagonals.
    fn directions() -> Vec<Vec3> {
        let mut random = Random(7);
        let mut all: Vec<Vec3> = (0..500).map(|_| random.direction()).collect();
        for at in 0..27 {
            let at = IVec3::new(at % 3 - 1, at / 3 % 3 - 1, at / 9 - 1);
            all.extend(at.as_vec3().try_normalize());
        }
        all
    }

    #[test]
    fn ways_go_through_faces_alone_in_boxes_of_any_sizes() {
        let mut random = Random(3);
        for direction in directions() {
            // From corners of ticks, through boxes of 1 to 32 ticks.
            let from_m = (random.point() * 64.0).round() / 8.0;
            let path = Path::new(from_m, direction, 0.5);
            let mut place = Place { tick: (from_m * 8.0).floor().as_ivec3(), t_m: 0.0 };
            for step in 0..200 {
                let size = (random.next() * 6.0) as u32;
                let next = path.leave(place, size);
                let faces = ((place.tick >> size) - (next.tick >> size)).abs();
                assert_eq!(faces.element_sum(), 1, "{from_m} {direction} {step}");
                let forth = (next.tick - place.tick) * (2 * IVec3::from(path.ascends) - 1);
                assert!(forth.min_element() >= 0 && next.t_m >= place.t_m, "{from_m} {direction} {step}");
                place = next;
                let off = (from_m + direction * place.t_m) * 8.0 - (place.tick.as_vec3() + 0.5);
                assert!(off.abs().max_element() < 0.51, "{from_m} {direction} {step}: {off}");
            }
        }
    }

    #[test]
    fn ways_from_outside_enter_the_box_and_others_miss_it() {
        let table = VoxelTable {
            voxel_m: 0.5,
            low: IVec3::splat(-32),
            high: IVec3::splat(32),
            ..VoxelTable::default()
        };
        let mut random = Random(11);
        for _ in 0..1000 {
            let (from_m, to_m) = (random.point() * 20.0, random.point() * 20.0);
            let direction = (to_m - from_m).normalize();
            let mut least_m = f32::INFINITY;
            for step in 0..4000 {
                let at = from_m + direction * (0.02 * step as f32);
                least_m = least_m.min(at.abs().max_element());
            }
            match Path::new(from_m, direction, 0.5).enter(&table) {
                Some(place) => assert!(table.holds(place.tick) && least_m < 4.02, "{from_m} {direction}"),
                None => assert!(least_m > 3.98, "{from_m} {direction}: {least_m}"),
            }
        }
    }
}
