//! Voxels: a scene's surfaces as elements on lattices of doubling voxels, each of which names the surface patch whose radiance it has
//! (\[Drinovsky2013\] stores light instead). Walks through them find what a ray or a narrow cone meets.

mod chunk;
mod columns;
mod cones;
mod content;
mod head;
mod light;
mod place;
mod predict;
mod table;
mod walk;
mod walked;

#[cfg(test)]
mod shells;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use chunk::{ROW, VOXELS_CHUNK, decode_voxels, decode_voxels_prefix, encode_voxels, voxel_layers};
pub use cones::{
    Bundle, Cone, IRRADIANCE_WALKS, OCCLUSION_REACH_M, OCCLUSION_WALKS, REFLECTION_WALKS, Seen,
    ambient_occlusion, irradiance, reflection,
};
pub use content::{
    BRICK_VOXELS, BRICKS_MAX, Brick, BrickKey, Element, Glow, LEVELS_MAX, NormalCode, REGION_LEVELS,
    REGION_VOXELS, SUBS, Voxel, VoxelPart, place_in_brick, sub_in_voxel, voxel_in_brick,
};
pub use head::{GLOWS_MAX, PART_BRICKS_MAX, PART_ELEMENTS_MAX};
pub use light::{WalkLight, first_of_sky, glows_of, sky_directions};
pub use table::{
    BRICK_SIZE, BRICK_WORDS, BrickRow, DARK_PATCH, ElementRow, NO_BRICK, VOXEL_SIZE, VoxelTable, brick_hash,
    patch_numbers,
};
pub use walk::{NO_ELEMENT, STEPS_MAX, Start, WalkHit, walk, walk_within};
pub use walked::{WALK_WEIGHT, walk_identity, walked, walked_without_factors};

/// Role of the chunks of voxels: that of the coarser levels first.
pub const VOXELS: &str = "voxels";

/// Sums over all voxels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoxelTotals {
    /// Side of the finest in metres.
    pub voxel_m: f32,
    /// Regions with surfaces.
    pub regions: u64,
    /// Bricks.
    pub bricks: u64,
    /// Elements of each level, the finest first.
    pub elements: Vec<u64>,
}

impl VoxelTotals {
    /// Adds a part.
    pub fn add(&mut self, part: &VoxelPart) {
        self.voxel_m = part.voxel_m;
        self.bricks += part.bricks.len() as u64;
        for brick in &part.bricks {
            let level = brick.key.level as usize;
            self.elements.resize(self.elements.len().max(level + 1), 0);
            self.elements[level] += brick.elements.len() as u64;
        }
    }

    /// Adds another sum.
    pub fn join(&mut self, other: &Self) {
        self.voxel_m = other.voxel_m;
        self.regions += other.regions;
        self.bricks += other.bricks;
        self.elements.resize(self.elements.len().max(other.elements.len()), 0);
        self.elements.iter_mut().zip(&other.elements).for_each(|(sum, count)| *sum += count);
    }

    /// For people; `bytes` are those of all chunks.
    pub fn words(&self, bytes: u64) -> String {
        let Self { voxel_m, regions, bricks, elements } = self;
        let all: u64 = elements.iter().sum();
        let each = bytes as f64 / all.max(1) as f64;
        let levels: Vec<String> = elements.iter().map(u64::to_string).collect();
        let levels = levels.join(" ");
        format!(
            "{all} elements in voxels of {voxel_m} m and more, {bricks} bricks, {regions} regions, {each:.1} bytes an element; \
             by level {levels}\n"
        )
    }
}
