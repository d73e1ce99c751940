//! Light that walks meet: the radiance of elements and of the sky, from λ (METHOD.md §2.10, §2.16).

use glam::{Vec3, Vec4};

use super::cones::Seen;
use super::table::{DARK_PATCH, VoxelTable};
use crate::harmonics::relight_direction;
use crate::relight::PatchTable;

/// Radiance of a bake's elements at one moment.
#[derive(Clone, Debug)]
pub struct WalkLight<'a> {
    table: &'a VoxelTable,
    /// Radiance of patches, their differences, and the sky's parts: λ.
    lambda: &'a [Vec4],
    /// Radiance of what elements emit, W·m⁻²·sr⁻¹.
    glows: Vec<Vec3>,
    /// Directions of the parts of the sky.
    sky: Vec<Vec3>,
    first_of_sky: usize,
}

/// Radiance of a table's glows from that of each emitter, W·m⁻²·sr⁻¹.
pub fn glows_of(table: &VoxelTable, emitters: impl Fn(u16) -> Vec3) -> Vec<Vec3> {
    table.glows.iter().map(|glow| Vec3::from(glow.share) * emitters(glow.emitter)).collect()
}

/// Directions of the parts of the sky.
pub fn sky_directions(patches: &PatchTable) -> Vec<Vec3> {
    (0..patches.sky_parts).map(|part| relight_direction(part, patches.sky_parts)).collect()
}

/// The part of the sky whose direction is nearest.
pub(crate) fn nearest_of_sky(sky: &[Vec3], direction: Vec3) -> u32 {
    let nearest = sky.iter().zip(0..).fold((0, f32::NEG_INFINITY), |best, (middle, part)| {
        let cosine = direction.dot(*middle);
        if cosine > best.1 { (part, cosine) } else { best }
    });
    nearest.0
}

/// Place of the sky's first part in λ.
pub fn first_of_sky(patches: &PatchTable) -> usize {
    2 * patches.patches.len()
}

impl<'a> WalkLight<'a> {
    /// Of λ as `patches` lists it, and the radiance of each emitter, by its scale, W·m⁻²·sr⁻¹.
    pub fn new(
        table: &'a VoxelTable,
        patches: &PatchTable,
        lambda: &'a [Vec4],
        emitters: impl Fn(u16) -> Vec3,
    ) -> Self {
        let glows = glows_of(table, emitters);
        Self { table, lambda, glows, sky: sky_directions(patches), first_of_sky: first_of_sky(patches) }
    }

    /// The elements.
    pub fn table(&self) -> &'a VoxelTable {
        self.table
    }

    /// Radiance of what a walk meets, W·m⁻²·sr⁻¹.
    pub fn radiance(&self, seen: &Seen) -> Vec3 {
        match seen {
            Seen::Hit(hit) if hit.is_back => Vec3::ZERO,
            Seen::Hit(hit) => self.of_element(hit.element),
            Seen::Sky(direction) => self.of_sky(*direction),
        }
    }

    /// `λ_e + Lₑ` of an element's lit side.
    pub fn of_element(&self, element: u32) -> Vec3 {
        let Some(row) = self.table.elements.get(element as usize) else { return Vec3::ZERO };
        let glow = row.glow().map_or(Vec3::ZERO, |glow| self.glows[glow as usize]);
        if row.patch_number == DARK_PATCH { glow } else { self.of_patch(row.patch_number) + glow }
    }

    /// λ of a patch.
    pub fn of_patch(&self, patch: u32) -> Vec3 {
        self.lambda.get(patch as usize).map_or(Vec3::ZERO, |radiance| radiance.truncate())
    }

    /// Mean radiance of the part of the sky in a direction.
    pub fn of_sky(&self, direction: Vec3) -> Vec3 {
        let place = self.first_of_sky + nearest_of_sky(&self.sky, direction) as usize;
        self.lambda.get(place).map_or(Vec3::ZERO, |radiance| radiance.truncate())
    }
}
