//! Where a probe of the lattice stands: at its point, or near it where that is in geometry or too close to it.

use std::sync::LazyLock;

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::{MOVE_SHARE, MOVES_MAX};

use crate::geometry::Geometry;
use crate::kinds::field::{Place, is_free, place};

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
