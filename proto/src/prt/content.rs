//! What the chunks of a relightable bake hold, decoded: plain arrays in the notation of METHOD.md §2.
//!
//! Identity: a receiver is (block key, texel), a probe is its key; neither depends on where the manifest puts things.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// Identity of a block: first eight bytes of the digest of (instance path, side, part).
pub type BlockKey = u64;
/// Identity of a probe: first eight bytes of the digest of its lattice cell.
pub type ProbeKey = u64;

/// Identity of a surface patch, or of a part of the sky: what a cluster's columns speak of when the basis is patches.
///
/// Made of the patch's place, so that it does not depend on the rest of the scene, and neighbours have near keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PatchKey(pub u64);

impl PatchKey {
    /// Level that stands for the sky.
    const SKY_LEVEL: u64 = 15;

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

    /// Level, 0…14 of a patch.
    pub fn level(self) -> u64 {
        self.0 >> 60
    }

    /// Direction, 0…5 of a patch.
    pub fn direction(self) -> u64 {
        self.0 >> 55 & 0x1f
    }
}

/// A texel of a block, in texels from the block's corner.
pub type Texel = [u16; 2];

/// One cluster: its receivers, what supports them, and the factorised transport `A ≈ U (ΣVᵀ)`.
///
/// With basis patches `probes` holds the keys of surface patches and parts of the sky, of one coefficient each: `bands`
/// is 0 and `sky` false. With spherical harmonics, columns of A, hence of `vt`: for probe p of `probes` in order, coefficients j = 0…J−1; then J sky columns
/// (`sky` true) or none. Windowing is folded in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClusterTransport {
    /// Lower and upper corner of the receivers' bounds in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Receivers, coarse levels first.
    pub receivers: Receivers,
    /// Supporting probes, ascending by key.
    pub probes: Vec<ProbeKey>,
    /// Highest spherical-harmonic band.
    pub bands: u32,
    /// Whether sky columns follow the probes'.
    pub sky: bool,
    /// Rank k of the factors; 0 when nothing reaches the cluster.
    pub rank: u32,
    /// U, receiver-major: `u[r·k + i]`.
    pub u: Vec<f32>,
    /// ΣVᵀ, rank-major: `vt[i·n + column]`.
    pub vt: Vec<f32>,
    /// Irradiance straight from emissive surfaces, one entry per emitter that reaches the cluster.
    pub emitters: Vec<EmitterIrradiance>,
    /// What receivers in narrow places meet close by; it is not in the factors.
    pub near: NearHits,
}

/// Points close to receivers whose light is read at the very point: in narrow places, where a texel has strips of light
/// and shadow. A hit at y on the texel t gives its receiver `weight · ρ_t/π · (E_dir(y) + E_ind(t))`, with E_dir for the
/// normal of t. What is so closed in that a wall parts it from the middles of all texels around has an albedo and a normal
/// of its own, and the E_ind of the receiver that meets it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NearHits {
    /// Longest distance of a hit from its receiver along an axis, in metres.
    pub reach_m: f32,
    /// Hits of each receiver, which follow each other in the arrays below. Empty where no receiver has any.
    pub count: Vec<u8>,
    /// What each hit of a receiver counts by, at most π: the integral of cosθ over the directions that it stands for.
    pub weight: Vec<f32>,
    /// Blocks that hits lie in; `block` indexes it.
    pub blocks: Vec<BlockKey>,
    /// Surface of each hit.
    pub surface: Vec<NearSurface>,
    /// How far its place y is from the receiver's, in shares of the reach of 1/[`NearHits::STEPS`].
    pub offset: Vec<[i16; 3]>,
}

impl NearHits {
    /// Steps of an offset along the reach.
    pub const STEPS: i16 = 2047;

    /// Offset of a hit at `to_m` from its receiver at `from_m`; farther than the reach is at the reach.
    pub fn offset_of(from_m: [f32; 3], to_m: [f32; 3], reach_m: f32) -> [i16; 3] {
        [0, 1, 2].map(|axis| {
            let share = ((to_m[axis] - from_m[axis]) / reach_m).clamp(-1.0, 1.0);
            libm::roundf(share * f32::from(Self::STEPS)) as i16
        })
    }

    /// Place of a hit in metres, from its receiver's, on a surface of that normal: raised by two steps, as rounding may
    /// have put it below.
    pub fn position_m(&self, hit: usize, from_m: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        let step_m = self.reach_m / f32::from(Self::STEPS);
        let steps = |axis: usize| f32::from(self.offset[hit][axis]) + 2.0 * normal[axis];
        [0, 1, 2].map(|axis| from_m[axis] + steps(axis) * step_m)
    }

    /// How many hits there are.
    pub fn len(&self) -> usize {
        self.surface.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.surface.is_empty()
    }

    /// Which hits each receiver has, receiver by receiver.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.count.iter().scan(0, |end, &count| {
            let start = *end;
            *end += usize::from(count);
            Some(start..*end)
        })
    }

    /// The receiver of every hit.
    pub fn receivers(&self) -> impl Iterator<Item = usize> + '_ {
        self.ranges().enumerate().flat_map(|(receiver, hits)| hits.map(move |_| receiver))
    }
}

/// What a near hit lies on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NearSurface {
    /// A texel.
    Texel {
        /// Index into [`NearHits::blocks`].
        block: u16,
        /// Texel in the block. Where no cluster has a receiver of it, no light reaches it: it counts as dark.
        texel: Texel,
    },
    /// A surface that no texel stands for.
    Own {
        /// Diffuse albedo ρ, linear Rec.709, below 1.
        albedo: [f32; 3],
        /// Unit normal towards the lit side.
        normal: [f32; 3],
    },
}

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
}

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

impl ClusterTransport {
    /// Coefficients per probe, J.
    pub fn coefficients(&self) -> usize {
        (self.bands as usize + 1) * (self.bands as usize + 1)
    }

    /// Columns of A: n.
    pub fn columns(&self) -> usize {
        (self.probes.len() + usize::from(self.sky)) * self.coefficients()
    }
}

/// Irradiance at a cluster's receivers straight from one emitter at scale 1, shadowed, in W·m⁻².
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EmitterIrradiance {
    /// Index into the manifest's emitters.
    pub emitter: u16,
    /// One per receiver.
    pub irradiance: Vec<[f32; 3]>,
}

/// A batch of probes and what their relight rays meet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeBatch {
    /// Probes, ascending by key.
    pub probes: Vec<Probe>,
    /// Relight rays per probe K; directions are [`crate::sh::relight_direction`].
    pub relight_rays: u32,
    /// Blocks that hits name.
    pub blocks: Vec<BlockKey>,
    /// Hits, probe-major: `hits[p·K + k]`.
    pub hits: Vec<RelightHit>,
}

/// A probe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Probe {
    /// Identity.
    pub key: ProbeKey,
    /// Position in metres.
    pub position_m: [f32; 3],
    /// Support radius in metres.
    pub radius_m: f32,
}

/// What a relight ray meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RelightHit {
    /// A receiver: index into the batch's `blocks`, and its texel there.
    Receiver {
        /// Index into [`ProbeBatch::blocks`].
        block: u16,
        /// Texel in the block. Where no cluster has a receiver of it, no light reaches it: it counts as dark.
        texel: Texel,
    },
    /// Nothing: the sky.
    Sky,
    /// The back of a single-sided surface or a surface without receivers: no radiance.
    Dark,
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
    pub block: Vec<u16>,
    /// Texel of each receiver. Where no cluster has a receiver of it, no light reaches it: it counts as dark.
    pub texel: Vec<Texel>,
    /// Surface of each receiver: its weight in the mean.
    pub area: Vec<AreaCode>,
    /// Parts of the sky S; part s is what is nearest to direction [`crate::sh::relight_direction`]`(s, S)`.
    pub sky_parts: u32,
}

/// How much surface stands behind a texel, in texels: `2^((code − 128)/16)`, so within 2.2 %, from 1/256 to 244. Texels
/// on a chart's rim have less than those in its middle, and charts of uneven density more or less.
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

/// Meshes to draw.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Geometry {
    /// One per mesh instance and material.
    pub draws: Vec<Draw>,
}

/// One mesh to draw, in world space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Draw {
    /// Index into the manifest's materials.
    pub material: u32,
    /// Block of the front side.
    pub front: BlockKey,
    /// Block of the back side, for double-sided materials.
    pub back: Option<BlockKey>,
    /// Positions in metres.
    pub position_m: Vec<[f32; 3]>,
    /// Unit normals towards the front.
    pub normal: Vec<[f32; 3]>,
    /// UV of the base-colour texture, transform applied; empty when the material has none.
    pub uv: Vec<[f32; 2]>,
    /// Linear vertex colours; empty when there are none.
    pub colour: Vec<[f32; 4]>,
    /// Lightmap coordinates in texels of the block.
    pub lightmap_texel: Vec<[f32; 2]>,
    /// Triangles, counter-clockwise from the front.
    pub triangles: Vec<[u32; 3]>,
}
