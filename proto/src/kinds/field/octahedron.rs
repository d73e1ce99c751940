//! Depth maps of probes: numbers at the points of a lattice over the octahedron |x| + |y| + |z| = 1, unfolded to a square.
//!
//! A plane's reciprocal octahedral distance is linear over each face of the octahedron. The lattice has points on all edges of
//! faces and each of its squares is read as two triangles, cut along the faces' edges: so reads of planes are exact in all
//! directions, the axes among them, where bilinear reads between texels' middles err most.

use glam::Vec3;

/// Points along each side of a map.
pub const MAP_SIDE: usize = 17;
/// Points of a map.
pub const MAP_POINTS: usize = MAP_SIDE * MAP_SIDE;

/// Squares along each half of a side.
const HALF: i32 = (MAP_SIDE as i32 - 1) / 2;

/// Octahedral length |x| + |y| + |z|.
pub fn octahedral_length(vector: Vec3) -> f32 {
    vector.abs().element_sum()
}

/// Place of a direction on the square −1..1, the middle being +z; exact for lattice points.
fn unfolded(direction: Vec3) -> [f32; 2] {
    let [x, y, z] = (direction / octahedral_length(direction)).to_array();
    if z >= 0.0 { [x, y] } else { [(1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)] }
}

/// Direction of a map's point, column and row: a point of the octahedron. Points of the rim that are one point of the octahedron give
/// the same.
///
/// # Panics
/// If the point is none of the map.
pub fn map_direction(point: usize) -> Vec3 {
    assert!(point < MAP_POINTS, "point {point} of {MAP_POINTS}");
    let [u, v] = [point % MAP_SIDE, point / MAP_SIDE].map(|at| at as i32 - HALF);
    // In whole numbers, so that points of the rim meet exactly.
    let z = HALF - u.abs() - v.abs();
    let sign = |at: i32| if at < 0 { -1 } else { 1 };
    let [x, y] = if z >= 0 { [u, v] } else { [(HALF - v.abs()) * sign(u), (HALF - u.abs()) * sign(v)] };
    let of = |at: i32| at as f32 / HALF as f32;
    // A rim's point and its mirror image differ by the sign of a zero at most.
    Vec3::new(of(x) + 0.0, of(y) + 0.0, of(z))
}

/// The three points of a map whose triangle holds a direction, and their weights, which add up to 1.
///
/// Linear functions of the point of the octahedron are read exactly.
pub fn map_points(direction: Vec3) -> [(usize, f32); 3] {
    let at = unfolded(direction).map(|at| (at + 1.0) * HALF as f32);
    let last = MAP_SIDE - 2;
    let square = at.map(|at| (at as usize).min(last));
    let [s, t] = [0, 1].map(|axis| (at[axis] - square[axis] as f32).clamp(0.0, 1.0));
    let point = |x: usize, y: usize| (square[1] + y) * MAP_SIDE + square[0] + x;
    // Edges |u| + |v| = 1 fall where u and v have the same sign, and rise elsewhere; so do the cuts.
    let middle = HALF as usize;
    let falls = (square[0] >= middle) == (square[1] >= middle);
    if falls {
        if s + t <= 1.0 {
            [(point(0, 0), 1.0 - s - t), (point(1, 0), s), (point(0, 1), t)]
        } else {
            [(point(1, 1), s + t - 1.0), (point(0, 1), 1.0 - s), (point(1, 0), 1.0 - t)]
        }
    } else if s >= t {
        [(point(0, 0), 1.0 - s), (point(1, 0), s - t), (point(1, 1), t)]
    } else {
        [(point(0, 0), 1.0 - t), (point(0, 1), t - s), (point(1, 1), s)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::relight_direction;

    #[test]
    fn points_of_the_map_are_read_as_themselves() {
        for point in 0..MAP_POINTS {
            let direction = map_direction(point);
            assert!((octahedral_length(direction) - 1.0).abs() < 1e-6);
            for (other, weight) in map_points(direction) {
                let distance = map_direction(other).distance(direction);
                assert!(weight < 1e-5 || distance < 1e-5, "{point}: {other} counts {weight}");
            }
        }
    }

    #[test]
    fn points_of_the_rim_come_in_pairs() {
        for at in 0..MAP_SIDE {
            let mirrored = MAP_SIDE - 1 - at;
            assert_eq!(map_direction(at), map_direction(mirrored));
            assert_eq!(map_direction(at * MAP_SIDE), map_direction(mirrored * MAP_SIDE));
        }
    }

    #[test]
    fn planes_are_read_exactly_from_every_direction() {
        let planes = [Vec3::X, Vec3::NEG_Y, Vec3::Z, Vec3::new(0.6, -0.48, 0.64), Vec3::new(-0.2, 0.3, 0.93)];
        for normal in planes {
            // s = n·d / D of a point d of the octahedron.
            let map: Vec<f32> = (0..MAP_POINTS).map(|point| map_direction(point).dot(normal) / 2.5).collect();
            for ray in 0..4096 {
                let direction = relight_direction(ray, 4096);
                let read: f32 =
                    map_points(direction).iter().map(|&(point, weight)| map[point] * weight).sum();
                let exact = (direction / octahedral_length(direction)).dot(normal) / 2.5;
                assert!((read - exact).abs() < 1e-6, "{normal} {direction}: {read}, {exact}");
            }
        }
    }

    #[test]
    fn weights_of_a_triangle_are_shares_of_one() {
        for ray in 0..4096 {
            let points = map_points(relight_direction(ray, 4096));
            assert!(
                points.iter().all(|&(point, weight)| point < MAP_POINTS && (0.0..=1.0).contains(&weight))
            );
            assert!((points.iter().map(|(_, weight)| weight).sum::<f32>() - 1.0).abs() < 1e-6);
        }
    }
}
