//! The head of a cluster chunk: counts and layers, uncompressed, so that a reader knows the shape of everything
//! before it touches a section.

use super::bytes::{Reader, put_f32s};
use super::error::{ChunkError, in_range};
use super::layers::{BAND_GROUP_LASTS, FactorShape, LAYERS_MAX, LayerBox, RANK_GROUP_ENDS};
use super::limits::*;
use super::order::LEVELS_MAX;

/// Bytes of the head before its layers.
pub(super) const CLUSTER_HEAD_BYTES: usize = 56;
/// Bytes of a layer in the head.
pub(super) const LAYER_BYTES: usize = 8;

/// A cluster's head.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ClusterHead {
    /// Bounds of the receivers in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Counts that decide the grid of sections.
    pub shape: FactorShape,
    /// Blocks named.
    pub blocks: usize,
    /// Emitters that reach the cluster.
    pub emitters: usize,
    /// Whether near hits follow the factors of each layer.
    pub near: bool,
    /// Layers, smallest first, each with its number of sections.
    pub layers: Vec<(usize, LayerBox)>,
}

impl ClusterHead {
    /// Receivers of all levels.
    pub fn receivers(&self) -> usize {
        self.shape.receivers_in(0)
    }

    /// Errs if a count passes its limit.
    pub fn check(&self, section: &'static str) -> Result<(), ChunkError> {
        let limit =
            |what, value: usize, max: usize| in_range(section, what, value as u64, 0, max as u64).map(drop);
        self.shape.check(section)?;
        if let Some(axis) = (0..3).find(|&axis| self.bounds_m[0][axis] > self.bounds_m[1][axis]) {
            return Err(ChunkError::Order { section, what: "bounds on axis", index: axis });
        }
        limit("blocks", self.blocks, BLOCKS_MAX)?;
        limit("emitters", self.emitters, EMITTERS_MAX)?;
        limit("irradiances of emitters", self.emitters * self.receivers(), EMITTER_ENTRIES_MAX)
    }

    /// Reads and checks a head.
    pub fn read(bytes: &[u8], section_count: usize) -> Result<Self, ChunkError> {
        let mut reader = Reader::new("cluster head", bytes);
        let mut corner = || -> Result<[f32; 3], ChunkError> {
            Ok([reader.f32("bounds")?, reader.f32("bounds")?, reader.f32("bounds")?])
        };
        let bounds_m = [corner()?, corner()?];
        let mut counts = [0; LEVELS_MAX as usize];
        for count in &mut counts {
            let found = reader.u32("receivers of a level")?;
            *count = in_range("cluster head", "receivers of a level", found.into(), 0, RECEIVERS_MAX as u64)?;
        }
        let keys = reader.u32("column keys")? as usize;
        let blocks = reader.u32("blocks")? as usize;
        let emitters = usize::from(reader.u16("emitters")?);
        let [levels, bands, rank] =
            [reader.u8("levels")?, reader.u8("bands")?, reader.u8("rank")?].map(u32::from);
        let sky = in_range("cluster head", "sky flag", reader.u8("sky flag")?.into(), 0, 1)? == 1;
        let layer_count = reader.u8("layer count")?;
        let near = in_range("cluster head", "near flag", reader.u8("near flag")?.into(), 0, 1)? == 1;
        let shape = FactorShape { counts, levels, keys, sky, bands, rank };
        let mut head = Self { bounds_m, shape, blocks, emitters, near, layers: Vec::new() };
        head.check("cluster head")?;
        let layer_count = in_range("cluster head", "layer count", layer_count.into(), 1, LAYERS_MAX as u64)?;
        head.layers = read_layers(&mut reader, layer_count, &head.shape, section_count)?;
        reader.end()?;
        Ok(head)
    }

    /// The head's bytes.
    pub fn write(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(CLUSTER_HEAD_BYTES + LAYER_BYTES * self.layers.len());
        put_f32s(&mut out, self.bounds_m.as_flattened());
        self.shape.counts.iter().for_each(|&count| out.extend_from_slice(&(count as u32).to_le_bytes()));
        out.extend_from_slice(&(self.shape.keys as u32).to_le_bytes());
        out.extend_from_slice(&(self.blocks as u32).to_le_bytes());
        out.extend_from_slice(&(self.emitters as u16).to_le_bytes());
        let FactorShape { levels, bands, rank, sky, .. } = self.shape;
        out.extend_from_slice(&[levels as u8, bands as u8, rank as u8, sky.into()]);
        out.extend_from_slice(&[self.layers.len() as u8, self.near.into()]);
        for (sections, layer) in &self.layers {
            out.extend_from_slice(&(*sections as u16).to_le_bytes());
            out.extend_from_slice(&[layer.level as u8, layer.bands as u8, layer.rank as u8, 0, 0, 0]);
        }
        out
    }
}

fn read_layers(
    reader: &mut Reader,
    count: usize,
    shape: &FactorShape,
    section_count: usize,
) -> Result<Vec<(usize, LayerBox)>, ChunkError> {
    let section = reader.section();
    let mut layers: Vec<(usize, LayerBox)> = Vec::with_capacity(count);
    for index in 0..count {
        let sections = usize::from(reader.u16("layer's sections")?);
        let [level, bands, rank] =
            [reader.u8("layer")?, reader.u8("layer")?, reader.u8("layer")?].map(u32::from);
        in_range(section, "layer's level", level.into(), 0, u64::from(shape.levels) - 1)?;
        in_range(section, "layer's bands", bands.into(), 0, shape.bands.into())?;
        in_range(section, "layer's rank", rank.into(), 0, shape.rank.into())?;
        let aligned = RANK_GROUP_ENDS.map(|end| end.min(shape.rank)).contains(&rank)
            && BAND_GROUP_LASTS.map(|last| last.min(shape.bands)).contains(&bands);
        if !aligned {
            return Err(ChunkError::Order { section, what: "layer (not on group bounds)", index });
        }
        if reader.take("reserved", 3, 1)?.iter().any(|&byte| byte != 0) {
            return Err(ChunkError::Order { section, what: "layer (reserved bytes are set)", index });
        }
        let layer = LayerBox { level, bands, rank };
        let nested = layers.last().is_none_or(|(before_sections, before)| {
            *before_sections < sections
                && before.level >= level
                && before.bands <= bands
                && before.rank <= rank
        });
        if !nested {
            return Err(ChunkError::Order { section, what: "layer", index });
        }
        layers.push((sections, layer));
    }
    match layers.last() {
        Some(&(sections, layer)) if sections == section_count && layer == shape.full() => Ok(layers),
        _ => Err(ChunkError::Order { section, what: "layer (the last is not everything)", index: count - 1 }),
    }
}
