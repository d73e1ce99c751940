//! Which cubes of a lattice a triangle touches, by the thirteen axes that can part the two, and the part of it inside a cube.
//!
//! Cubes are half-open: each point of space lies in one. A triangle in the plane between two cubes touches the upper one alone. On
//! all other axes touching counts, rounding too, so that a surface without holes is one of cubes without holes.

use glam::{DVec3, IVec3, Vec3};

/// Rounding of a test in f64, as a share of the numbers in it.
const ROUNDING: f64 = 1e-12;

/// A triangle, in f64.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Corners in metres.
    corners: [DVec3; 3],
    edges: [DVec3; 3],
    /// Normal times twice the area.
    scaled_normal: DVec3,
    low: DVec3,
    high: DVec3,
}

/// Part of a triangle inside a cube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clipped {
    /// Area in square metres; 0 where they only touch.
    pub area_m2: f64,
    /// Its middle, a point of the triangle.
    pub middle_m: DVec3,
}

impl Shape {
    /// Of corners in metres; `None` of a triangle without area, which no ray meets.
    pub fn new(corners: [Vec3; 3]) -> Option<Self> {
        let corners = corners.map(|corner| corner.as_dvec3());
        let [a, b, c] = corners;
        let scaled_normal = (b - a).cross(c - a);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let is_flat = scaled_normal.length_squared() > 0.0 && scaled_normal.is_finite();
        is_flat.then_some(Self { corners, edges: [b - a, c - b, a - c], scaled_normal, low, high })
    }

    /// Unit normal of its front.
    pub fn normal(&self) -> DVec3 {
        self.scaled_normal.normalize()
    }

    /// Whether it touches the cube of a lattice.
    pub fn touches(&self, cell: IVec3, side_m: f64) -> bool {
        let low = cell.as_dvec3() * side_m;
        let high = (cell + 1).as_dvec3() * side_m;
        if self.low.cmpge(high).any() || self.high.cmplt(low).any() {
            return false;
        }
        let half = 0.5 * side_m;
        let middle = low + half;
        let corners = self.corners.map(|corner| corner - middle);
        let reach = corners.iter().fold(half, |reach, corner| reach.max(corner.abs().max_element()));
        let is_apart = |axis: DVec3| {
            let along = corners.map(|corner| corner.dot(axis));
            let (least, most) = (along[0].min(along[1]).min(along[2]), along[0].max(along[1]).max(along[2]));
            let size = axis.abs().element_sum();
            let radius = (half + ROUNDING * reach) * size;
            least > radius || most < -radius
        };
        !is_apart(self.scaled_normal)
            && !self.edges.iter().any(|edge| DVec3::AXES.iter().any(|axis| is_apart(edge.cross(*axis))))
    }

    /// The part inside a cube that it touches.
    pub fn clipped(&self, cell: IVec3, side_m: f64) -> Clipped {
        let low = cell.as_dvec3() * side_m;
        let high = (cell + 1).as_dvec3() * side_m;
        let mut corners = self.corners.to_vec();
        for axis in 0..3 {
            corners = cut(&corners, |corner| corner[axis] - low[axis]);
            corners = cut(&corners, |corner| high[axis] - corner[axis]);
        }
        let Some((&first, rest)) = corners.split_first() else {
            return Clipped { area_m2: 0.0, middle_m: self.nearest(low + 0.5 * side_m) };
        };
        let (mut area, mut moment) = (0.0, DVec3::ZERO);
        for pair in rest.windows(2) {
            let part = 0.5 * (pair[0] - first).cross(pair[1] - first).length();
            area += part;
            moment += part / 3.0 * (first + pair[0] + pair[1]);
        }
        let middle_m = if area > 0.0 {
            moment / area
        } else {
            corners.iter().copied().sum::<DVec3>() / corners.len() as f64
        };
        Clipped { area_m2: area, middle_m }
    }

    /// Weights of corners 1 and 2 at a point of it, within 0 and 1.
    pub fn weights(&self, point_m: DVec3) -> [f64; 2] {
        let of = |a: DVec3, b: DVec3| (a - point_m).cross(b - point_m).dot(self.scaled_normal).max(0.0);
        let [a, b, c] = self.corners;
        let all = [of(b, c), of(c, a), of(a, b)];
        let sum: f64 = all.iter().sum();
        if sum > 0.0 { [all[1] / sum, all[2] / sum] } else { [1.0 / 3.0; 2] }
    }

    /// A point of it near another one.
    fn nearest(&self, point_m: DVec3) -> DVec3 {
        let [b1, b2] = self.weights(point_m);
        self.corners[0] * (1.0 - b1 - b2) + self.corners[1] * b1 + self.corners[2] * b2
    }
}

/// A polygon without what lies where `height` is below 0.
fn cut(corners: &[DVec3], height: impl Fn(&DVec3) -> f64) -> Vec<DVec3> {
    let mut kept = Vec::with_capacity(corners.len() + 1);
    for (index, corner) in corners.iter().enumerate() {
        let next = &corners[(index + 1) % corners.len()];
        let (own, other) = (height(corner), height(next));
        if own >= 0.0 {
            kept.push(*corner);
        }
        if (own < 0.0) != (other < 0.0) {
            kept.push(corner.lerp(*next, own / (own - other)));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::R2;

    fn shape(corners: [[f32; 3]; 3]) -> Shape {
        Shape::new(corners.map(Vec3::from)).unwrap()
    }

    #[test]
    fn triangle_between_two_cubes_touches_the_upper_one_alone() {
        let flat = shape([[0.1, 2.0, 0.1], [0.9, 2.0, 0.1], [0.1, 2.0, 0.9]]);
        assert!(flat.touches(IVec3::new(0, 2, 0), 1.0) && !flat.touches(IVec3::new(0, 1, 0), 1.0));
        assert!((flat.clipped(IVec3::new(0, 2, 0), 1.0).area_m2 - 0.32).abs() < 1e-6);
    }

    #[test]
    fn triangle_past_a_corner_touches_no_cube_that_it_misses() {
        // Bounds hold the cube at the origin, the plane passes by its far corner.
        let past = shape([[2.2, 0.0, 0.0], [0.0, 2.2, 0.0], [1.1, 1.1, 1.0]]);
        assert!(!past.touches(IVec3::ZERO, 1.0) && past.touches(IVec3::new(1, 1, 0), 1.0));
    }

    #[test]
    fn every_point_of_a_triangle_lies_in_a_cube_that_it_touches() {
        let points = R2::new(7);
        for turn in 0..200 {
            let at = |index: u32| {
                let [x, y] = points.point(3 * turn + index);
                Vec3::new(3.0 * x - 1.0, 3.0 * y - 1.0, 2.0 * (x * 7.3 + y * 3.1).fract())
            };
            let corners = [at(0), at(1), at(2)];
            let shape = Shape::new(corners).unwrap();
            for sample in 0..50 {
                let [mut b, mut c] = points.point(sample).map(f64::from);
                if b + c > 1.0 {
                    (b, c) = (1.0 - b, 1.0 - c);
                }
                let [p, q, r] = corners.map(|corner| corner.as_dvec3());
                let point = p * (1.0 - b - c) + q * b + r * c;
                let cell = (point / 0.25).floor().as_ivec3();
                assert!(shape.touches(cell, 0.25), "{corners:?} at {point}");
            }
        }
    }

    #[test]
    fn parts_in_all_cubes_make_the_whole() {
        let whole = shape([[0.03, 0.1, 0.2], [1.9, 0.4, -0.7], [0.6, 1.7, 0.9]]);
        let (mut area, mut moment) = (0.0, DVec3::ZERO);
        for index in 0..8_i32.pow(3) {
            let cell = IVec3::new(index % 8, index / 8 % 8, index / 64) - IVec3::new(0, 0, 4);
            if whole.touches(cell, 0.3) {
                let Clipped { area_m2, middle_m } = whole.clipped(cell, 0.3);
                area += area_m2;
                moment += area_m2 * middle_m;
            }
        }
        assert!((area - 0.5 * whole.scaled_normal.length()).abs() < 1e-9);
        let middle = whole.corners.iter().copied().sum::<DVec3>() / 3.0;
        assert!((moment / area - middle).length() < 1e-9);
        let [b1, b2] = whole.weights(middle);
        assert!((b1 - 1.0 / 3.0).abs() < 1e-12 && (b2 - 1.0 / 3.0).abs() < 1e-12);
    }
}
