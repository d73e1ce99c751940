//! Elements: triangles of a voxel that have one patch, face the same way and lie in one plane.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use glam::{DVec3, IVec3};
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::voxels::{Brick, BrickKey, Element, NormalCode, Voxel, place_in_brick, voxel_in_brick};

use super::touches::{Place, Touch};

/// A triangle joins an element whose first triangle's normal is this near to its own: cosine of 25°.
const JOIN_COSINE: f64 = 0.906_307_787_036_65;
/// And whose plane its middle is this near to, in sides of the voxel.
const JOIN_HEIGHT: f64 = 0.125;

/// Triangles of one voxel, patch and side that are one element.
struct Joined {
    place: Place,
    /// Of the first triangle.
    normal: DVec3,
    middle_m: DVec3,
    /// Sum of normals by area.
    normals: DVec3,
    area_m2: f64,
    moment: DVec3,
    bits: u64,
}

/// Voxels in the order of chunks: levels from the coarsest, bricks by key, voxels by number.
type Slot = (Reverse<u32>, BrickKey, u16);

/// Most elements of a voxel: what lies beyond joins the last.
const ELEMENTS_MAX: usize = 1 << 12;

/// Elements while they grow; touches come triangle by triangle in the order of the scene.
pub struct Elements {
    voxel_m: f64,
    voxels: BTreeMap<Slot, Vec<Joined>>,
}

impl Elements {
    /// None yet, in voxels of level 0 of such a side.
    pub fn new(voxel_m: f64) -> Self {
        Self { voxel_m, voxels: BTreeMap::new() }
    }

    fn side_m(&self, level: u32) -> f64 {
        self.voxel_m * f64::from(1_u32 << level)
    }

    /// Adds what lies of a triangle in a voxel.
    pub fn add(&mut self, place: Place, touch: &Touch) {
        let side_m = self.side_m(place.level);
        let [z, y, x] = place.zyx;
        let voxel = IVec3::new(x, y, z);
        let key = BrickKey::of_voxel(place.level, voxel);
        let all = self.voxels.entry((Reverse(place.level), key, place_in_brick(voxel))).or_default();
        let middle_m = touch.moment / touch.area_m2;
        let fits = |other: &Joined| {
            other.place == place
                && other.normal.dot(touch.normal) > JOIN_COSINE
                && other.normal.dot(middle_m - other.middle_m).abs() <= JOIN_HEIGHT * side_m
        };
        let found = all.iter().position(fits).or((all.len() == ELEMENTS_MAX).then_some(ELEMENTS_MAX - 1));
        let index = found.unwrap_or(all.len());
        if index == all.len() {
            all.push(Joined {
                place,
                normal: touch.normal,
                middle_m,
                normals: DVec3::ZERO,
                area_m2: 0.0,
                moment: DVec3::ZERO,
                bits: 0,
            });
        }
        let joined = &mut all[index];
        joined.normals += touch.area_m2 * touch.normal;
        joined.area_m2 += touch.area_m2;
        joined.moment += touch.moment;
        joined.bits |= touch.bits;
    }

    /// All of them, brick by brick.
    pub fn into_bricks(self) -> Vec<Brick> {
        let mut bricks: Vec<Brick> = Vec::new();
        for ((Reverse(level), key, place), all) in &self.voxels {
            let side_m = self.side_m(*level);
            let voxel = key.first_voxel() + voxel_in_brick(*place);
            let middle_m = (voxel.as_dvec3() + 0.5) * side_m;
            let of_voxel = Voxel { place: *place, elements: all.len() as u16 };
            let elements = all.iter().map(|joined| joined.element(middle_m, side_m));
            match bricks.last_mut().filter(|brick| brick.key == *key) {
                Some(brick) => {
                    brick.voxels.push(of_voxel);
                    brick.elements.extend(elements);
                }
                None => {
                    let elements = elements.collect();
                    bricks.push(Brick { key: *key, voxels: vec![of_voxel], elements });
                }
            }
        }
        bricks
    }
}

impl Joined {
    /// `middle_m` is that of the voxel, `side_m` its side.
    fn element(&self, middle_m: DVec3, side_m: f64) -> Element {
        let normal = NormalCode::of(self.normals.try_normalize().unwrap_or(self.normal));
        // The plane is that of the normal as it is stored.
        let height_m = normal.normal().as_dvec3().dot(self.moment / self.area_m2 - middle_m);
        Element {
            normal,
            plane: Element::plane_code(height_m, side_m),
            bits: self.bits,
            patch: (self.place.patch != u64::MAX).then_some(PatchKey(self.place.patch)),
            glow: self.place.glow,
            is_backed: self.place.is_backed,
            is_finest: self.place.is_finest,
        }
    }
}
