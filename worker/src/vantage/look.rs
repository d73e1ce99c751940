//! The view from a point, and the points of a lattice that have one.

use glam::{UVec3, Vec3};
use lightkiln_proto::harmonics::relight_direction;
use rayon::prelude::*;

use crate::geometry::Geometry;
use crate::rays::Hit;

/// Rays that look around a point.
pub const LOOK_RAYS: u32 = 256;
/// Points along the scene's longest side.
const LATTICE_STEPS: u32 = 12;
/// Free space around a point, as a share of the lattice's step.
const CLEARANCE: f32 = 0.25;
/// Share of rays from a point that may meet backs.
const BACK_SHARE_MAX: f32 = 0.02;

/// Share of what a point sees that may be turned away from it. Where more is, the point is inside a thing, whose
/// double-sided shell has no backs.
const AWAY_MAX: f32 = 0.5;

/// Share of a point's view that is sky up to which it is in a room.
const ROOM_SKY: f32 = 0.15;
/// Share of points in rooms from which on a scene is looked at from inside.
pub const ROOM_POINTS: f32 = 0.125;

/// View from a point in all directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Share of rays that meet backs of single-sided surfaces.
    pub back_share: f32,
    /// Share of rays that meet clockwise sides, of single- and double-sided surfaces: those that a modeller turned away.
    pub away_share: f32,
    /// Share of rays that leave the scene.
    pub sky_share: f32,
    /// Distance to the nearest surface in metres.
    pub nearest_m: f32,
    /// Mean distance seen in metres; rays that leave the scene see nothing.
    pub mean_m: f32,
    /// Name of the surface with the nearest back.
    pub inside_of: Option<String>,
}

/// Directions of a look and their hits.
pub fn view(geometry: &Geometry, from_m: Vec3) -> impl Iterator<Item = (Vec3, Option<Hit>)> + '_ {
    (0..LOOK_RAYS).map(move |ray| {
        let direction = relight_direction(ray, LOOK_RAYS);
        (direction, geometry.tracer.closest(from_m, direction, f32::INFINITY))
    })
}

impl Look {
    /// Whether most surfaces in sight are turned away, as the shell of a thing is from its inside.
    pub fn is_in_thing(&self) -> bool {
        self.away_share > AWAY_MAX * (1.0 - self.sky_share)
    }

    /// Looks around from a point.
    pub fn from(geometry: &Geometry, from_m: Vec3) -> Self {
        let mut look = Self {
            back_share: 0.0,
            away_share: 0.0,
            sky_share: 0.0,
            nearest_m: f32::INFINITY,
            mean_m: 0.0,
            inside_of: None,
        };
        let mut nearest_back_m = f32::INFINITY;
        for (_, hit) in view(geometry, from_m) {
            let Some(hit) = hit else {
                look.sky_share += 1.0 / LOOK_RAYS as f32;
                continue;
            };
            look.nearest_m = look.nearest_m.min(hit.t);
            look.mean_m += hit.t / LOOK_RAYS as f32;
            look.away_share += f32::from(!hit.front) / LOOK_RAYS as f32;
            if !geometry.is_back(&hit) {
                continue;
            }
            look.back_share += 1.0 / LOOK_RAYS as f32;
            if hit.t < nearest_back_m {
                nearest_back_m = hit.t;
                look.inside_of = Some(geometry.instance(hit.triangle).path.clone());
            }
        }
        look
    }
}

/// A point in free space and its view.
#[derive(Clone, Debug, PartialEq)]
pub struct VantagePoint {
    /// Place in metres.
    pub position_m: Vec3,
    /// View.
    pub look: Look,
}

/// Points of a lattice over the scene's bounds that meet no backs and touch nothing, widest view first. Rays that leave the
/// scene see nothing: points inside come before those outside.
pub fn vantage_points(geometry: &Geometry) -> Vec<VantagePoint> {
    let [low, high] = geometry.near_bounds_m();
    let step_m = ((high - low).max_element() / LATTICE_STEPS as f32).max(f32::MIN_POSITIVE);
    let counts = ((high - low) / step_m).floor().as_uvec3().min(UVec3::splat(LATTICE_STEPS - 1)) + 1;
    let point = |index: u32| {
        let cell = UVec3::new(index % counts.x, index / counts.x % counts.y, index / (counts.x * counts.y));
        let share = (cell.as_vec3() + 0.5) / counts.as_vec3();
        let position_m = low + (high - low) * share;
        let look = Look::from(geometry, position_m);
        let is_free = look.back_share <= BACK_SHARE_MAX && look.nearest_m >= CLEARANCE * step_m;
        is_free.then_some(VantagePoint { position_m, look })
    };
    let mut points: Vec<VantagePoint> =
        (0..counts.element_product()).into_par_iter().filter_map(point).collect();
    points.sort_by(|a, b| b.look.mean_m.total_cmp(&a.look.mean_m));
    points
}

/// Those of a scene's points that are in rooms; none where they are so few that the scene is looked at from outside.
pub fn in_rooms(points: &[VantagePoint]) -> Vec<&VantagePoint> {
    let is_in_room = |point: &&VantagePoint| point.look.sky_share < ROOM_SKY && !point.look.is_in_thing();
    let rooms: Vec<&VantagePoint> = points.iter().filter(is_in_room).collect();
    if (rooms.len() as f32) < ROOM_POINTS * points.len() as f32 { Vec::new() } else { rooms }
}
