//! Places where an object may stand, of the scene alone: in the open, beside a wall, in a doorway.

use glam::{Quat, Vec3};
use lightkiln_proto::scene::Stance;
use rayon::prelude::*;

use super::{VantagePoint, in_rooms, vantage_points};
use crate::geometry::Geometry;

/// Height of an object above its floor in metres: what touches has no light between.
const LIFT_M: f32 = 0.002;
/// Distance of an object from its wall in metres.
const WALL_GAP_M: f32 = 0.05;
/// Least upward part of a floor's normal, and most of a wall's.
const FLOOR_UP: f32 = 0.95;
const WALL_UP: f32 = 0.1;
/// Depth below an object's corners within which its floor is.
const SUPPORT_M: f32 = 0.05;
/// Level ways in which walls and doorways are sought.
const WAYS: u32 = 16;
/// Distance of lines through an object's bounds that meet nothing where it fits, and of places in a gap, in metres, and how many lines there are along a side.
const LINES_M: f32 = 0.1;
const LINES: [u32; 2] = [3, 12];
/// Turn of an object in the open: no face is then parallel to what usual rooms are built by.
const TURN_DEG: f32 = 25.0;
/// Ways in which gaps are sought; and how much farther what is seen through one is than its ends, beside a step of the way.
const GAP_WAYS: u32 = 64;
const GAP_FARTHER: f32 = 1.3;
/// Places to either side of a gap's ends at which it is measured.
const STEPS: i32 = 4;
const STEP_M: f32 = 0.25;
/// Least width before and behind a doorway over its own.
const DOORWAY: f32 = 1.6;
/// Least distance from a doorway's middle at which these are measured, in metres.
const BEYOND_M: f32 = 0.75;

/// A place for an object.
#[derive(Clone, Debug, PartialEq)]
pub struct StandingPlace {
    /// Sort of place: `floor`, `wall` or `doorway`.
    pub name: &'static str,
    /// Where the object stands.
    pub stance: Stance,
}

/// An object's bounds in its own frame.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    half_m: Vec3,
    /// Middle of the bottom.
    foot_m: Vec3,
}

/// A point of a floor below free space.
#[derive(Clone, Copy, Debug)]
struct Footing {
    at_m: Vec3,
    above_m: Vec3,
}

/// Places where an object with these bounds fits, one of each sort that there is; and notes on those that there are not.
pub fn standing_places(geometry: &Geometry, [low, high]: [Vec3; 2]) -> (Vec<StandingPlace>, Vec<String>) {
    let middle = 0.5 * (low + high);
    let bounds = Bounds { half_m: 0.5 * (high - low), foot_m: Vec3::new(middle.x, low.y, middle.z) };
    let standing = Standing { geometry, bounds };
    let footings = standing.footings();
    let found = [
        ("floor", standing.in_the_open(&footings), "no floor was found on which it fits"),
        ("wall", standing.beside_a_wall(&footings), "no wall was found beside which it fits"),
        ("doorway", standing.in_a_doorway(&footings), "no doorway was found in which it fits"),
    ];
    let (mut places, mut notes) = (Vec::new(), Vec::new());
    for (name, stance, absent) in found {
        match stance {
            Some(stance) => places.push(StandingPlace { name, stance }),
            None => notes.push(format!("{name}: {absent}")),
        }
    }
    (places, notes)
}

struct Standing<'a> {
    geometry: &'a Geometry,
    bounds: Bounds,
}

impl Standing<'_> {
    /// Floors below vantage points, those in rooms alone where there are some.
    fn footings(&self) -> Vec<Footing> {
        let points = vantage_points(self.geometry);
        let rooms = in_rooms(&points);
        let all: Vec<&VantagePoint> = if rooms.is_empty() { points.iter().collect() } else { rooms };
        let mut footings: Vec<Footing> = Vec::new();
        for point in all {
            let Some(at_m) = self.floor_below(point.position_m, f32::INFINITY) else { continue };
            let above_m = at_m + Vec3::Y * self.bounds.half_m.y.max(LIFT_M);
            let is_known = footings.iter().any(|known| known.at_m.distance(at_m) < SUPPORT_M);
            if !is_known && self.is_open(point.position_m, above_m) {
                footings.push(Footing { at_m, above_m });
            }
        }
        footings
    }

    /// The footing with most free space around at which the object fits.
    fn in_the_open(&self, footings: &[Footing]) -> Option<Stance> {
        let of = |footing: &Footing| {
            let stance = self.stance_at(footing.at_m, TURN_DEG)?;
            let clearance = level_ways(WAYS).map(|way| self.free_m(footing.above_m, way));
            Some((clearance.fold(f32::INFINITY, f32::min), stance))
        };
        let all: Vec<(f32, Stance)> = footings.par_iter().filter_map(of).collect();
        most(all).map(|(_, stance)| stance)
    }

    /// Before the nearest wall of the first footing that has one, turned to it.
    fn beside_a_wall(&self, footings: &[Footing]) -> Option<Stance> {
        let of = |footing: &Footing| {
            let walls = level_ways(WAYS).filter_map(|way| {
                let hit = self.geometry.tracer.closest(footing.above_m, way, f32::INFINITY)?;
                let normal = self.geometry.side_normal(&hit);
                let is_wall = normal.y.abs() < WALL_UP && !self.geometry.is_back(&hit);
                is_wall.then_some((hit.t, self.geometry.point_of(&hit), normal))
            });
            let mut walls: Vec<(f32, Vec3, Vec3)> = walls.collect();
            walls.sort_by(|a, b| a.0.total_cmp(&b.0));
            walls.into_iter().find_map(|(_, wall_m, normal)| self.before_wall(wall_m, normal))
        };
        footings.par_iter().find_map_first(of)
    }

    fn before_wall(&self, wall_m: Vec3, normal: Vec3) -> Option<Stance> {
        let out = Vec3::new(normal.x, 0.0, normal.z).normalize_or_zero();
        let Bounds { half_m, .. } = self.bounds;
        let above_m = wall_m + out * (half_m.z + WALL_GAP_M);
        let stance =
            self.stance_at(self.floor_below(above_m, f32::INFINITY)?, out.x.atan2(out.z).to_degrees())?;
        // The wall is behind all of it.
        let middle_m = self.middle_of(&stance);
        let across = Vec3::new(out.z, 0.0, -out.x) * half_m.x;
        let reach_m = half_m.z + 2.0 * WALL_GAP_M;
        let corners = [(1.0, 0.9), (1.0, -0.9), (-1.0, 0.9), (-1.0, -0.9)];
        let is_behind = corners.into_iter().all(|(side, height)| {
            let from_m = middle_m + side * across + Vec3::Y * (height * half_m.y);
            self.free_m(from_m, -out) < reach_m
        });
        is_behind.then_some(stance)
    }

    /// In the narrowest place, over what is before and behind it, in which it fits.
    fn in_a_doorway(&self, footings: &[Footing]) -> Option<Stance> {
        let of =
            |footing: &Footing| most(self.gaps(footing).into_iter().filter_map(|gap| self.doorway_in(gap)));
        let all: Vec<(f32, Stance)> = footings.par_iter().filter_map(of).collect();
        most(all).map(|(_, stance)| stance)
    }

    /// Ends of gaps between what is near a footing, through which something far is seen.
    fn gaps(&self, footing: &Footing) -> Vec<[Vec3; 2]> {
        let from_m = footing.above_m;
        let far_m = self.geometry.near_diagonal_m();
        let seen: Vec<(f32, Vec3)> = level_ways(GAP_WAYS)
            .map(|way| (self.free_m(from_m, way).min(far_m), way))
            .map(|(free_m, way)| (free_m, from_m + way * free_m))
            .collect();
        let at = |way: usize| seen[way % seen.len()];
        let is_farther = |far: f32, near: f32| far > GAP_FARTHER * near + STEP_M;
        let gap = |first: usize| {
            let (near_m, edge_m) = at(first);
            if !is_farther(at(first + 1).0, near_m) {
                return None;
            }
            let mut after = first + 2..first + seen.len() / 2;
            let last = after.find(|way| is_farther(at(way - 1).0, at(*way).0))?;
            Some([edge_m, at(last).1])
        };
        (0..seen.len()).filter_map(gap).collect()
    }

    /// How much narrower a gap is than what lies before and behind it, if it is a doorway, and the object in its middle.
    fn doorway_in(&self, [edge_m, other_m]: [Vec3; 2]) -> Option<(f32, Stance)> {
        let across = (other_m - edge_m).try_normalize()?;
        let through = Vec3::new(across.z, 0.0, -across.x);
        let narrowest = (-STEPS..=STEPS).filter_map(|step| {
            let at_m = 0.5 * (edge_m + other_m) + through * (step as f32 * LINES_M);
            let [ahead_m, behind_m] = self.sides_m(at_m, across);
            let is_between =
                self.is_open(0.5 * (edge_m + other_m), at_m) && ahead_m + behind_m < f32::INFINITY;
            is_between.then(|| (ahead_m + behind_m, at_m + across * (0.5 * (ahead_m - behind_m))))
        });
        let (width_m, middle_m) = narrowest.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let beyond_m = width_m.max(BEYOND_M);
        let beyond = [through, -through].map(|way| {
            let there_m = middle_m + way * beyond_m;
            if self.is_open(middle_m, there_m) { self.sides_m(there_m, across).iter().sum() } else { 0.0 }
        });
        let narrower = beyond[0].min(beyond[1]).min(self.geometry.near_diagonal_m()) / width_m;
        if !narrower.is_finite() || narrower < DOORWAY {
            return None;
        }
        let floor_m = self.floor_below(middle_m, f32::INFINITY)?;
        let yaw_deg = through.x.atan2(through.z).to_degrees();
        let stance = [yaw_deg, yaw_deg + 90.0].into_iter().find_map(|yaw| self.stance_at(floor_m, yaw))?;
        Some((narrower, stance))
    }

    /// Free distances to both sides along a level way.
    fn sides_m(&self, at_m: Vec3, way: Vec3) -> [f32; 2] {
        [way, -way].map(|way| self.free_m(at_m, way))
    }

    fn free_m(&self, from_m: Vec3, way: Vec3) -> f32 {
        self.geometry.tracer.closest(from_m, way, f32::INFINITY).map_or(f32::INFINITY, |hit| hit.t)
    }

    fn is_open(&self, from_m: Vec3, to_m: Vec3) -> bool {
        let way_m = to_m - from_m;
        let length_m = way_m.length();
        length_m == 0.0 || self.geometry.tracer.closest(from_m, way_m / length_m, length_m).is_none()
    }

    /// The floor below a point within a distance.
    fn floor_below(&self, from_m: Vec3, within_m: f32) -> Option<Vec3> {
        let hit = self.geometry.tracer.closest(from_m, Vec3::NEG_Y, within_m)?;
        let is_floor = self.geometry.side_normal(&hit).y > FLOOR_UP && !self.geometry.is_back(&hit);
        is_floor.then(|| self.geometry.point_of(&hit))
    }

    /// The object on a point of a floor, if it fits there and the floor bears it.
    fn stance_at(&self, floor_m: Vec3, yaw_deg: f32) -> Option<Stance> {
        let turn = Quat::from_rotation_y(yaw_deg.to_radians());
        let position_m = floor_m + Vec3::Y * LIFT_M - turn * self.bounds.foot_m;
        let stance =
            Stance { position_m: position_m.into(), turn_deg: [yaw_deg, 0.0, 0.0], ..Stance::default() };
        (self.is_borne(&stance) && self.fits(&stance)).then_some(stance)
    }

    fn middle_of(&self, stance: &Stance) -> Vec3 {
        let Bounds { half_m, foot_m } = self.bounds;
        let turn = Quat::from_rotation_y(stance.turn_deg[0].to_radians());
        Vec3::from(stance.position_m) + turn * (foot_m + Vec3::Y * half_m.y)
    }

    /// A floor is below all corners.
    fn is_borne(&self, stance: &Stance) -> bool {
        let turn = Quat::from_rotation_y(stance.turn_deg[0].to_radians());
        let half_m = 0.9 * self.bounds.half_m;
        let foot_m = self.middle_of(stance) - Vec3::Y * self.bounds.half_m.y;
        [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].into_iter().all(|(x, z)| {
            let corner_m = foot_m + turn * Vec3::new(x * half_m.x, 0.0, z * half_m.z);
            self.floor_below(corner_m, SUPPORT_M).is_some()
        })
    }

    /// No surface meets lines through its bounds.
    fn fits(&self, stance: &Stance) -> bool {
        let turn = Quat::from_rotation_y(stance.turn_deg[0].to_radians());
        let (middle_m, half_m) = (self.middle_of(stance), self.bounds.half_m);
        (0..3).all(|axis| {
            let [first, second] = [(axis + 1) % 3, (axis + 2) % 3];
            let lines = |axis: usize| ((2.0 * half_m[axis] / LINES_M) as u32 + 1).clamp(LINES[0], LINES[1]);
            (0..lines(first) * lines(second)).all(|line| {
                let share = |index: u32, count: u32| 2.0 * index as f32 / (count - 1) as f32 - 1.0;
                let mut from_m = Vec3::ZERO;
                from_m[axis] = -half_m[axis];
                from_m[first] = half_m[first] * share(line % lines(first), lines(first));
                from_m[second] = half_m[second] * share(line / lines(first), lines(second));
                let mut to_m = from_m;
                to_m[axis] = half_m[axis];
                self.is_open(middle_m + turn * from_m, middle_m + turn * to_m)
            })
        })
    }
}

fn level_ways(count: u32) -> impl Iterator<Item = Vec3> {
    (0..count).map(move |way| {
        let turn = std::f32::consts::TAU * way as f32 / count as f32;
        Vec3::new(turn.cos(), 0.0, turn.sin())
    })
}

/// The first of those with the largest number.
fn most(all: impl IntoIterator<Item = (f32, Stance)>) -> Option<(f32, Stance)> {
    all.into_iter().reduce(|most, next| if next.0 > most.0 { next } else { most })
}
