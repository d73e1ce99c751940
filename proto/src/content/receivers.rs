//! Receivers: texels that take light in. A receiver's identity is (block key, texel); it does not depend on where the
//! manifest places blocks.

/// Identity of a block: first eight bytes of the digest of (instance path, side, part).
pub type BlockKey = u64;

/// A texel of a block, in texels from the block's corner.
pub type Texel = [u16; 2];

/// Receivers of a cluster, one entry per receiver in every array.
#[derive(Clone, Debug, Default, PartialEq)]
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
    /// for the point `((column, row) + ½) / 4` of the texel. 0 for a receiver off its surface, which is its only point.
    pub coverage: Vec<u16>,
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
