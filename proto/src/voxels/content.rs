//! Elements: what lies of a surface in a voxel, decoded.

use glam::{DVec3, IVec3, Vec3};

use crate::content::PatchKey;

/// Sub-voxels along a side of a voxel: the resolution of an element's bits.
pub const SUBS: i32 = 4;
/// Voxels along a side of a brick.
pub const BRICK_VOXELS: i32 = 8;
/// Levels whose bricks are in regions; those above are in the top.
pub const REGION_LEVELS: u32 = 2;
/// Voxels of level 0 along a side of a region: one brick of its coarsest level.
pub const REGION_VOXELS: i32 = BRICK_VOXELS << (REGION_LEVELS - 1);
/// Levels at most: as many as the tree of patches has.
pub const LEVELS_MAX: u32 = 14;
/// Farthest brick of level 0 from the world's origin along an axis.
pub const BRICKS_MAX: i32 = 1 << 20;
/// Step of planes, in sides of a voxel: a plane within the voxel is at most √3/2 from its middle.
const PLANE_STEP: f32 = 1.0 / 32_767.0;
/// Steps of octahedral coordinates to either side.
const NORMAL_STEPS: f32 = 32_767.0;

/// Place of a brick: level, and cell on the lattice of its side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BrickKey {
    /// Level ℓ: voxels of h₀·2^ℓ.
    pub level: u32,
    /// Cell z, y, x, in this order so that keys ascend by it.
    zyx: [i32; 3],
}

impl BrickKey {
    /// Of a cell x, y, z on the lattice of the level's bricks.
    pub fn new(level: u32, cell: IVec3) -> Self {
        Self { level, zyx: [cell.z, cell.y, cell.x] }
    }

    /// Of the brick of a voxel of that level.
    pub fn of_voxel(level: u32, voxel: IVec3) -> Self {
        Self::new(level, voxel.map(|at| at.div_euclid(BRICK_VOXELS)))
    }

    /// Cell x, y, z.
    pub fn cell(self) -> IVec3 {
        let [z, y, x] = self.zyx;
        IVec3::new(x, y, z)
    }

    /// Least voxel of it, on the lattice of its level.
    pub fn first_voxel(self) -> IVec3 {
        self.cell() * BRICK_VOXELS
    }
}

/// Number of a voxel in its brick: x + 8 y + 64 z.
pub fn place_in_brick(voxel: IVec3) -> u16 {
    let [x, y, z] = voxel.to_array().map(|at| at.rem_euclid(BRICK_VOXELS) as u16);
    x + 8 * y + 64 * z
}

/// Place of a number in its brick.
pub fn voxel_in_brick(place: u16) -> IVec3 {
    let place = i32::from(place);
    IVec3::new(place & 7, place >> 3 & 7, place >> 6)
}

/// Number of a sub-voxel in its voxel, and of its bit: x + 4 y + 16 z.
pub fn sub_in_voxel(sub: IVec3) -> u32 {
    let [x, y, z] = sub.to_array().map(|at| at.rem_euclid(SUBS) as u32);
    x + 4 * y + 16 * z
}

/// Unit normal in 2 × 16 bits, octahedral.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct NormalCode(pub [i16; 2]);

impl NormalCode {
    /// The nearest code.
    pub fn of(normal: DVec3) -> Self {
        let n = normal / normal.abs().element_sum();
        let flip = |a: f64, b: f64| (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 };
        let [x, y] = if n.z < 0.0 { [flip(n.x, n.y), flip(n.y, n.x)] } else { [n.x, n.y] };
        Self([x, y].map(|at| libm::round(at * f64::from(NORMAL_STEPS)) as i16))
    }

    /// The unit normal.
    pub fn normal(self) -> Vec3 {
        let [x, y] = self.0.map(|at| f32::from(at) / NORMAL_STEPS);
        let z = 1.0 - x.abs() - y.abs();
        let fold = (-z).max(0.0);
        let toward = |at: f32| if at < 0.0 { at + fold } else { at - fold };
        Vec3::new(toward(x), toward(y), z).normalize_or(Vec3::Z)
    }
}

/// The part in a voxel of one side of a patch, or of a surface without a receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Element {
    /// Mean normal n_e.
    pub normal: NormalCode,
    /// `n_e·(x − m)` of its plane in steps of h/32767, m the middle of the voxel.
    pub plane: i16,
    /// Sub-voxels that it touches, see [`sub_in_voxel`].
    pub bits: u64,
    /// The patch whose radiance it has; `None`: it is dark, as it has no receiver.
    pub patch: Option<PatchKey>,
    /// Its glow: a place in [`VoxelPart::glows`] and 1, or 0.
    pub glow: u16,
    /// The other side of the same surface is dark: the back of a single-sided one, or of one that is dark on both.
    pub is_backed: bool,
    /// Its surface has no elements at the level below, as it has coarse texels.
    pub is_finest: bool,
}

impl Element {
    /// Code of `n_e·(x − m)` in metres, for voxels of side `voxel_m`.
    pub fn plane_code(height_m: f64, voxel_m: f64) -> i16 {
        libm::round((height_m / voxel_m).clamp(-1.0, 1.0) / f64::from(PLANE_STEP)) as i16
    }

    /// `n_e·(x − m)` in metres.
    pub fn height_m(&self, voxel_m: f32) -> f32 {
        f32::from(self.plane) * PLANE_STEP * voxel_m
    }
}

/// Emission of elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glow {
    /// Emitter.
    pub emitter: u16,
    /// Share of the emitter's radiance, by its texture.
    pub share: [f32; 3],
}

/// Elements of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Voxel {
    /// Its number in the brick, see [`place_in_brick`].
    pub place: u16,
    /// How many elements it has, 1 or more.
    pub elements: u16,
}

/// Some of the 8³ voxels of a brick: those with elements.
#[derive(Clone, Debug, PartialEq)]
pub struct Brick {
    /// Place.
    pub key: BrickKey,
    /// Voxels that hold something, ascending.
    pub voxels: Vec<Voxel>,
    /// Their elements, voxel by voxel.
    pub elements: Vec<Element>,
}

/// Elements of a region, or of the top: one chunk.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelPart {
    /// Side h₀ of voxels of level 0 in metres.
    pub voxel_m: f32,
    /// Emission of elements.
    pub glows: Vec<Glow>,
    /// Bricks, levels from the coarsest, then ascending by key.
    pub bricks: Vec<Brick>,
}

impl VoxelPart {
    /// How many elements there are.
    pub fn elements(&self) -> usize {
        self.bricks.iter().map(|brick| brick.elements.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_in_bricks_and_voxels_hold_on_both_sides_of_the_origin() {
        for voxel in [IVec3::new(-1, 0, 7), IVec3::new(8, -9, 3), IVec3::splat(-8)] {
            let key = BrickKey::of_voxel(2, voxel);
            assert_eq!(key.first_voxel() + voxel_in_brick(place_in_brick(voxel)), voxel);
        }
        assert_eq!(sub_in_voxel(IVec3::new(-1, -4, 6)), 3 + 32);
        assert!(BrickKey::new(0, IVec3::new(9, 0, 0)) < BrickKey::new(0, IVec3::new(0, 1, 0)));
    }

    #[test]
    fn normals_come_back_within_their_step() {
        let mut worst: f32 = 0.0;
        for index in 0..4096 {
            let normal = crate::harmonics::relight_direction(index, 4096);
            worst = worst.max(NormalCode::of(normal.as_dvec3()).normal().distance(normal));
        }
        assert!(worst < 1e-4, "{worst}");
        for axis in [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z] {
            assert_eq!(NormalCode::of(axis.as_dvec3()).normal(), axis);
        }
    }

    #[test]
    fn planes_come_back_within_a_ten_thousandth_of_a_voxel() {
        for height in [-0.86, -0.3, 0.0, 1e-3, 0.5] {
            let plane = Element::plane_code(height * 0.25, 0.25);
            let element = Element {
                normal: NormalCode([0, 0]),
                plane,
                bits: 1,
                patch: None,
                glow: 0,
                is_backed: true,
                is_finest: true,
            };
            assert!((f64::from(element.height_m(0.25)) - height * 0.25).abs() < 1e-4 * 0.25);
        }
    }
}
