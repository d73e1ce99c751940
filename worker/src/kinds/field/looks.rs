//! Freedom of a place: whether it lies in geometry, or too near to it.

use glam::Vec3;
use lightkiln_proto::harmonics::relight_direction;

use crate::geometry::{Geometry, Trail};

/// Rays that look around a place.
const LOOK_RAYS: u32 = 64;
/// Share of rays that meet backs above which a place is in geometry.
const BACKS_MAX: f32 = 0.25;

/// Nearest that a surface may be to a place where no probe around it sees it, over the distance between probes.
const NARROW: f32 = 0.1;
/// The same in metres, at most: what moves between columns and mouldings is nearer to them than a share of a wide step. No nearer than depth maps
/// tell, as a share of the step.
const NARROW_MOST_M: f32 = 0.03;
const NARROW_LEAST: f32 = 0.03;

/// Freedom of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Nothing is near.
    Free,
    /// Free, but nearer to a surface than a probe may be.
    Close,
    /// In geometry.
    Inside,
}

/// A place is in geometry: more than a quarter of what is seen from it are backs.
pub fn is_inside(geometry: &Geometry, at_m: Vec3) -> bool {
    place(geometry, at_m, 0.0) == Place::Inside
}

/// A place is free, and no surface is nearer than so much.
pub fn is_free(geometry: &Geometry, at_m: Vec3, clearance_m: f32) -> bool {
    place(geometry, at_m, clearance_m) == Place::Free
}

/// Nearest that a surface may be to a place that no probe around it sees, in metres.
pub fn narrow_clearance_m(spacing_m: f32) -> f32 {
    (NARROW * spacing_m).min(NARROW_MOST_M.max(NARROW_LEAST * spacing_m))
}

/// A front is nearer than so much: something there is to be lit.
pub fn sees_front(geometry: &Geometry, at_m: Vec3, reach_m: f32) -> bool {
    (0..LOOK_RAYS).any(|ray| {
        let hit = geometry.tracer.closest(at_m, relight_direction(ray, LOOK_RAYS), reach_m);
        hit.is_some_and(|hit| !geometry.is_back(&hit))
    })
}

/// A place is free likewise; marks the `trail` of the rays that tell.
pub fn is_free_by(geometry: &Geometry, at_m: Vec3, clearance_m: f32, trail: &Trail) -> bool {
    trail.mark_box(at_m - clearance_m, at_m + clearance_m);
    let from = trail.from(at_m);
    for ray in 0..LOOK_RAYS {
        let direction = relight_direction(ray, LOOK_RAYS);
        let hit = geometry.tracer.closest(at_m, direction, f32::INFINITY);
        from.mark(direction, hit.map(|hit| hit.t));
    }
    is_free(geometry, at_m, clearance_m)
}

/// Freedom of a place, from which no surface may be nearer than so much.
pub fn place(geometry: &Geometry, at_m: Vec3, clearance_m: f32) -> Place {
    let (mut backs, mut is_close) = (0, false);
    for ray in 0..LOOK_RAYS {
        let direction = relight_direction(ray, LOOK_RAYS);
        // From before the place: a ray that starts on a surface may not meet it.
        let reach_m = clearance_m * direction;
        is_close |= geometry.tracer.is_occluded(at_m - reach_m, at_m + reach_m);
        let Some(hit) = geometry.tracer.closest(at_m, direction, f32::INFINITY) else { continue };
        backs += u32::from(geometry.is_back(&hit));
        if backs as f32 > BACKS_MAX * LOOK_RAYS as f32 {
            return Place::Inside;
        }
    }
    if is_close { Place::Close } else { Place::Free }
}
