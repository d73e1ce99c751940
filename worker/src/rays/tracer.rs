//! The tracer: a tree over world triangles with closest-hit and occlusion queries.

use std::time::Duration;

use fearless_simd::{Simd, dispatch};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::{Boundable, BvhBuildParams};

use super::count::{RayCount, note};
use super::lanes::{BlockHit, Ray, walk};
use super::sampling::{Sequence, seed_of};
use super::tree::{Tree, WIDTH};
use super::vectors::Vectors;

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

/// Tells how much light a triangle stops at a point (alpha-masked texels, glass).
pub trait AlphaTest: Send + Sync {
    /// The triangle has points that let light through.
    fn is_masked(&self, triangle: u32) -> bool;
    /// Share of light stopped at the barycentric weights (of corners 1 and 2).
    fn stopped(&self, triangle: u32, barycentric: [f32; 2]) -> f32;
    /// Number that names a triangle which stops a part of the light, whatever else the scene holds.
    fn identity(&self, triangle: u32) -> u64;
}

/// Bits of the farthest coordinate that lifts keep: an edit of the scene seldom changes them then.
const REACH_BITS: u32 = 3;

/// Share of light stopped from which on a surface is a wall, where the answer is yes or no.
const WALL: f32 = 0.5;

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
        let ray_offset_m = rounded_up(reach) * LIFT;
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

    /// The numbers that lifts about all points are made of, in metres.
    pub fn lift_of_all_m(&self) -> [f32; 5] {
        let (middle_m, half_m) = self.core.unwrap_or_default();
        let [x, y, z] = middle_m.to_array();
        [self.ray_offset_m, x, y, z, half_m]
    }

    /// Lift of ray origins off surfaces about a point, in metres; grows with the coordinates there.
    pub fn ray_offset_m(&self, about_m: Vec3) -> f32 {
        let Some((middle_m, half_m)) = self.core else { return self.ray_offset_m };
        let away_m = (about_m - middle_m).abs().max_element();
        let reach_m = middle_m.abs().max_element() + (2.0 * away_m).max(half_m);
        (reach_m * LIFT).min(self.ray_offset_m)
    }

    /// The nearest hit with `t` in 0..`t_max`; of equally near triangles, the one with the smallest index. Walls are hit,
    /// which stop half of the light at least: the question is of shape. [`Tracer::met`] asks for light.
    pub fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        self.nearest(origin, direction, t_max, &|at: &BlockHit| self.is_wall(at))
    }

    /// As [`Tracer::closest`], of light: a surface that stops the share s is hit with probability s, by a number that ray
    /// and triangle alone decide. The mean over rays is then that of light, of which 1 − s passes.
    pub fn met(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        self.nearest(origin, direction, t_max, &|at: &BlockHit| {
            let stopped = self.stopped(at);
            let chance = || chance(origin, direction, self.identity(self.triangle(at)));
            stopped >= 1.0 || (stopped > 0.0 && chance() < stopped)
        })
    }

    /// As [`Tracer::closest`], of surfaces that stop any light, glass however clear.
    pub fn closest_surface(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        self.nearest(origin, direction, t_max, &|at: &BlockHit| self.stopped(at) > 0.0)
    }

    fn nearest(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        stops: &impl Fn(&BlockHit) -> bool,
    ) -> Option<Hit> {
        note(RayCount { closest: 1, ..RayCount::default() });
        let ray = Ray::new(origin, direction);
        let found = dispatch!(self.vectors.0, simd => self.nearest_on(simd, &ray, t_max, stops));
        found.map(|(triangle, BlockHit { block, lane, hit })| {
            let [a, b, c] = self.tree.blocks[block].triangle(lane);
            let front = (b - a).cross(c - a).dot(direction) < 0.0;
            Hit { t: hit.t, triangle, barycentric: hit.barycentric, front }
        })
    }

    #[inline(always)]
    fn nearest_on<S: Simd>(
        &self,
        simd: S,
        ray: &Ray,
        t_max: f32,
        stops: &impl Fn(&BlockHit) -> bool,
    ) -> Option<(u32, BlockHit)> {
        let mut best: Option<(u32, BlockHit)> = None;
        let mut t_best = t_max;
        walk(simd, &self.tree, ray, t_max, |at, end| {
            let triangle = self.triangle(&at);
            let t = at.hit.t;
            let nearer = t < t_best || (t == t_best && best.is_some_and(|(before, _)| triangle < before));
            if !nearer || !stops(&at) {
                return Some(end);
            }
            (t_best, best) = (t, Some((triangle, at)));
            // A little further than the hit, so that a tie in a later node is still visited.
            Some(t * (1.0 + 4e-6) + 1e-20)
        });
        best
    }

    /// Some surfaces let light through.
    pub fn has_glass(&self) -> bool {
        self.alpha.is_some()
    }

    /// A wall lies on the open segment between two points: a surface that stops half of the light at least.
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
            occluded = at.hit.t < 1.0 && self.is_wall(&at);
            (!occluded).then_some(end)
        });
        occluded
    }

    /// Share of light that passes along the open segment between two points: ∏ (1 − s) over the surfaces on it.
    pub fn passed(&self, from: Vec3, to: Vec3) -> f32 {
        let direction = to - from;
        if direction.length_squared() == 0.0 {
            return 1.0;
        }
        note(RayCount { occlusion: 1, ..RayCount::default() });
        let ray = Ray::new(from, direction);
        dispatch!(self.vectors.0, simd => self.passed_on(simd, &ray))
    }

    #[inline(always)]
    fn passed_on<S: Simd>(&self, simd: S, ray: &Ray) -> f32 {
        let (mut panes, mut is_stopped) = (Vec::new(), false);
        walk(simd, &self.tree, ray, 1.0, |at, end| {
            if at.hit.t < 1.0 {
                let stopped = self.stopped(&at);
                is_stopped = stopped >= 1.0;
                if stopped > 0.0 {
                    panes.push((at.hit.t, self.triangle(&at), 1.0 - stopped));
                }
            }
            (!is_stopped).then_some(end)
        });
        if is_stopped {
            return 0.0;
        }
        // In the order along the way: that of the tree hangs on all of the scene.
        panes.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        panes.into_iter().map(|(_, _, passed)| passed).product()
    }

    /// Visits every triangle whose bounds meet a box, and maybe others, until `visit` says no.
    pub fn visit_box(&self, low: Vec3, high: Vec3, visit: impl FnMut(&[Vec3; 3]) -> bool) {
        self.tree.visit_box(low, high, visit);
    }

    /// Whether a triangle is a wall at the barycentric weights (of corners 1 and 2).
    pub fn is_wall_at(&self, triangle: u32, barycentric: [f32; 2]) -> bool {
        let masks = self.alpha.as_ref().filter(|alpha| alpha.is_masked(triangle));
        masks.is_none_or(|alpha| alpha.stopped(triangle, barycentric) >= WALL)
    }

    fn triangle(&self, at: &BlockHit) -> u32 {
        self.tree.triangles[at.block][at.lane]
    }

    fn identity(&self, triangle: u32) -> u64 {
        self.alpha.as_ref().map_or_else(|| triangle.into(), |alpha| alpha.identity(triangle))
    }

    fn is_wall(&self, at: &BlockHit) -> bool {
        self.stopped(at) >= WALL
    }

    fn stopped(&self, at: &BlockHit) -> f32 {
        match &self.alpha {
            Some(alpha) if self.masked[at.block] >> at.lane & 1 != 0 => {
                alpha.stopped(self.triangle(at), at.hit.barycentric)
            }
            _ => 1.0,
        }
    }
}

/// The least number of few bits that is no less.
fn rounded_up(value: f32) -> f32 {
    let rest = (1 << (f32::MANTISSA_DIGITS - 1 - REACH_BITS)) - 1;
    f32::from_bits((value.to_bits() + rest) & !rest)
}

/// Uniform in 0..1, of a ray and the identity of a triangle.
fn chance(origin: Vec3, direction: Vec3, identity: u64) -> f32 {
    let [x, y, z] = origin.to_array().map(|value| u64::from(value.to_bits()));
    let [u, v, w] = direction.to_array().map(|value| u64::from(value.to_bits()));
    Sequence::new(seed_of(&[x | y << 32, z | u << 32, v | w << 32, identity])).next_f32()
}

#[cfg(test)]
mod tests {
    use super::super::watertight::WatertightRay;
    use super::*;
    use crate::rays::sampling::uniform_sphere;

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

    /// Every triangle stops this share.
    struct Pane(f32);

    impl AlphaTest for Pane {
        fn is_masked(&self, _: u32) -> bool {
            true
        }

        fn stopped(&self, _: u32, _: [f32; 2]) -> f32 {
            self.0
        }

        fn identity(&self, triangle: u32) -> u64 {
            triangle.into()
        }
    }

    fn panes(stopped: f32, count: u32) -> Tracer {
        let pane = |index: u32| {
            let z = 1.0 + index as f32;
            [Vec3::new(-9.0, -9.0, z), Vec3::new(9.0, -9.0, z), Vec3::new(0.0, 9.0, z)]
        };
        Tracer::new(&(0..count).map(pane).collect::<Vec<_>>(), Some(Box::new(Pane(stopped))))
    }

    #[test]
    fn panes_in_a_row_are_each_met_by_their_share_of_the_rays_that_come_to_them() {
        let (tracer, rays) = (panes(0.25, 3), 40_000);
        let mut met = [0_u32; 4];
        for ray in 0..rays {
            let aside = Vec3::new(ray as f32 * 1e-6, (ray % 200) as f32 * 1e-4, 0.0);
            let hit = tracer.met(aside, Vec3::Z, f32::INFINITY);
            assert_eq!(hit, tracer.met(aside, Vec3::Z, f32::INFINITY), "the same ray twice");
            met[hit.map_or(3, |hit| hit.triangle as usize)] += 1;
        }
        for (count, wanted) in met.into_iter().zip([0.25, 0.1875, 0.140_625, 0.421_875]) {
            let share = f64::from(count) / f64::from(rays);
            assert!((share - wanted).abs() < 0.012, "{met:?}");
        }
    }

    #[test]
    fn light_that_passes_panes_is_the_product_and_walls_are_panes_that_stop_half() {
        let (from, to) = (Vec3::ZERO, Vec3::Z * 10.0);
        for (stopped, passed) in [(0.0, 1.0), (0.25, 0.421_875), (0.75, 0.015_625), (1.0, 0.0)] {
            let tracer = panes(stopped, 3);
            assert_eq!(tracer.passed(from, to), passed);
            assert_eq!(tracer.is_occluded(from, to), stopped >= 0.5);
            assert_eq!(tracer.closest(from, Vec3::Z, 20.0).is_some(), stopped >= 0.5);
            assert_eq!(tracer.closest_surface(from, Vec3::Z, 20.0).is_some(), stopped > 0.0);
        }
        assert_eq!(panes(1.0, 0).passed(from, to), 1.0);
    }

    #[test]
    fn lift_is_the_same_for_scenes_of_nearly_the_same_reach() {
        let lift = |reach: f32| {
            Tracer::new(&[[Vec3::ZERO, Vec3::X * reach, Vec3::Y * reach]], None).ray_offset_m(Vec3::ZERO)
        };
        assert_eq!(lift(8.1), lift(8.9));
        assert_eq!(lift(8.0), 8.0 * LIFT);
        for reach in [1.0e-9, 0.3, 3.7, 100.0, 12_345.6] {
            assert!((reach * LIFT..=1.13 * reach * LIFT).contains(&lift(reach)), "{reach}");
        }
    }

    #[test]
    fn empty_scene_is_all_sky() {
        let tracer = Tracer::new(&[], None);
        assert!(tracer.closest(Vec3::ZERO, Vec3::Z, f32::INFINITY).is_none());
        assert!(!tracer.is_occluded(Vec3::ZERO, Vec3::Z));
    }
}
