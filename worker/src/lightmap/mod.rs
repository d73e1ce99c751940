//! The lightmap: charts of the scene's surfaces in blocks of texels, and the receivers that stand for texels.
//!
//! Tasks `scene.unwrap` (charts) and `scene.place` (receivers). Both depend on the scene and on settings of texels alone,
//! so kinds of bake that agree on those share them.

pub mod charts;
mod clearance;
mod linking_reads;
mod numbering;
pub mod place;
mod polygon;
mod raised;
mod texel_points;
mod texel_table;
mod tiles;
mod world;

use glam::Vec3;
use lightkiln_proto::content::{AreaCode, BlockKey, Texel, TexelEdge};
use serde::{Deserialize, Serialize};

use crate::geometry::Site;

pub use charts::Charts;
pub use numbering::Numbering;
pub use tiles::{TILE_TEXELS, Tiles};
pub use world::{Found, Surface, World, link_height_m};

/// Magic of the lightmap artefact.
pub const ARTEFACT_MAGIC: &[u8; 4] = b"LKlm";
/// Name under which tasks see it.
pub const ARTEFACT: &str = "place/lightmap";
/// No receiver, in [`Block::receiver_of_texel`].
pub const NO_RECEIVER: u32 = u32::MAX;
/// No receiver, as the texel lies in a cavity that nothing in the open sees.
pub const CAVITY: u32 = u32::MAX - 1;

/// All receivers of a scene: the artefact of `scene.place`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lightmap {
    /// Texel size of the scene's core in metres, and of all of it if it is of one scale.
    pub texel_m: f32,
    /// Index of the first block of each instance; its blocks follow part by part, front before back.
    pub first_block: Vec<u32>,
    /// Blocks.
    pub blocks: Vec<Block>,
    /// Receivers, block by block in raster order, guests among them.
    pub receivers: Vec<Receiver>,
}

/// The receivers of one side of one part of an instance's unwrap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// Identity: digest of path, part and side.
    pub key: BlockKey,
    /// Path, part and side in words.
    pub name: String,
    /// Side of its texels in metres.
    pub texel_m: f32,
    /// Width and height in texels.
    pub size: [u32; 2],
    /// Instance.
    pub instance: u32,
    /// Receiver that stands for each texel, row by row, never a guest; [`NO_RECEIVER`] where the block is empty, or
    /// [`CAVITY`].
    pub receiver_of_texel: Vec<u32>,
}

/// A receiver r (METHOD.md §1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Receiver {
    /// Index into [`Lightmap::blocks`].
    pub block: u32,
    /// Texel in the block.
    pub texel: Texel,
    /// x_r: on the surface, or shifted out of geometry, in metres; that of the receiver whose light it takes.
    pub position_m: Vec3,
    /// n_r: unit shading normal of the lit side.
    pub normal: Vec3,
    /// Unit normal of the triangle, of the lit side.
    pub face_normal: Vec3,
    /// ρ, linear, below 1.
    pub albedo: [f32; 3],
    /// Lₑ in W·m⁻²·sr⁻¹.
    pub emission: [f32; 3],
    /// Bits of `lightkiln_proto::content::LINKS`, of the step of placement that finds them; 0 before.
    pub links: u8,
    /// Points of its texel on its own side of every wall, bits of `Receivers::coverage`; 0 before the last step of placement.
    pub coverage: u16,
    /// Points of a grid of 8 × 8 that its indirect light is gathered at where the coverage has few, bit `8·y + x`; else 0.
    pub fine: u64,
    /// Where a wall cuts its texel; none before the last step of placement.
    pub edge: TexelEdge,
    /// Surface that reads this texel, of one side; of a guest without meaning.
    pub area: AreaCode,
    /// Receiver whose light it takes, mostly itself: of the same point, rays and random numbers. 0 before the step of placement
    /// that finds it.
    pub light_of: u32,
}

impl Receiver {
    /// The place that it gathers light at.
    pub fn site(&self) -> Site {
        Site { position_m: self.position_m, normal: self.normal, face_normal: self.face_normal }
    }
}

impl Lightmap {
    /// Key of the block of a receiver.
    pub fn block_key(&self, receiver: u32) -> BlockKey {
        self.blocks[self.receivers[receiver as usize].block as usize].key
    }

    /// Side of a receiver's texel in metres.
    pub fn texel_m_of(&self, receiver: u32) -> f32 {
        self.blocks[self.receivers[receiver as usize].block as usize].texel_m
    }

    /// Block and texel of a receiver: its identity in every bake of the scene.
    pub fn name_of(&self, receiver: u32) -> (BlockKey, Texel) {
        (self.block_key(receiver), self.receivers[receiver as usize].texel)
    }

    /// The receiver whose own texel this is, a guest or not, if there is any.
    pub fn receiver_at(&self, block: u32, x: i32, y: i32) -> Option<u32> {
        let order = |receiver: &Receiver| {
            let [x, y] = receiver.texel.map(i32::from);
            (receiver.block, y, x)
        };
        self.receivers.binary_search_by_key(&(block, y, x), order).ok().map(|index| index as u32)
    }

    /// A receiver has no surface: it stands where that of its chart is interpolated with the light of a neighbour.
    pub fn is_guest(&self, receiver: u32) -> bool {
        let Receiver { block, texel: [x, y], .. } = self.receivers[receiver as usize];
        let block = &self.blocks[block as usize];
        block.receiver_of_texel[usize::from(y) * block.size[0] as usize + usize::from(x)] != receiver
    }

    /// Numbers that seed a receiver's random numbers: its identity, and `purpose`, which tells one use from another.
    pub fn seed_of(&self, receiver: &Receiver, purpose: u64) -> u64 {
        let [x, y] = receiver.texel.map(u64::from);
        crate::rays::sampling::seed_of(&[self.blocks[receiver.block as usize].key, x, y, purpose])
    }

    /// Positions of the receivers in metres.
    pub fn positions_m(&self) -> Vec<Vec3> {
        self.receivers.iter().map(|receiver| receiver.position_m).collect()
    }

    /// Longest side of the receivers' bounds in metres.
    pub fn extent_m(&self) -> f32 {
        let positions = || self.receivers.iter().map(|receiver| receiver.position_m);
        let low = positions().fold(Vec3::INFINITY, Vec3::min);
        let high = positions().fold(Vec3::NEG_INFINITY, Vec3::max);
        (high - low).max_element().max(0.0)
    }
}
