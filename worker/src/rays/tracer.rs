//! The tracer: a tree over world triangles with closest-hit and occlusion queries.

use std::time::Duration;

use fearless_simd::{Simd, dispatch};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::{Boundable, BvhBuildParams};

use super::count::{RayCount, note};
use super::lanes::{BlockHit, Ray, walk};
use super::tree::{Tree, WIDTH};
use super::vectors::Vectors;
use super::watertight::TriangleHit;

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
    tree: Tree,
    /// Of each block of the tree a bit for each masked triangle.
    masked: Vec<u8>,
    alpha: Option<Box<dyn AlphaTest>>,
    ray_offset_m: f32,
    vectors: Vectors,
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
        let tree = if bounded.is_empty() {
            Tree::default()
        } else {
            let mut build_time = Duration::ZERO;
            Tree::new(&build_bvh2(&bounded, BvhBuildParams::medium_build(), &mut build_time), triangles)
        };
        let is_masked = |triangle: u32| {
            triangle != u32::MAX && alpha.as_ref().is_some_and(|alpha| alpha.is_masked(triangle))
        };
        let bits = |block: &[u32; WIDTH]| {
            (0..WIDTH).fold(0, |bits, lane| bits | u8::from(is_masked(block[lane])) << lane)
        };
        let masked = tree.triangles.iter().map(bits).collect();
        // No least reach in metres: a scene in micrometres is the same scene.
        let reach =
            triangles.iter().flatten().fold(0.0_f32, |reach, corner| reach.max(corner.abs().max_element()));
        let ray_offset_m = reach * LIFT;
        Self { tree, masked, alpha, ray_offset_m, vectors: Vectors::default(), core: None }
    }

    /// The tracer of a scene with a core: about a point, no surface has coordinates much larger than the point is away from
    /// the `middle_m` of the core, or the core is wide.
    #[must_use]
    pub fn about(mut self, middle_m: Vec3, half_m: f32) -> Self {
        self.core = Some((middle_m, half_m));
        self
    }

    /// The tracer with other vectors than the widest: the same hits, at another speed.
    #[must_use]
    pub fn with_vectors(mut self, vectors: Vectors) -> Self {
        self.vectors = vectors;
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
        let ray = Ray::new(origin, direction);
        let found = dispatch!(self.vectors.0, simd => self.closest_on(simd, &ray, t_max));
        found.map(|(triangle, BlockHit { block, lane, hit })| {
            let [a, b, c] = self.tree.blocks[block].triangle(lane);
            let front = (b - a).cross(c - a).dot(direction) < 0.0;
            Hit { t: hit.t, triangle, barycentric: hit.barycentric, front }
        })
    }

    #[inline(always)]
    fn closest_on<S: Simd>(&self, simd: S, ray: &Ray, t_max: f32) -> Option<(u32, BlockHit)> {
        let mut best: Option<(u32, BlockHit)> = None;
        let mut t_best = t_max;
        walk(simd, &self.tree, ray, t_max, |at, end| {
            let triangle = self.tree.triangles[at.block][at.lane];
            let t = at.hit.t;
            let nearer = t < t_best || (t == t_best && best.is_some_and(|(before, _)| triangle < before));
            if !nearer || !self.is_solid(&at) {
                return Some(end);
            }
            (t_best, best) = (t, Some((triangle, at)));
            // A little further than the hit, so that a tie in a later node is still visited.
            Some(t * (1.0 + 4e-6) + 1e-20)
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
        let ray = Ray::new(from, direction);
        dispatch!(self.vectors.0, simd => self.is_occluded_on(simd, &ray))
    }

    #[inline(always)]
    fn is_occluded_on<S: Simd>(&self, simd: S, ray: &Ray) -> bool {
        let mut occluded = false;
        walk(simd, &self.tree, ray, 1.0, |at, end| {
            occluded = at.hit.t < 1.0 && self.is_solid(&at);
            (!occluded).then_some(end)
        });
        occluded
    }

    /// Visits every triangle whose bounds meet a box, and maybe others.
    pub fn visit_box(&self, low: Vec3, high: Vec3, visit: impl FnMut(&[Vec3; 3])) {
        self.tree.visit_box(low, high, visit);
    }

    fn is_solid(&self, at: &BlockHit) -> bool {
        let BlockHit { block, lane, hit: TriangleHit { barycentric, .. } } = *at;
        self.masked[block] >> lane & 1 == 0
            || self
                .alpha
                .as_ref()
                .is_none_or(|alpha| alpha.is_solid(self.tree.triangles[block][lane], barycentric))
    }
}

#[cfg(test)]
mod tests {
    use super::super::watertight::WatertightRay;
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
    fn rays_along_axes_edges_and_planes_hit_the_same_by_all_vectors_as_by_testing_every_triangle() {
        // Walls of squares on a lattice, so that rays from its points run along edges, through corners and in planes.
        let mut triangles = Vec::new();
        let at = |x: i32, y: i32, z: i32| Vec3::new(x as f32 * 0.37, y as f32 * 0.53, z as f32 * 0.71);
        for (x, y) in (0..36).map(|i| (i % 6 - 3, i / 6 - 3)) {
            for z in [-3, 3] {
                triangles.push([at(x, y, z), at(x + 1, y, z), at(x + 1, y + 1, z)]);
                triangles.push([at(y + 1, z, x + 1), at(y, z, x), at(y + 1, z, x)]);
                triangles.push([at(z, x, y), at(z, x, y + 1), at(z, x + 1, y + 1)]);
            }
        }
        let with = |vectors: Vectors| Tracer::new(&triangles, None).with_vectors(vectors);
        let tracers: Vec<Tracer> = Vectors::all().into_iter().map(with).collect();
        let own = Tracer::new(&triangles, None);
        let mut sequence = Sequence::new(3);
        let mut lattice = || [(); 3].map(|()| (sequence.next_u64() % 7) as i32 - 3);
        let mut hits = 0;
        for ray in 0..20_000 {
            let [[x, y, z], [to_x, to_y, to_z]] = [lattice(), lattice()];
            let origin = at(x, y, z) * 0.9;
            // Half of them along an axis or a lattice's diagonal, half at corners and the middles of edges.
            let target = at(to_x, to_y, to_z).lerp(at(to_x, to_y + 1, to_z), 0.5 * (to_x % 2).abs() as f32);
            let direction = if ray % 2 == 0 { at(to_x, to_y, to_z) } else { target - origin };
            if direction == Vec3::ZERO {
                continue;
            }
            let prepared = WatertightRay::new(origin, direction);
            let each = triangles.iter().zip(0..).filter_map(|(corners, index)| {
                prepared.intersect(corners).map(|hit| (hit.t, index, hit.barycentric))
            });
            let brute = each.min_by(|a, b| (a.0, a.1).partial_cmp(&(b.0, b.1)).unwrap());
            let found = own.closest(origin, direction, f32::INFINITY);
            assert_eq!(
                found.map(|hit| (hit.t, hit.triangle, hit.barycentric)),
                brute,
                "{origin} {direction}"
            );
            let occluded = own.is_occluded(origin, origin + direction);
            for other in &tracers {
                assert_eq!(other.closest(origin, direction, f32::INFINITY), found, "{:?}", other.vectors);
                assert_eq!(other.is_occluded(origin, origin + direction), occluded, "{:?}", other.vectors);
            }
            hits += u32::from(found.is_some());
        }
        assert!(hits > 5000, "only {hits} hits: the test shows nothing");
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
