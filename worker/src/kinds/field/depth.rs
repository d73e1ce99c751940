//! Depth maps: how far from a probe the nearest surface is, along each direction of a map.
//!
//! A map is read in triangles between its points, each of which one ray found. Where a surface ends between two of them, such a read tells
//! it too far away, and light would pass it there; so points beside what is nearer take its depth.

use std::sync::LazyLock;

use glam::Vec3;
use lightkiln_proto::kinds::field::{MAP_POINTS, MAP_SIDE, depth_code, map_direction, octahedral_length};

use crate::geometry::{Geometry, Trail};

/// Share of a surface's own depth below which it is taken to end between two points of a map.
const BREAK: f32 = 0.9;

/// Points of a map that a side of a triangle joins.
static SIDES: LazyLock<Vec<[usize; 2]>> = LazyLock::new(|| {
    let middle = (MAP_SIDE - 1) / 2;
    let mut sides = Vec::new();
    for (y, x) in (0..MAP_SIDE).flat_map(|y| (0..MAP_SIDE).map(move |x| (y, x))) {
        let at = y * MAP_SIDE + x;
        let (is_left, is_above) = (x + 1 < MAP_SIDE, y + 1 < MAP_SIDE);
        sides.extend(is_left.then_some([at, at + 1]));
        sides.extend(is_above.then_some([at, at + MAP_SIDE]));
        let falls = (x >= middle) == (y >= middle);
        let across = if falls { [at + 1, at + MAP_SIDE] } else { [at, at + MAP_SIDE + 1] };
        sides.extend((is_left && is_above).then_some(across));
    }
    sides
});

/// A surface that a ray met, as the plane n·y = 1 about the probe: the reciprocal of a direction's octahedral distance to it is n·d, d being the
/// direction's point of the octahedron. 0 for the sky.
type Plane = Vec3;

/// The codes of a probe's map: the reciprocal of the octahedral distance of either side of a surface, 0 for the sky. Marks the `trail` of
/// its rays.
pub fn depths(geometry: &Geometry, position_m: Vec3, spacing_m: f32, trail: &Trail) -> Vec<u16> {
    let trail = trail.from(position_m);
    let plane = |point: usize| -> (f32, Plane) {
        let on = map_direction(point);
        let direction = on.normalize();
        let hit = geometry.tracer.closest(position_m, direction, f32::INFINITY);
        trail.mark(direction, hit.map(|hit| hit.t));
        let Some(hit) = hit else { return (0.0, Vec3::ZERO) };
        // A surface nearer than rays can tell is as near as codes can.
        let reciprocal = 1.0 / (hit.t * octahedral_length(direction)).max(f32::MIN_POSITIVE);
        let normal = geometry.face_normal(hit.triangle);
        (reciprocal, normal * (reciprocal / normal.dot(on)))
    };
    let found: Vec<(f32, Plane)> = (0..MAP_POINTS).map(plane).collect();
    covered(&found).into_iter().map(|reciprocal| depth_code(reciprocal, spacing_m)).collect()
}

/// Reciprocals at points, each raised to what the planes of its neighbours are there, where it lies beyond these: their surfaces end before
/// it. Walls of a room lie before each other's planes.
fn covered(found: &[(f32, Plane)]) -> Vec<f32> {
    let mut raised: Vec<f32> = found.iter().map(|(reciprocal, _)| *reciprocal).collect();
    let ways = SIDES.iter().flat_map(|&[a, b]| [[a, b], [b, a]]);
    for [from, to] in ways {
        // A plane that is met nearly along itself is told by little: it comes no nearer than half as far from one point to the next.
        let extended = found[from].1.dot(map_direction(to)).min(2.0 * found[from].0);
        if extended.is_finite() && found[to].0 < BREAK * extended {
            raised[to] = raised[to].max(extended);
        }
    }
    // Points of the rim that are one direction keep one depth.
    let last = MAP_SIDE - 1;
    for at in 0..MAP_SIDE {
        let mirrored = last - at;
        let along = [[at, mirrored], [last * MAP_SIDE + at, last * MAP_SIDE + mirrored]];
        let up = [[at * MAP_SIDE, mirrored * MAP_SIDE], [at * MAP_SIDE + last, mirrored * MAP_SIDE + last]];
        for [a, b] in along.into_iter().chain(up) {
            let most = raised[a].max(raised[b]);
            (raised[a], raised[b]) = (most, most);
        }
    }
    raised
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::harmonics::relight_direction;
    use lightkiln_proto::kinds::field::map_points;

    use super::*;

    /// The plane that is met along a direction; none of the sky.
    type Surroundings = fn(Vec3) -> Plane;

    /// Planes of a room about the probe.
    fn room(on: Vec3) -> Plane {
        let planes =
            [Vec3::X / 1.3, Vec3::NEG_X / 0.7, Vec3::Y / 2.0, Vec3::NEG_Y / 0.5, Vec3::Z, Vec3::NEG_Z / 1.6];
        planes.into_iter().max_by(|a, b| a.dot(on).total_cmp(&b.dot(on))).unwrap()
    }

    /// A board 1 m below the probe, before a ground 20 m below.
    fn board(on: Vec3) -> Plane {
        let at = on / -on.y;
        let is_met = on.y < 0.0 && at.x.abs() < 0.9 && at.z > -0.3 && at.z < 1.4;
        if is_met { Vec3::NEG_Y } else { Vec3::NEG_Y / 20.0 }
    }

    fn there(surroundings: Surroundings, direction: Vec3) -> f32 {
        let on = direction / octahedral_length(direction);
        surroundings(on).dot(on).max(0.0)
    }

    fn found(surroundings: Surroundings) -> Vec<(f32, Plane)> {
        let of = |point: usize| {
            let on = map_direction(point);
            (there(surroundings, on), surroundings(on))
        };
        (0..MAP_POINTS).map(of).collect()
    }

    fn read(map: &[f32], direction: Vec3) -> f32 {
        map_points(direction).iter().map(|&(point, weight)| map[point] * weight).sum()
    }

    #[test]
    fn walls_are_as_near_as_they_are_and_bends_no_farther() {
        let map = covered(&found(room));
        let mut exact = 0;
        for ray in 0..4096 {
            let direction = relight_direction(ray, 4096);
            let (told, there) = (read(&map, direction), there(room, direction));
            assert!(told > 0.999 * there && told < 1.3 * there, "{direction}: {told}, {there}");
            exact += u32::from((told / there - 1.0).abs() < 1e-3);
        }
        assert!(exact > 2800, "{exact} of 4096 directions are told exactly");
    }

    #[test]
    fn board_hides_all_that_is_behind_it() {
        let map = covered(&found(board));
        let without: Vec<f32> = found(board).into_iter().map(|(reciprocal, _)| reciprocal).collect();
        let (mut behind, mut leaks) = (0, 0);
        for ray in 0..16_384 {
            let direction = relight_direction(ray, 16_384);
            let there = there(board, direction);
            if board(direction / octahedral_length(direction)) == Vec3::NEG_Y {
                behind += 1;
                assert!(
                    read(&map, direction) > 0.95 * there,
                    "{direction}: {}, {there}",
                    read(&map, direction)
                );
                leaks += u32::from(read(&without, direction) < 0.95 * there);
            }
        }
        assert!(behind > 1000 && leaks > 50, "{leaks} of {behind}: the test shows nothing");
    }
}
