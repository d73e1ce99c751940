//! Decoding a cluster, or as much of it as a prefix of its chunk holds.

use super::bytes::Reader;
use super::cluster::sections_of;
use super::cluster_head::ClusterHead;
use super::cluster_near::{HIT_BYTES, begin_bytes_max, near_bytes_max, read_begin, read_near};
use super::cluster_receivers::{PALETTE_MAX, ReceiverCodec, read_irradiance, receivers_bytes_max};
use super::container::{Container, SectionId};
use super::error::{ChunkError, all_ascending, all_numbers, in_range};
use super::factors::FactorDecoder;
use super::layers::LayerBox;
use super::predict::Predictor;
use super::table::CLUSTER;
use crate::content::{ClusterTransport, EmitterIrradiance};
use crate::manifest::Layer;

/// Decodes a whole cluster chunk.
pub fn decode_cluster(bytes: &[u8]) -> Result<ClusterTransport, ChunkError> {
    let container = Container::whole(CLUSTER, bytes)?;
    Ok(decode(&container, bytes.len() as u64)?.0)
}

/// Decodes the largest layer that lies fully in `bytes`, the first bytes of a chunk of `total_len` bytes.
///
/// The cluster has that layer's receivers, bands and rank and nothing more; `Layer::bytes` is the layer's own length.
/// Errs if not even the smallest layer is there.
pub fn decode_cluster_prefix(bytes: &[u8], total_len: u64) -> Result<(ClusterTransport, Layer), ChunkError> {
    let container = Container::prefix(CLUSTER, bytes, total_len)?;
    decode(&container, total_len)
}

/// Layers of a cluster chunk, from its first bytes: header, head and section table must be there.
pub fn cluster_layers(bytes: &[u8], total_len: u64) -> Result<Vec<Layer>, ChunkError> {
    let container = Container::prefix(CLUSTER, bytes, total_len)?;
    let head = ClusterHead::read(container.head, container.entries.len())?;
    check_sections(&container, &head)?;
    Ok(head.layers.iter().map(|&(sections, layer)| layer.with_bytes(container.end_of(sections))).collect())
}

fn decode(container: &Container, total_len: u64) -> Result<(ClusterTransport, Layer), ChunkError> {
    let head = ClusterHead::read(container.head, container.entries.len())?;
    check_sections(container, &head)?;
    let there = head.layers.iter().rposition(|(sections, _)| *sections <= container.complete);
    let Some(last) = there else {
        let (section, what) = ("chunk", "smallest layer");
        let wanted = container.end_of(head.layers[0].0).min(total_len);
        return Err(ChunkError::Truncated { section, what, offset: 0, wanted, left: container.present() });
    };
    let (sections, layer) = head.layers[last];
    container.check_expansion(decoded_bytes(&head, layer))?;
    let mut decoder = Decoder::new(&head, layer, container.version);
    decoder.base(&container.section(0, "base", decoder.base_bytes_max())?)?;
    for index in 0..=last {
        decoder.layer(container, index)?;
    }
    let cluster = ClusterTransport { factors: decoder.factors.factors, ..decoder.cluster };
    Ok((cluster, layer.with_bytes(container.end_of(sections))))
}

/// Errs unless the sections are those of each layer in turn, in their order.
fn check_sections(container: &Container, head: &ClusterHead) -> Result<(), ChunkError> {
    let mut wanted: Vec<SectionId> = Vec::new();
    for (index, &(sections, _)) in head.layers.iter().enumerate() {
        wanted.extend(sections_of(index, head.near));
        let (count, end) = (wanted.len() as u64, sections as u64);
        in_range("cluster head", "layer's sections", end, count, count)?;
    }
    container.check_sections(&wanted)
}

/// Memory that a decoded layer takes, about.
fn decoded_bytes(head: &ClusterHead, layer: LayerBox) -> u64 {
    let receivers = head.shape.receivers_in(layer.level);
    let others = receivers * (65 + 12 * head.emitters) + 8 * head.blocks;
    head.shape.layer_decoded_bytes(layer) + others as u64
}

/// A cluster that fills up layer by layer.
struct Decoder<'a> {
    head: &'a ClusterHead,
    version: u16,
    codec: ReceiverCodec,
    predictor: Predictor,
    /// All but its factors.
    cluster: ClusterTransport,
    factors: FactorDecoder,
}

impl<'a> Decoder<'a> {
    /// All counts have been checked against their limits.
    fn new(head: &'a ClusterHead, layer: LayerBox, version: u16) -> Self {
        let cluster = ClusterTransport { bounds_m: head.bounds_m, ..ClusterTransport::default() };
        let codec = ReceiverCodec::new(head.bounds_m, Vec::new(), head.shape.levels, version);
        let factors = FactorDecoder::new(head.shape, layer);
        Self { head, version, codec, predictor: Predictor::default(), cluster, factors }
    }

    /// Reads the sections of layer number `index`, but the base.
    fn layer(&mut self, container: &Container, index: usize) -> Result<(), ChunkError> {
        let (end, layer) = self.head.layers[index];
        let sections = end - usize::from(self.head.near);
        let before = index.checked_sub(1).map(|before| self.head.layers[before].1);
        let shape = &self.head.shape;
        let levels: Vec<u32> = shape.new_levels(before, layer).collect();
        let bytes_max = |&level: &u32| {
            receivers_bytes_max(shape.counts[level as usize], self.head.blocks, self.head.emitters)
        };
        let raw = container.section(sections - 3, "receivers", levels.iter().map(bytes_max).sum())?;
        self.receivers(&raw, &levels)?;
        let [high_max, low_max] = shape.layer_bytes_max(before, layer);
        let high = container.section(sections - 2, "factors", high_max)?;
        let low = container.section(sections - 1, "low parts", low_max)?;
        self.factors.layer([&high, &low], before, layer, &self.predictor)?;
        if self.head.near {
            self.near(container, index, &levels)?;
        }
        Ok(())
    }

    /// Reads the near hits of layer number `index`, its last section.
    fn near(&mut self, container: &Container, index: usize, levels: &[u32]) -> Result<(), ChunkError> {
        let shape = &self.head.shape;
        let counts: Vec<usize> = levels.iter().map(|&level| shape.counts[level as usize]).collect();
        let bytes_max = near_bytes_max(&counts) + if index == 0 { begin_bytes_max() } else { 0 };
        let (sections, _) = self.head.layers[index];
        let content = decoded_bytes(self.head, shape.full());
        container.check_expansion(content + container.raw_bytes(sections - 1))?;
        let raw = container.section(sections - 1, "near hits", bytes_max)?;
        let mut reader = Reader::new("near hits", &raw);
        let near = &mut self.cluster.near;
        if index == 0 {
            read_begin(&mut reader, near)?;
        }
        let without = content + 8 * near.blocks.len() as u64;
        for count in counts {
            let may_take = |hits: u64| container.check_expansion(without + HIT_BYTES * hits);
            read_near(&mut reader, near, count, self.version, may_take)?;
        }
        reader.end()
    }

    fn receivers(&mut self, raw: &[u8], levels: &[u32]) -> Result<(), ChunkError> {
        let mut reader = Reader::new("receivers", raw);
        for &level in levels {
            let count = self.head.shape.counts[level as usize];
            let receivers = &mut self.cluster.receivers;
            self.codec.read(&mut reader, receivers, count, level, &mut self.predictor)?;
            for emitter in &mut self.cluster.emitters {
                read_irradiance(&mut reader, emitter, count)?;
            }
        }
        reader.end()
    }

    fn base_bytes_max(&self) -> u64 {
        let ClusterHead { blocks, emitters, shape, .. } = self.head;
        shape.base_bytes_max() + (8 * blocks + 2 * emitters + 2 + 12 * PALETTE_MAX) as u64
    }

    fn base(&mut self, raw: &[u8]) -> Result<(), ChunkError> {
        let mut reader = Reader::new("base", raw);
        self.cluster.receivers.blocks = ascending_keys(&mut reader, "block", self.head.blocks)?;
        self.factors.base(&mut reader, self.version)?;
        for index in 0..self.head.emitters {
            let emitter = reader.u16("emitter")?;
            if self.cluster.emitters.last().is_some_and(|before| before.emitter >= emitter) {
                return Err(ChunkError::Order { section: "base", what: "emitter", index });
            }
            self.cluster.emitters.push(EmitterIrradiance { emitter, irradiance: Vec::new() });
        }
        let count = reader.u16("palette length")?;
        let count = in_range("base", "palette length", count.into(), 0, PALETTE_MAX as u64)?;
        let albedo = reader.f32s("palette", 3 * count)?;
        all_numbers("base", "palette", &albedo, "0 to below 1", |x| (0.0..1.0).contains(&x))?;
        self.codec.palette = albedo.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        reader.end()
    }
}

/// `count` keys, each larger than the one before.
pub fn ascending_keys(reader: &mut Reader, what: &'static str, count: usize) -> Result<Vec<u64>, ChunkError> {
    let keys = reader.u64s(what, count)?;
    all_ascending(reader.section(), what, &keys)?;
    Ok(keys)
}
