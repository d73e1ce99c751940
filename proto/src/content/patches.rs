//! Surface patches: one world-aligned tree over all receivers (METHOD.md §2.3).

use serde::{Deserialize, Serialize};

use super::receivers::{BlockKey, Texel};

/// Identity of a surface patch, or of a part of the sky: a column key of clusters whose columns are patches. A column reads
/// the radiance that the key names, or the difference between a patch's and that of the patch which it is part of.
///
/// Made of the patch's place, so that it does not depend on the rest of the scene, and neighbours have near keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PatchKey(pub u64);

impl PatchKey {
    /// Level that stands for the sky.
    const SKY_LEVEL: u64 = 15;
    /// Bit of columns of differences, between level and direction.
    const DIFFERENCE: u64 = 1 << 59;

    /// Key of a patch: level 0…14, cell −2¹⁴…2¹⁴−1 on the lattice of its level, direction 0…5 (+x −x +y −y +z −z), and a
    /// number among the patches of the same place below 2¹⁰.
    pub fn of_cell(level: u32, cell: [i32; 3], direction: u8, ordinal: u32) -> Self {
        let axis = |c: i32| (i64::from(c) + (1 << 14)) as u64 & 0x7fff;
        let place = axis(cell[1]) << 30 | axis(cell[2]) << 15 | axis(cell[0]);
        Self(u64::from(level) << 60 | u64::from(direction) << 55 | place << 10 | u64::from(ordinal) & 0x3ff)
    }

    /// Key of part `index` of the sky.
    pub fn of_sky(index: u32) -> Self {
        Self(Self::SKY_LEVEL << 60 | u64::from(index))
    }

    /// Part of the sky that it names, if it names one: then nothing stands between the level and the part.
    pub fn sky(self) -> Option<u32> {
        let part = self.0 as u32;
        (self == Self::of_sky(part)).then_some(part)
    }

    /// Key of the column that reads a patch's radiance less that of the patch which it is part of.
    pub fn difference(self) -> Self {
        Self(self.0 | Self::DIFFERENCE)
    }

    /// Whether it is the key of a difference.
    pub fn is_difference(self) -> bool {
        self.level() != Self::SKY_LEVEL && self.0 & Self::DIFFERENCE != 0
    }

    /// Key of the patch itself that a column reads.
    pub fn patch(self) -> Self {
        if self.is_difference() { Self(self.0 & !Self::DIFFERENCE) } else { self }
    }

    /// Level, 0…14 of a patch.
    pub fn level(self) -> u64 {
        self.0 >> 60
    }

    /// Direction, 0…5 of a patch.
    pub fn direction(self) -> u64 {
        self.0 >> 55 & 0x1f
    }

    /// Cell x, y, z of a patch on the lattice of its level.
    pub fn cell(self) -> [i32; 3] {
        [10, 40, 25].map(|shift| (self.0 >> shift & 0x7fff) as i32 - (1 << 14))
    }

    /// Number of a patch among those of its place.
    pub fn ordinal(self) -> u32 {
        (self.0 & 0x3ff) as u32
    }
}

/// The surface patches of a bake, and how many parts its sky has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchSet {
    /// Patches, ascending by key.
    pub patches: Vec<Patch>,
    /// First entry of each leaf in `block` and `texel`, and the end.
    pub leaf_starts: Vec<u32>,
    /// Blocks that receivers lie in; `block` indexes it.
    pub blocks: Vec<BlockKey>,
    /// Block of each receiver, leaf by leaf: index into `blocks`.
    pub block: Vec<u32>,
    /// Texel of each receiver. Where no cluster has a receiver of it, no light reaches it: it counts as dark.
    pub texel: Vec<Texel>,
    /// Seen area of each receiver: its weight in the mean.
    pub area: Vec<AreaCode>,
    /// Parts of the sky S; part s holds the directions nearest to [`crate::harmonics::relight_direction`]`(s, S)`.
    pub sky_parts: u32,
}

/// An area in texels: `2^((code − 128)/16)`, so within 2.2 %, from 1/256 to 244. Of a receiver it is that of the surface that
/// reads it: texels on a chart's rim have less than those in its middle, and charts of uneven density more or less. Its
/// *seen area* is that times the share of its hemisphere that far surfaces fill.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct AreaCode(pub u8);

impl AreaCode {
    /// A whole texel.
    pub const ONE: Self = Self(128);

    /// The nearest code.
    pub fn of(texels: f32) -> Self {
        let code = libm::roundf(libm::log2f(texels.max(f32::MIN_POSITIVE)) * 16.0) + 128.0;
        Self(code.clamp(0.0, 255.0) as u8)
    }

    /// Area in texels.
    pub fn texels(self) -> f32 {
        libm::exp2f((f32::from(self.0) - 128.0) / 16.0)
    }
}

/// A surface patch: a run of leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Patch {
    /// Identity.
    pub key: PatchKey,
    /// First leaf.
    pub first_leaf: u32,
    /// Leaves.
    pub leaf_count: u32,
}
