//! Touches: what of a triangle's sides lies in a voxel, over all levels at once.

use std::collections::BTreeMap;

use glam::{DVec3, IVec3, Vec3};
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::voxels::{SUBS, sub_in_voxel};

use super::overlap::{Clipped, Shape};

/// Middles that count where a triangle only touches a cube, as a share of the area of the cube's side.
const AREA_MIN: f64 = 1e-9;

/// A triangle that stops walks.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Its number through the scene.
    pub index: u32,
    /// Corners in metres.
    pub corners: [Vec3; 3],
    /// Both sides have light.
    pub is_double_sided: bool,
    /// Its glow, see `Element::glow`.
    pub glow: u16,
    /// Least level that it is seen at: coarse texels have none finer.
    pub lowest_level: u32,
}

/// Properties of points of a scene's triangles.
pub trait Sides {
    /// The patch of a side at a point, of a level up to `level` if there is one; `None` where it is dark.
    fn patch(&self, at: At, is_front: bool, level: u32) -> Option<PatchKey>;

    /// Whether a triangle stops light at a point.
    fn stops(&self, at: At) -> bool;
}

/// A point of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct At {
    /// The triangle's number through the scene.
    pub triangle: u32,
    /// Weights of corners 1 and 2.
    pub barycentric: [f32; 2],
    /// The point in metres.
    pub point_m: Vec3,
}

/// Levels and cubes of a lattice that touches are wanted of.
#[derive(Clone, Copy, Debug)]
pub struct Scope {
    /// Side h₀ of voxels of level 0 in metres.
    pub voxel_m: f64,
    /// First level.
    pub first: u32,
    /// Last level.
    pub last: u32,
    /// Cube that all of it lies in: doublings of the sub-voxels of level 0.
    pub root_doublings: u32,
    /// The cube's cell.
    pub root: IVec3,
}

/// Where a touch is counted: triangles of one voxel, patch and side make elements together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Level, and the voxel z, y, x.
    pub level: u32,
    pub zyx: [i32; 3],
    /// Key of the patch; of none the greatest number.
    pub patch: u64,
    pub glow: u16,
    pub is_backed: bool,
    pub is_finest: bool,
}

/// The part in a voxel of one side of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Touch {
    /// Unit normal of the side.
    pub normal: DVec3,
    /// Area, a little more than nothing where the triangle only touches.
    pub area_m2: f64,
    /// Area times its middle.
    pub moment: DVec3,
    /// Sub-voxels.
    pub bits: u64,
}

impl Scope {
    /// Side of the sub-voxels of level 0, `h₀/4`, twice as long for each doubling.
    fn cube_m(&self, doublings: u32) -> f64 {
        self.voxel_m / f64::from(SUBS) * 2.0_f64.powi(doublings as i32)
    }

    /// Corners of its cube in metres.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        let side_m = self.cube_m(self.root_doublings);
        [self.root, self.root + 1].map(|cell| (cell.as_dvec3() * side_m).as_vec3())
    }

    /// Voxels of all its levels that the larger sides of a triangle's bounds in it span: about as many as the triangle touches at most.
    pub fn spanned(&self, triangle: &Triangle) -> f64 {
        let [low_m, high_m] = self.bounds_m();
        let [a, b, c] = triangle.corners.map(|corner| corner.clamp(low_m, high_m));
        let mut sides_m = (a.max(b).max(c) - a.min(b).min(c)).as_dvec3().to_array();
        sides_m.sort_unstable_by(|a, b| b.total_cmp(a));
        let first = self.first.max(triangle.lowest_level);
        let of_level = |level: u32| {
            let side_m = self.voxel_m * 2.0_f64.powi(level as i32);
            (sides_m[0] / side_m + 1.0) * (sides_m[1] / side_m + 1.0)
        };
        (first..=self.last).map(of_level).sum()
    }

    /// The touches of a triangle, ascending by place.
    pub fn touches(&self, triangle: &Triangle, sides: &impl Sides) -> Vec<(Place, Touch)> {
        let mut found = BTreeMap::new();
        if let Some(shape) = Shape::new(triangle.corners) {
            self.enter(triangle, &shape, sides, (self.root_doublings, self.root), &mut found);
        }
        found.into_iter().collect()
    }

    /// Counts a cube and those in it.
    fn enter(
        &self,
        triangle: &Triangle,
        shape: &Shape,
        sides: &impl Sides,
        (doublings, cell): (u32, IVec3),
        found: &mut BTreeMap<Place, Touch>,
    ) {
        if !shape.touches(cell, self.cube_m(doublings)) {
            return;
        }
        // A sub-voxel of level ℓ is a cube of ℓ doublings.
        let first = self.first.max(triangle.lowest_level);
        if (first..=self.last).contains(&doublings) {
            self.count(triangle, shape, sides, (doublings, cell), found);
        }
        if doublings > first {
            for part in 0..8 {
                let offset = IVec3::new(part & 1, part >> 1 & 1, part >> 2);
                self.enter(triangle, shape, sides, (doublings - 1, 2 * cell + offset), found);
            }
        }
    }

    /// Counts a sub-voxel.
    fn count(
        &self,
        triangle: &Triangle,
        shape: &Shape,
        sides: &impl Sides,
        (level, cell): (u32, IVec3),
        found: &mut BTreeMap<Place, Touch>,
    ) {
        let side_m = self.cube_m(level);
        let Clipped { area_m2, middle_m } = shape.clipped(cell, side_m);
        let barycentric = shape.weights(middle_m).map(|weight| weight as f32);
        let at = At { triangle: triangle.index, barycentric, point_m: middle_m.as_vec3() };
        if !sides.stops(at) {
            return;
        }
        let area_m2 = area_m2.max(AREA_MIN * side_m * side_m);
        let bits = 1 << sub_in_voxel(cell);
        let [x, y, z] = cell.map(|at| at.div_euclid(SUBS)).to_array();
        let is_finest = triangle.lowest_level > 0 && level == triangle.lowest_level;
        let mut add = |patch: Option<PatchKey>, is_front: bool, is_backed: bool| {
            let (patch, glow) = (patch.map_or(u64::MAX, |key| key.0), triangle.glow);
            let place = Place { level, zyx: [z, y, x], patch, glow, is_backed, is_finest };
            let normal = if is_front { shape.normal() } else { -shape.normal() };
            let none = Touch { normal, area_m2: 0.0, moment: DVec3::ZERO, bits: 0 };
            let touch = found.entry(place).or_insert(none);
            touch.area_m2 += area_m2;
            touch.moment += area_m2 * middle_m;
            touch.bits |= bits;
        };
        let front = sides.patch(at, true, level);
        let back = triangle.is_double_sided.then(|| sides.patch(at, false, level)).flatten();
        match (front, back) {
            (Some(_), Some(_)) => {
                add(front, true, false);
                add(back, false, false);
            }
            (None, Some(_)) => add(back, false, true),
            (front, None) => add(front, true, true),
        }
    }
}
