//! Receivers: texels that take light in. A receiver's identity is (block key, texel); it does not depend on where the
//! manifest places blocks.

use serde::{Deserialize, Serialize};

/// Identity of a block: first eight bytes of the digest of (instance path, side, part).
pub type BlockKey = u64;

/// A texel of a block, in texels from the block's corner.
pub type Texel = [u16; 2];

/// Receivers of a cluster, one entry per receiver in every array.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Receivers {
    /// Blocks that they lie in; `block` indexes it.
    pub blocks: Vec<BlockKey>,
    /// Index into `blocks`.
    pub block: Vec<u16>,
    /// Texel inside the block.
    pub texel: Vec<Texel>,
    /// Position in metres (shifted out of geometry where needed).
    pub position_m: Vec<[f32; 3]>,
    /// Unit normal towards the lit side.
    pub normal: Vec<[f32; 3]>,
    /// Diffuse albedo ρ, linear Rec.709, below 1.
    pub albedo: Vec<[f32; 3]>,
    /// Emitted radiance Lₑ in W·m⁻²·sr⁻¹ at emitter scale 1.
    pub emission: Vec<[f32; 3]>,
    /// Which neighbouring texels no wall stands between: bits of [`LINKS`]. A picture interpolates along links only,
    /// so that light does not pass under a wall that stands on a floor.
    pub links: Vec<u8>,
    /// Which of the texel's 4 × 4 points lie on surface, on the receiver's own side of every wall: bit `4·row + column`
    /// for the point `((column, row) + ½) / 4` of the texel. 0 where none does: the receiver's own
    /// place is then the only one.
    pub coverage: Vec<u16>,
    /// Where a wall cuts the texel: the straight edge of the receiver's own side, beyond which pictures show others' light.
    pub edge: Vec<TexelEdge>,
}

/// A straight line through a texel, with a receiver's own side before it; or none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TexelEdge(pub u16);

impl TexelEdge {
    /// All of the texel is on the receiver's side.
    pub const NONE: Self = Self(0);
    /// Offsets are less than this, in texels.
    const REACH: f32 = 0.75;
    /// Offsets are stored this exactly, in texels.
    pub const ROUNDING: f32 = Self::REACH / 127.0 / 2.0;

    /// The nearest angle that is stored exactly, in radians.
    pub fn rounded(angle_rad: f32) -> f32 {
        f32::from(Self::turn(angle_rad)) * (std::f32::consts::TAU / 256.0)
    }

    fn turn(angle_rad: f32) -> u16 {
        (angle_rad / std::f32::consts::TAU * 256.0).round().rem_euclid(256.0) as u16 % 256
    }

    /// The edge across the unit direction `angle_rad` from the texel's x axis, so far from its middle in texels, to the
    /// nearest 1/256 of a turn and 1/127 of ¾ of a texel.
    pub fn new(angle_rad: f32, offset: f32) -> Self {
        let along = (offset / Self::REACH * 127.0).round().clamp(-127.0, 127.0) as i16;
        Self(Self::turn(angle_rad) << 8 | (128 + along) as u16)
    }

    /// The same edge in a texel whose x axis, y axis or both run the other way.
    pub fn mirrored(self, [x, y]: [bool; 2]) -> Self {
        let turn = self.0 >> 8;
        let turn = if x { (128_u16.wrapping_sub(turn)) & 0xFF } else { turn };
        let turn = if y { 0_u16.wrapping_sub(turn) & 0xFF } else { turn };
        if self == Self::NONE { self } else { Self(turn << 8 | self.0 & 0xFF) }
    }

    /// A place in the texel, 0..1 in x and y, is beyond the edge.
    pub fn is_beyond(self, [x, y]: [f32; 2]) -> bool {
        if self == Self::NONE {
            return false;
        }
        let angle_rad = f32::from(self.0 >> 8) * (std::f32::consts::TAU / 256.0);
        let offset = (f32::from(self.0 & 0xFF) - 128.0) * (Self::REACH / 127.0);
        (x - 0.5) * libm::cosf(angle_rad) + (y - 0.5) * libm::sinf(angle_rad) > offset
    }
}

/// Points along each side of a texel, see [`Receivers::coverage`].
pub const COVERAGE_SIDE: u32 = 4;
/// Points of a texel.
pub const COVERAGE_POINTS: u32 = COVERAGE_SIDE * COVERAGE_SIDE;

/// Offset of the texel that each bit of [`Receivers::links`] speaks of, lowest bit first. The other four neighbours
/// are linked by their own bits.
pub const LINKS: [[i32; 2]; 4] = [[1, 0], [0, 1], [1, 1], [-1, 1]];

impl Receivers {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.texel.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.texel.is_empty()
    }

    /// Level of a receiver: trailing zero bits common to its texel coordinates, at most `levels − 1`.
    pub fn level(texel: Texel, levels: u32) -> u32 {
        (texel[0] | texel[1]).trailing_zeros().min(levels - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrored_edge_has_the_mirror_images_of_the_places_beyond_it() {
        for edge in [TexelEdge::new(0.3, 0.2), TexelEdge::new(4.0, -0.31), TexelEdge::new(0.0, 0.1)] {
            for axes @ [x, y] in [[false; 2], [true, false], [false, true], [true; 2]] {
                let flipped = |at: f32, flip: bool| if flip { 1.0 - at } else { at };
                for index in 0..64 {
                    let at @ [u, v] = [(index % 8) as f32, (index / 8) as f32].map(|i| (i + 0.5) / 8.0);
                    let image = [flipped(u, x), flipped(v, y)];
                    assert_eq!(edge.mirrored(axes).is_beyond(image), edge.is_beyond(at), "{edge:?} {axes:?}");
                }
            }
        }
        assert_eq!(TexelEdge::NONE.mirrored([true; 2]), TexelEdge::NONE);
    }
}
