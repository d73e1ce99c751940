//! The tracer: a BVH2 over world triangles with closest-hit and occlusion queries.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::fast_stack;
use obvhs::ray::{Ray, RayHit};
use obvhs::{Boundable, BvhBuildParams};

use super::count::{RayCount, note};
use super::watertight::WatertightRay;

/// First hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the ray's direction.
    pub t: f32,
    /// Triangle as given to [`Tracer::new`].
    pub triangle: u32,
    /// Weights of corners 1 and 2.
    pub barycentric: [f32; 2],
    /// The side that is counter-clockwise was met.
    pub front: bool,
}

/// Decides whether a triangle lets a ray through at a point (alpha-masked texels).
pub trait AlphaTest: Send + Sync {
    /// The triangle has texels that let rays through.
    fn is_masked(&self, triangle: u32) -> bool;
    /// The texel at the barycentric weights (of corners 1 and 2) is solid.
    fn is_solid(&self, triangle: u32, barycentric: [f32; 2]) -> bool;
}

/// Triangles ready for rays.
pub struct Tracer {
    bvh: Bvh2,
    /// Corners in the tree's leaf order.
    corners: Vec<[Vec3; 3]>,
    /// Triangle as given, in the tree's leaf order.
    triangle: Vec<u32>,
    /// Whether the triangle is masked, in the tree's leaf order.
    masked: Vec<bool>,
    alpha: Option<Box<dyn AlphaTest>>,
    ray_offset_m: f32,
    /// Middle and half side, in metres, of a cube whose surfaces have no far corners: lifts are smaller there.
    core: Option<(Vec3, f32)>,
}

/// Lift of rays off surfaces over the largest coordinate: 2⁻¹⁷ of it is some 60 units in the last place, far above the hit
/// point's own error.
const LIFT: f32 = 7.6e-6;

struct PaddedTriangle {
    corners: [Vec3; 3],
}

impl Boundable for PaddedTriangle {
    /// Bounds grown by two parts in a million: the slab test rounds, the watertight test must never be cut short.
    fn aabb(&self) -> Aabb {
        let [a, b, c] = self.corners.map(Vec3A::from);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let pad = low.abs().max(high.abs()) * 2e-6 + 1e-9;
        Aabb::new(low - pad, high + pad)
    }
}

impl Tracer {
    /// Builds the tree over triangles given by their corners.
    pub fn new(triangles: &[[Vec3; 3]], alpha: Option<Box<dyn AlphaTest>>) -> Self {
        let bounded: Vec<_> = triangles.iter().map(|corners| PaddedTriangle { corners: *corners }).collect();
        let bvh = if bounded.is_empty() {
            Bvh2::default()
        } else {
            let mut build_time = Duration::ZERO;
            build_bvh2(&bounded, BvhBuildParams::medium_build(), &mut build_time)
        };
        let triangle: Vec<u32> =
            if triangles.is_empty() { Vec::new() } else { bvh.primitive_indices.clone() };
        let corners = triangle.iter().map(|&index| triangles[index as usize]).collect();
        let masked = triangle
            .iter()
            .map(|&index| alpha.as_ref().is_some_and(|alpha| alpha.is_masked(index)))
            .collect();
        // No least reach in metres: a scene in micrometres is the same scene.
        let reach =
            triangles.iter().flatten().fold(0.0_f32, |reach, corner| reach.max(corner.abs().max_element()));
        Self { bvh, corners, triangle, masked, alpha, ray_offset_m: reach * LIFT, core: None }
    }

    /// The tracer of a scene with a core: about a point, no surface has coordinates much larger than the point is away from
    /// the `middle_m` of the core, or the core is wide.
    #[must_use]
    pub fn about(mut self, middle_m: Vec3, half_m: f32) -> Self {
        self.core = Some((middle_m, half_m));
        self
    }

    /// Lift of ray origins off surfaces about a point, in metres; grows with the coordinates there.
    pub fn ray_offset_m(&self, about_m: Vec3) -> f32 {
        let Some((middle_m, half_m)) = self.core else { return self.ray_offset_m };
        let away_m = (about_m - middle_m).abs().max_element();
        let reach_m = middle_m.abs().max_element() + (2.0 * away_m).max(half_m);
        (reach_m * LIFT).min(self.ray_offset_m)
    }

    /// The nearest hit with `t` in 0..`t_max`; of equally near triangles, the one with the smallest index.
    pub fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        note(RayCount { closest: 1, ..RayCount::default() });
        let prepared = WatertightRay::new(origin, direction);
        let mut best: Option<Hit> = None;
        let mut t_best = t_max;
        self.traverse(origin, direction, t_max, |index, ray_t_max| {
            let Some(hit) = prepared.intersect(&self.corners[index]) else { return true };
            let triangle = self.triangle[index];
            let nearer =
                hit.t < t_best || (hit.t == t_best && best.is_some_and(|best| triangle < best.triangle));
            if nearer && self.is_solid(index, hit.barycentric) {
                t_best = hit.t;
                // A little further than the hit, so that a tie in a later node is still visited.
                *ray_t_max = hit.t * (1.0 + 4e-6) + 1e-20;
                best = Some(Hit {
                    t: hit.t,
                    triangle,
                    barycentric: hit.barycentric,
                    front: self.is_front(index, direction),
                });
            }
            true
        });
        best
    }

    /// Something solid lies on the open segment between two points.
    pub fn is_occluded(&self, from: Vec3, to: Vec3) -> bool {
        let direction = to - from;
        if direction.length_squared() == 0.0 {
            return false;
        }
        note(RayCount { occlusion: 1, ..RayCount::default() });
        let prepared = WatertightRay::new(from, direction);
        let mut occluded = false;
        self.traverse(from, direction, 1.0, |index, _| {
            if let Some(hit) = prepared.intersect(&self.corners[index])
                && hit.t < 1.0
                && self.is_solid(index, hit.barycentric)
            {
                occluded = true;
            }
            !occluded
        });
        occluded
    }

    /// Visits leaf slots that the ray may meet; `visit` may lower the far end and stops the walk by `false`.
    fn traverse(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        mut visit: impl FnMut(usize, &mut f32) -> bool,
    ) {
        let ray = Ray::new(origin.into(), direction.into(), 0.0, t_max);
        let leaf = |node: &Bvh2Node, ray: &mut Ray, _: &mut RayHit| {
            let first = node.first_index as usize;
            (first..first + node.prim_count as usize).all(|index| visit(index, &mut ray.tmax))
        };
        let mut no_hit = RayHit::none();
        fast_stack!(u32, (48, 96), self.bvh.max_depth, stack, {
            self.bvh.ray_traverse_dynamic(&mut stack, ray, &mut no_hit, leaf)
        });
    }

    /// Visits every triangle whose bounds meet a box, and maybe others.
    pub fn visit_box(&self, low: Vec3, high: Vec3, mut visit: impl FnMut(&[Vec3; 3])) {
        let within = Aabb::new(low.into(), high.into());
        let mut open: Vec<usize> = (0..self.bvh.nodes.len().min(1)).collect();
        while let Some(node) = open.pop().map(|index| &self.bvh.nodes[index]) {
            if !node.aabb().intersect_aabb(&within) {
                continue;
            }
            let first = node.first_index as usize;
            if node.is_leaf() {
                self.corners[first..first + node.prim_count as usize].iter().for_each(&mut visit);
            } else {
                open.extend([first, first + 1]);
            }
        }
    }

    fn is_solid(&self, index: usize, barycentric: [f32; 2]) -> bool {
        !self.masked[index]
            || self.alpha.as_ref().is_none_or(|alpha| alpha.is_solid(self.triangle[index], barycentric))
    }

    fn is_front(&self, index: usize, direction: Vec3) -> bool {
        let [a, b, c] = self.corners[index];
        (b - a).cross(c - a).dot(direction) < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::{Sequence, uniform_sphere};

    fn soup(count: usize) -> Vec<[Vec3; 3]> {
        let mut sequence = Sequence::new(7);
        let mut point =
            |scale: f32| Vec3::new(sequence.next_f32(), sequence.next_f32(), sequence.next_f32()) * scale;
        (0..count)
            .map(|_| {
                let centre = point(10.0);
                [centre + point(1.0), centre + point(1.0), centre + point(1.0)]
            })
            .collect()
    }

    #[test]
    fn closest_and_occlusion_agree_with_testing_every_triangle() {
        let triangles = soup(2000);
        let tracer = Tracer::new(&triangles, None);
        let mut hits = 0;
        for ray in 0..2000 {
            let origin = Vec3::new(5.0, 4.0, 6.0);
            let direction = uniform_sphere((ray as f32 + 0.5) / 2000.0, (ray as f32 * 0.618_034).fract());
            let prepared = WatertightRay::new(origin, direction);
            let brute = triangles
                .iter()
                .enumerate()
                .filter_map(|(index, corners)| prepared.intersect(corners).map(|hit| (hit.t, index as u32)))
                .min_by(|a, b| a.partial_cmp(b).unwrap());
            let found = tracer.closest(origin, direction, f32::INFINITY).map(|hit| (hit.t, hit.triangle));
            assert_eq!(found, brute, "ray {ray}");
            assert_eq!(
                tracer.is_occluded(origin, origin + direction * 3.0),
                brute.is_some_and(|(t, _)| t < 3.0)
            );
            hits += u32::from(found.is_some());
        }
        assert!(hits > 200, "only {hits} hits: the test shows nothing");
    }

    #[test]
    fn of_two_coincident_triangles_the_first_is_hit() {
        let corners = [Vec3::new(-1.0, -1.0, 1.0), Vec3::new(1.0, -1.0, 1.0), Vec3::new(0.0, 1.0, 1.0)];
        let tracer = Tracer::new(&[corners, corners], None);
        assert_eq!(tracer.closest(Vec3::ZERO, Vec3::Z, f32::INFINITY).unwrap().triangle, 0);
    }

    #[test]
    fn empty_scene_is_all_sky() {
        let tracer = Tracer::new(&[], None);
        assert!(tracer.closest(Vec3::ZERO, Vec3::Z, f32::INFINITY).is_none());
        assert!(!tracer.is_occluded(Vec3::ZERO, Vec3::Z));
    }
}
