//! The head of a chunk of voxels: counts of all levels, uncompressed, so that a reader knows the shape of everything before it touches a
//! section.

use super::columns::{LevelCounts, SECTIONS};
use super::content::{Glow, LEVELS_MAX};
use super::place::CELLS_MAX;
use crate::chunk::ChunkError;
use crate::chunk::bytes::Reader;
use crate::chunk::container::SectionId;
use crate::chunk::error::{all_numbers, in_range};

/// Most bricks of a chunk.
pub const PART_BRICKS_MAX: usize = 1 << 18;
/// Most elements of a chunk.
pub const PART_ELEMENTS_MAX: usize = 1 << 22;
/// Most entries of a chunk's table of what elements emit.
pub const GLOWS_MAX: usize = u16::MAX as usize;

/// Section tags of chunks of voxels; part is level, 0, 0.
pub(super) mod tags {
    /// Glows of elements; part is 0, 0, 0.
    pub const GLOWS: u8 = 1;
    /// Bricks, their voxels, and how many elements these have.
    pub const BRICKS: u8 = 2;
    /// Normals.
    pub const NORMALS: u8 = 3;
    /// Planes.
    pub const PLANES: u8 = 4;
    /// Flags, patches and places in the table of what elements emit.
    pub const PATCHES: u8 = 5;
    /// Bits that are not as guessed.
    pub const BITS: u8 = 6;
    /// Those of a level.
    pub const OF_LEVEL: [u8; super::SECTIONS] = [BRICKS, NORMALS, PLANES, PATCHES, BITS];
}

/// A chunk's head.
pub(super) struct Head {
    /// Side h₀ of voxels of level 0 in metres.
    pub voxel_m: f32,
    /// Entries of the table of what elements emit.
    pub glows: usize,
    /// Cells of patches along a side of their level's voxels.
    pub cells: u32,
    /// Levels that have bricks, the coarsest first.
    pub levels: Vec<LevelCounts>,
}

/// Errs unless it is the side of a voxel.
pub(super) fn check_side(section: &'static str, voxel_m: f32) -> Result<(), ChunkError> {
    all_numbers(section, "side of a voxel", &[voxel_m], "1e-9..=1e9 m", |x| (1e-9..=1e9).contains(&x))
}

impl Head {
    /// Sections of the whole chunk.
    pub fn sections(&self) -> Vec<SectionId> {
        let glows = SectionId::new(tags::GLOWS, [0; 3]);
        let of_level = |counts: &LevelCounts| {
            let part = [counts.level as u8, 0, 0];
            tags::OF_LEVEL.map(|tag| SectionId::new(tag, part))
        };
        std::iter::once(glows).chain(self.levels.iter().flat_map(of_level)).collect()
    }

    /// How many of the first sections hold so many levels.
    pub fn sections_of(levels: usize) -> usize {
        1 + SECTIONS * levels
    }

    /// Memory that decoding so many of its levels takes, about.
    pub fn decoded_bytes(&self, levels: &[LevelCounts]) -> u64 {
        let of_levels: u64 = levels.iter().map(LevelCounts::decoded_bytes).sum();
        of_levels + (size_of::<Glow>() * self.glows) as u64
    }

    /// The head's bytes.
    pub fn write(&self) -> Vec<u8> {
        let mut out = self.voxel_m.to_le_bytes().to_vec();
        out.extend_from_slice(&(self.glows as u32).to_le_bytes());
        out.extend_from_slice(&(self.cells as u16).to_le_bytes());
        out.extend_from_slice(&(self.levels.len() as u16).to_le_bytes());
        for &LevelCounts { level, bricks, voxels, elements } in &self.levels {
            for count in [level, bricks as u32, voxels as u32, elements as u32] {
                out.extend_from_slice(&count.to_le_bytes());
            }
        }
        out
    }

    /// Reads and checks a head.
    pub fn read(bytes: &[u8]) -> Result<Self, ChunkError> {
        let section = "voxels head";
        let mut reader = Reader::new(section, bytes);
        let voxel_m = reader.f32("side of a voxel")?;
        check_side(section, voxel_m)?;
        let glows = reader.u32("glows")?;
        let glows = in_range(section, "glows", glows.into(), 0, GLOWS_MAX as u64)?;
        let cells = reader.u16("cells along a voxel")?;
        let cells = in_range(section, "cells along a voxel", cells.into(), 1, CELLS_MAX.into())? as u32;
        let count = reader.u16("levels")?;
        let count = in_range(section, "levels", count.into(), 0, LEVELS_MAX.into())?;
        let mut levels: Vec<LevelCounts> = Vec::with_capacity(count);
        for index in 0..count {
            let counts = read_counts(&mut reader)?;
            if levels.last().is_some_and(|before| before.level <= counts.level) {
                return Err(ChunkError::Order { section, what: "level", index });
            }
            levels.push(counts);
        }
        reader.end()?;
        let head = Self { voxel_m, glows, cells, levels };
        let all = |of: fn(&LevelCounts) -> usize| head.levels.iter().map(of).sum::<usize>() as u64;
        in_range(section, "bricks", all(|counts| counts.bricks), 0, PART_BRICKS_MAX as u64)?;
        in_range(section, "elements", all(|counts| counts.elements), 0, PART_ELEMENTS_MAX as u64)?;
        Ok(head)
    }
}

/// Counts of a level: each brick has a voxel, and each voxel an element.
fn read_counts(reader: &mut Reader) -> Result<LevelCounts, ChunkError> {
    let section = reader.section();
    let level = reader.u32("level")?;
    in_range(section, "level", level.into(), 0, u64::from(LEVELS_MAX) - 1)?;
    let bricks = reader.u32("bricks")?;
    let bricks = in_range(section, "bricks of a level", bricks.into(), 1, PART_BRICKS_MAX as u64)?;
    let voxels = reader.u32("voxels")?;
    let voxels = in_range(section, "voxels of a level", voxels.into(), bricks as u64, 512 * bricks as u64)?;
    let elements = reader.u32("elements")?;
    let (least, most) = (voxels as u64, PART_ELEMENTS_MAX as u64);
    let elements = in_range(section, "elements of a level", elements.into(), least, most)?;
    Ok(LevelCounts { level, bricks, voxels, elements })
}
