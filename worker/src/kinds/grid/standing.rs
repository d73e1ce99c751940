//! Where a probe of the lattice stands: at its point, or near it where that is in geometry or too close to it.

use std::sync::LazyLock;

use glam::{IVec3, Vec3};
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::kinds::grid::{MOVE_SHARE, MOVES_MAX};

use crate::geometry::{Geometry, Trail};

/// Rays that look around a place.
const LOOK_RAYS: u32 = 64;
/// Share of rays that meet backs above which a place is in geometry.
const BACKS_MAX: f32 = 0.25;
/// Nearest that a surface may be, over the lattice's step.
const CLEARANCE: f32 = 0.1;

/// Steps from a point of the lattice: the shortest first, equals by x, y, z.
static MOVES: LazyLock<Vec<[i8; 3]>> = LazyLock::new(|| {
    let along = || -MOVES_MAX..=MOVES_MAX;
    let mut moves: Vec<[i8; 3]> =
        along().flat_map(|x| along().flat_map(move |y| along().map(move |z| [x, y, z]))).collect();
    let squared = |moved: &[i8; 3]| IVec3::from(moved.map(i32::from)).length_squared();
    moves.sort_by_key(|moved| (squared(moved), *moved));
    moves
});

/// Freedom of a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Free,
    /// Free, but nearer to a surface than a probe may be.
    Close,
    Inside,
}

/// Steps by which the probe of a point of the lattice, which is of use, is moved: the fewest to a place that is so too and free, and in sight of the point, unless
/// that is in geometry itself. `None` where there is no such place.
pub fn standing(
    geometry: &Geometry,
    point: IVec3,
    spacing_m: f32,
    is_of_use: impl Fn(Vec3) -> bool,
) -> Option<[i8; 3]> {
    let point_m = point.as_vec3() * spacing_m;
    let clearance_m = CLEARANCE * spacing_m;
    let of_point = place(geometry, point_m, clearance_m);
    if of_point == Place::Free {
        return Some([0; 3]);
    }
    let may_stand = |moved: &&[i8; 3]| {
        let at_m = point_m + Vec3::from(moved.map(f32::from)) * (MOVE_SHARE * spacing_m);
        is_of_use(at_m)
            && is_free(geometry, at_m, clearance_m)
            && (of_point == Place::Inside || !geometry.tracer.is_occluded(point_m, at_m))
    };
    MOVES[1..].iter().find(may_stand).copied()
}

/// A place is in geometry: more than a quarter of what is seen from it are backs.
pub fn is_inside(geometry: &Geometry, at_m: Vec3) -> bool {
    place(geometry, at_m, 0.0) == Place::Inside
}

/// A place is free, and no surface is nearer than so much.
pub fn is_free(geometry: &Geometry, at_m: Vec3, clearance_m: f32) -> bool {
    place(geometry, at_m, clearance_m) == Place::Free
}

/// Likewise, and marks the `trail` of the rays that tell.
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

fn place(geometry: &Geometry, at_m: Vec3, clearance_m: f32) -> Place {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_begin_with_the_shortest() {
        assert_eq!(MOVES.len(), 343);
        assert_eq!(MOVES[..3], [[0, 0, 0], [-1, 0, 0], [0, -1, 0]]);
        assert_eq!(MOVES[342], [3, 3, 3]);
    }
}
