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

use crate::content::BlockKey;
use crate::manifest::{Manifest, hex_key};

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
pub(crate) use light::nearest_of_sky;
pub use light::{WalkLight, first_of_sky, glows_of, sky_directions};
pub use table::{
    BRICK_SIZE, BRICK_WORDS, BrickRow, DARK_PATCH, ElementRow, NO_BRICK, VOXEL_SIZE, VoxelTable, brick_hash,
    patch_numbers,
};
pub use walk::{NO_ELEMENT, STEPS_MAX, Start, WalkHit, walk, walk_within};
pub use walked::{LitByWalks, WALK_WEIGHT, light_of_walks, walk_identity, walked};

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
    /// Blocks of receivers whose indirect light is that of walks, ascending; in a bake of walks alone it is that of all.
    #[serde(default, skip_serializing_if = "WalkedBlocks::is_empty")]
    pub walked: WalkedBlocks,
}

/// Keys of blocks, of 16 hex digits each in JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WalkedBlocks(Vec<HexKey>);

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct HexKey(#[serde(with = "hex_key")] BlockKey);

/// Blocks of a bake whose receivers have the light of walks, as its manifest's body tells them; none where it tells nothing.
pub fn walked_blocks(manifest: &Manifest) -> WalkedBlocks {
    let of_body = manifest.body.get(VOXELS).map(VoxelTotals::deserialize);
    of_body.and_then(Result::ok).map(|totals| totals.walked).unwrap_or_default()
}

impl WalkedBlocks {
    /// Of keys in any order.
    pub fn new(mut keys: Vec<BlockKey>) -> Self {
        keys.sort_unstable();
        Self(keys.into_iter().map(HexKey).collect())
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The keys.
    pub fn keys(&self) -> impl Iterator<Item = BlockKey> + '_ {
        self.0.iter().map(|HexKey(key)| *key)
    }
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
        let Self { voxel_m, regions, bricks, elements, walked } = self;
        let all: u64 = elements.iter().sum();
        let each = bytes as f64 / all.max(1) as f64;
        let levels: Vec<String> = elements.iter().map(u64::to_string).collect();
        let levels = levels.join(" ");
        let of_walks = match walked.keys().count() {
            0 => String::new(),
            count => format!("; {count} blocks of receivers have the light of walks"),
        };
        format!(
            "{all} elements in voxels of {voxel_m} m and more, {bricks} bricks, {regions} regions, {each:.1} bytes an element; \
             by level {levels}{of_walks}\n"
        )
    }
}
