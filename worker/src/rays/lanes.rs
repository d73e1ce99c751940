//! Rays through the tree, eight boxes or eight triangles at a time, by whatever vectors the processor has: the same
//! numbers from all of them, as each step is one operation that IEEE 754 rounds, and none is fused with another.
//!
//! Functions are always inlined, and closures that hold vectors avoided: only in a function for AVX2 or AVX-512 do operations on
//! vectors become instructions.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8};
use glam::Vec3;

use super::tree::{Block, Child, Lanes, Node, Tree, WIDTH};
use super::watertight::{TriangleHit, WatertightRay};

/// Far ends of boxes are widened by more than three roundings: the box test must never miss what the triangle test meets.
const WIDEN: f32 = 1.0 + 6e-7;
/// Nodes and blocks that wait without an allocation, in most scenes and in all but a few.
const WAITING: [usize; 2] = [64, 192];

/// Where on a block a ray hits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockHit {
    /// Block.
    pub block: usize,
    /// Triangle of the block.
    pub lane: usize,
    /// Place on the triangle.
    pub hit: TriangleHit,
}

/// A ray ready for boxes and triangles.
pub struct Ray {
    origin: Vec3,
    /// 1 over the direction, finite.
    inverse: Vec3,
    exact: WatertightRay,
}

impl Ray {
    /// Prepares a ray.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        // Of no direction along an axis, all is infinitely far but what the origin lies in: no product is undefined.
        let inverse = |d: f32| if d == 0.0 { f32::MAX } else { (1.0 / d).clamp(f32::MIN, f32::MAX) };
        Self { origin, inverse: direction.map(inverse), exact: WatertightRay::new(origin, direction) }
    }
}

/// A ray, each of its numbers in all lanes.
struct LaneRay<'a, S: Simd> {
    simd: S,
    ray: &'a Ray,
    origin: [f32x8<S>; 3],
    inverse: [f32x8<S>; 3],
    /// Origin and shear along the axes of the watertight test.
    sheared_origin: [f32x8<S>; 3],
    shear: [f32x8<S>; 3],
    /// Which bounds are the nearer ones, along each axis.
    near: [usize; 3],
}

impl<'a, S: Simd> LaneRay<'a, S> {
    #[inline(always)]
    fn new(simd: S, ray: &'a Ray) -> Self {
        let (axis, shear) = (ray.exact.axis(), ray.exact.shear());
        let [x, y, z] = ray.inverse.to_array();
        Self {
            simd,
            ray,
            origin: all_of(simd, ray.origin),
            inverse: all_of(simd, ray.inverse),
            sheared_origin: all_of(
                simd,
                Vec3::new(ray.origin[axis[0]], ray.origin[axis[1]], ray.origin[axis[2]]),
            ),
            shear: all_of(simd, shear),
            near: [usize::from(x < 0.0), usize::from(y < 0.0), usize::from(z < 0.0)],
        }
    }

    /// Distances of a node's boxes, and a bit for each that the ray meets.
    #[inline(always)]
    fn meet_boxes(&self, node: &Node, t_max: f32) -> (Lanes, u64) {
        let mut near = f32x8::splat(self.simd, 0.0);
        let mut far = f32x8::splat(self.simd, t_max);
        for axis in 0..3 {
            let side = self.near[axis] & 1;
            let low = f32x8::load_array_ref(self.simd, &node.bounds[side][axis]);
            let high = f32x8::load_array_ref(self.simd, &node.bounds[1 - side][axis]);
            near = near.max((low - self.origin[axis]) * self.inverse[axis]);
            far = far.min((high - self.origin[axis]) * self.inverse[axis]);
        }
        (near.to_array(), near.simd_le(far * WIDEN).to_bitmask())
    }

    /// A corner of a block's triangles in the ray's sheared axes.
    #[inline(always)]
    fn sheared(&self, corner: &[Lanes; 3]) -> [f32x8<S>; 3] {
        let [kx, ky, kz] = self.ray.exact.axis();
        let z = f32x8::load_array_ref(self.simd, &corner[kz]) - self.sheared_origin[2];
        let x = f32x8::load_array_ref(self.simd, &corner[kx]) - self.sheared_origin[0];
        let y = f32x8::load_array_ref(self.simd, &corner[ky]) - self.sheared_origin[1];
        [x - self.shear[0] * z, y - self.shear[1] * z, z]
    }

    /// Calls `visit` with each triangle of a block that the ray hits up to `t_max`, which it may lower; `None` ends all.
    /// As [`WatertightRay::intersect`], of eight at once.
    #[inline(always)]
    fn meet_triangles(
        &self,
        block: &Block,
        mut t_max: f32,
        mut visit: impl FnMut(usize, TriangleHit, f32) -> Option<f32>,
    ) -> Option<f32> {
        let zero = f32x8::splat(self.simd, 0.0);
        let [ax, ay, az] = self.sheared(&block.corners[0]);
        let [bx, by, bz] = self.sheared(&block.corners[1]);
        let [cx, cy, cz] = self.sheared(&block.corners[2]);
        let (u, v, w) = (cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax);
        // Where the ray passes through an edge, as far as f32 can tell, f64 decides, one triangle after the other.
        let on_edge = (u.simd_eq(zero) | v.simd_eq(zero) | w.simd_eq(zero)).to_bitmask();
        let below = u.simd_lt(zero) | v.simd_lt(zero) | w.simd_lt(zero);
        let above = u.simd_gt(zero) | v.simd_gt(zero) | w.simd_gt(zero);
        let inside = (below ^ above).to_bitmask();
        if inside | on_edge == 0 {
            return Some(t_max);
        }
        let scale = f32x8::splat(self.simd, 1.0) / (u + v + w);
        let t = (u * az + v * bz + w * cz) * self.shear[2] * scale;
        let ahead = (t.simd_ge(zero) & t.simd_le(f32x8::splat(self.simd, t_max))).to_bitmask();
        let (t, v, w) = (t.to_array(), (v * scale).to_array(), (w * scale).to_array());
        let mut left = inside & ahead | on_edge;
        while left != 0 {
            let lane = left.trailing_zeros() as usize % WIDTH;
            left &= left - 1;
            let hit = if on_edge >> lane & 1 == 1 {
                self.ray.exact.intersect(&block.triangle(lane))
            } else {
                Some(TriangleHit { t: t[lane], barycentric: [v[lane], w[lane]] })
            };
            if let Some(hit) = hit {
                t_max = visit(lane, hit, t_max)?;
            }
        }
        Some(t_max)
    }
}

#[inline(always)]
fn all_of<S: Simd>(simd: S, of: Vec3) -> [f32x8<S>; 3] {
    [f32x8::splat(simd, of.x), f32x8::splat(simd, of.y), f32x8::splat(simd, of.z)]
}

/// Visits triangles that a ray hits up to `t_max`, nearer boxes first: every one that is not farther than what `visit` gives as
/// the new far end. `None` ends the walk.
#[inline(always)]
pub fn walk<S: Simd>(
    simd: S,
    tree: &Tree,
    ray: &Ray,
    t_max: f32,
    visit: impl FnMut(BlockHit, f32) -> Option<f32>,
) {
    if tree.nodes.is_empty() {
        return;
    }
    let lanes = LaneRay::new(simd, ray);
    if tree.waiting_max <= WAITING[0] {
        walk_with(&lanes, tree, t_max, &mut [0; WAITING[0]], visit);
    } else if tree.waiting_max <= WAITING[1] {
        walk_with(&lanes, tree, t_max, &mut [0; WAITING[1]], visit);
    } else {
        walk_with(&lanes, tree, t_max, &mut vec![0; tree.waiting_max], visit);
    }
}

#[inline(always)]
fn walk_with<S: Simd>(
    lanes: &LaneRay<S>,
    tree: &Tree,
    mut t_max: f32,
    waiting: &mut [u64],
    mut visit: impl FnMut(BlockHit, f32) -> Option<f32>,
) {
    let (mut count, mut current) = (0, Child::Node(0));
    loop {
        let nearest = match current {
            Child::Node(index) => {
                let node = &tree.nodes[index];
                let (near, met) = lanes.meet_boxes(node, t_max);
                push_all(node, &near, met, waiting, &mut count)
            }
            Child::Block(block) => {
                let visit =
                    |lane: usize, hit: TriangleHit, t_max: f32| visit(BlockHit { block, lane, hit }, t_max);
                let Some(end) = lanes.meet_triangles(&tree.blocks[block], t_max, visit) else { return };
                t_max = end;
                None
            }
        };
        let next = nearest.or_else(|| {
            while count > 0 {
                count -= 1;
                if near_of(waiting[count]) <= t_max {
                    return Some(waiting[count]);
                }
            }
            None
        });
        let Some(next) = next else { return };
        current = Child::of(next as u32);
    }
}

/// Lets the boxes that are met wait, farther ones deeper; gives the nearest instead.
#[inline(always)]
fn push_all(node: &Node, near: &Lanes, mut met: u64, waiting: &mut [u64], count: &mut usize) -> Option<u64> {
    if met == 0 {
        return None;
    }
    let base = *count;
    let mut nearest = entry(node, near, met);
    met &= met - 1;
    while met != 0 {
        let other = entry(node, near, met);
        met &= met - 1;
        let farther = nearest.max(other);
        nearest = nearest.min(other);
        let mut place = *count;
        while place > base && waiting[place - 1] < farther {
            waiting[place] = waiting[place - 1];
            place -= 1;
        }
        waiting[place] = farther;
        *count += 1;
    }
    Some(nearest)
}

/// Distance and child of the first box of a set, in one number that sorts by the distance, which is not negative.
#[inline(always)]
fn entry(node: &Node, near: &Lanes, met: u64) -> u64 {
    let lane = met.trailing_zeros() as usize % WIDTH;
    u64::from(near[lane].to_bits()) << 32 | u64::from(node.children[lane])
}

/// Distance of a box that waits.
#[inline(always)]
fn near_of(entry: u64) -> f32 {
    f32::from_bits((entry >> 32) as u32)
}
