//! Encoding a cluster: canonical order, quantised factors, sections ordered coarse to fine.

use super::bytes::{put_f32s, put_u64s};
use super::cluster_head::ClusterHead;
use super::cluster_near::StoredNear;
use super::cluster_receivers::{LINKS_MAX, ReceiverCodec, palette_of, write_irradiance};
use super::container::{ContainerWriter, SectionId, VERSION};
use super::error::{ChunkError, all_finite, all_numbers, in_range};
use super::factors::StoredFactors;
use super::layers::{FactorShape, LayerBox};
use super::numbers::IRRADIANCE_MAX;
use super::order::{Arrangement, LEVELS_MAX};
use super::predict::Predictor;
use super::table::CLUSTER;
use crate::content::{ClusterTransport, EmitterIrradiance, Receivers};
use crate::manifest::Layer;

/// Section tags of cluster chunks; part is layer, 0, 0.
pub(super) mod tags {
    /// Keys, steps and palette; in layer 0 only.
    pub const BASE: u8 = 1;
    /// Receivers of the layer's new levels.
    pub const RECEIVERS: u8 = 2;
    /// New numbers of U and ΣVᵀ: their high parts.
    pub const FACTORS: u8 = 3;
    /// Low parts of the same numbers.
    pub const FACTORS_LOW: u8 = 4;
    /// Near hits of the layer's new receivers, in clusters that have any.
    pub const NEAR: u8 = 5;
}

/// How exactly a cluster is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantisationSettings {
    /// Largest `‖U·ΣVᵀ − decoded‖/‖U·ΣVᵀ‖` (Frobenius), 0.0001..=0.5. More → fewer bytes.
    pub relative_error: f32,
    /// Levels of receivers, 1..=4, as in the bake's `lod_levels`. More → a coarser first layer.
    pub levels: u32,
}

impl Default for QuantisationSettings {
    fn default() -> Self {
        Self { relative_error: 0.003, levels: 3 }
    }
}

/// A cluster's chunk, and what the manifest says of it.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedCluster {
    /// The chunk.
    pub bytes: Vec<u8>,
    /// Prefixes that are coarser versions, smallest first; the last is the whole chunk.
    pub layers: Vec<Layer>,
    /// `‖U·ΣVᵀ − decoded‖/‖U·ΣVᵀ‖`, measured on what a decoder will have.
    pub quantisation_error: f32,
    /// Keys named: patches without a code are left out.
    pub keys: u32,
}

/// Encodes a cluster. The order of its receivers, keys, blocks and emitters does not matter: receivers are stored
/// by level, block key and texel, the others by key. Patches whose column of ΣVᵀ is worth no code are left out.
///
/// Errs if arrays disagree in length, a number is not finite or out of its range, two receivers share a texel, or a
/// limit is passed.
pub fn encode_cluster(
    cluster: &ClusterTransport,
    settings: QuantisationSettings,
) -> Result<EncodedCluster, ChunkError> {
    check_input(cluster, settings)?;
    let stored = Stored::of(cluster, settings)?;
    let mut writer = ContainerWriter::new(CLUSTER);
    let mut head = stored.head.clone();
    let mut before = None;
    for (index, layer) in stored.head.shape.layers().into_iter().enumerate() {
        for id in sections_of(index, head.near) {
            writer.push(id, &stored.section(id, before, layer))?;
        }
        head.layers.push((writer.section_count(), layer));
        before = Some(layer);
    }
    let (bytes, ends) = writer.finish(&head.write())?;
    let layers = head.layers.iter().map(|&(sections, layer)| layer.with_bytes(ends[sections - 1])).collect();
    let quantisation_error = stored.factors.relative_error();
    Ok(EncodedCluster { bytes, layers, quantisation_error, keys: head.shape.keys as u32 })
}

/// Sections that layer number `index` adds, in stored order.
pub(super) fn sections_of(index: usize, near: bool) -> Vec<SectionId> {
    let tags = [tags::BASE, tags::RECEIVERS, tags::FACTORS, tags::FACTORS_LOW, tags::NEAR];
    let used = usize::from(index > 0)..tags.len() - usize::from(!near);
    tags[used].iter().map(|&tag| SectionId::new(tag, [index as u8, 0, 0])).collect()
}

fn check_input(cluster: &ClusterTransport, settings: QuantisationSettings) -> Result<(), ChunkError> {
    in_range("encoder", "levels", settings.levels.into(), 1, LEVELS_MAX.into())?;
    check_places(cluster)
}

/// Errs if arrays of a cluster's receivers disagree in length, or a number of theirs is out of its range.
pub(super) fn check_places(cluster: &ClusterTransport) -> Result<(), ChunkError> {
    let section = "encoder";
    let same = |what, length: usize, wanted: usize| {
        in_range(section, what, length as u64, wanted as u64, wanted as u64).map(drop)
    };
    let Receivers { block, texel, position_m, normal, albedo, emission, links, coverage, edge, .. } =
        &cluster.receivers;
    let receivers = texel.len();
    same("blocks of receivers", block.len(), receivers)?;
    same("positions", position_m.len(), receivers)?;
    same("normals", normal.len(), receivers)?;
    same("albedos", albedo.len(), receivers)?;
    same("emissions", emission.len(), receivers)?;
    same("links", links.len(), receivers)?;
    same("coverage", coverage.len(), receivers)?;
    same("edges", edge.len(), receivers)?;
    for &bits in links {
        in_range(section, "links", bits.into(), 0, LINKS_MAX)?;
    }
    all_finite(section, "bounds", cluster.bounds_m.as_flattened())?;
    all_finite(section, "position", position_m.as_flattened())?;
    all_finite(section, "normal", normal.as_flattened())?;
    all_numbers(section, "albedo", albedo.as_flattened(), "0 to below 1", |x| (0.0..1.0).contains(&x))?;
    all_numbers(section, "emission", emission.as_flattened(), "0 or more", |x| x >= 0.0 && x.is_finite())?;
    for emitter in &cluster.emitters {
        same("irradiances of an emitter", emitter.irradiance.len(), receivers)?;
        let irradiance = emitter.irradiance.as_flattened();
        all_numbers(section, "irradiance", irradiance, "0..=1.8e19", |x| {
            (0.0..=IRRADIANCE_MAX).contains(&x)
        })?;
    }
    Ok(())
}

/// A cluster in stored order, quantised.
struct Stored {
    head: ClusterHead,
    places: Places,
    factors: StoredFactors,
}

impl Stored {
    fn of(cluster: &ClusterTransport, settings: QuantisationSettings) -> Result<Self, ChunkError> {
        let arrangement = Arrangement::of(&cluster.receivers, settings.levels)?;
        let Arrangement { source, counts, .. } = &arrangement;
        let QuantisationSettings { relative_error, levels } = settings;
        let factors = StoredFactors::of(&cluster.factors, source, *counts, levels, relative_error)?;
        let places = Places::of(cluster, &arrangement, factors.shape)?;
        let head = ClusterHead {
            bounds_m: places.codec.bounds_m,
            shape: factors.shape,
            blocks: places.receivers.blocks.len(),
            emitters: places.emitters.len(),
            near: places.near.is_some(),
            layers: Vec::new(),
        };
        head.check("encoder")?;
        Ok(Self { head, places, factors })
    }

    fn section(&self, id: SectionId, before: Option<LayerBox>, layer: LayerBox) -> Vec<u8> {
        let factors = || self.factors.layer(before, layer, &self.places.predictor);
        match id.tag {
            tags::BASE => self.base(),
            tags::FACTORS => factors().0,
            tags::FACTORS_LOW => factors().1,
            _ => self.places.section(id.tag, before, layer),
        }
    }

    fn base(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put_u64s(&mut out, &self.places.receivers.blocks);
        self.factors.write_base(&mut out);
        self.places.write_base(&mut out);
        out
    }
}

/// A cluster without its factors, in stored order.
pub(super) struct Places {
    shape: FactorShape,
    receivers: Receivers,
    codec: ReceiverCodec,
    predictor: Predictor,
    pub emitters: Vec<EmitterIrradiance>,
    near: Option<StoredNear>,
}

impl Places {
    /// Of a cluster whose factors have that shape.
    pub fn of(
        cluster: &ClusterTransport,
        arrangement: &Arrangement,
        shape: FactorShape,
    ) -> Result<Self, ChunkError> {
        let receivers = sorted_receivers(&cluster.receivers, arrangement);
        let near = StoredNear::of(cluster, arrangement)?;
        let (mut emitters, _) = ascending(&cluster.emitters, "emitter", |entry| entry.emitter)?;
        emitters.iter_mut().for_each(|entry| entry.irradiance = arrangement.sorted(&entry.irradiance));
        let bounds_m = grown(cluster.bounds_m, &receivers.position_m);
        let mut codec = ReceiverCodec::new(bounds_m, palette_of(&receivers.albedo), shape.levels, VERSION);
        codec.load(&receivers);
        let mut predictor = Predictor::default();
        for level in shape.levels_in(shape.full()) {
            predictor.extend(&receivers, shape.rows_of(level), level);
        }
        Ok(Self { shape, receivers, codec, predictor, emitters, near })
    }

    /// Appends the end of the base: emitters and palette.
    pub fn write_base(&self, out: &mut Vec<u8>) {
        self.emitters.iter().for_each(|entry| out.extend_from_slice(&entry.emitter.to_le_bytes()));
        out.extend_from_slice(&(self.codec.palette.len() as u16).to_le_bytes());
        put_f32s(out, self.codec.palette.as_flattened());
    }

    /// A section of receivers or of near hits.
    pub fn section(&self, tag: u8, before: Option<LayerBox>, layer: LayerBox) -> Vec<u8> {
        if tag == tags::RECEIVERS { self.new_receivers(before, layer) } else { self.near(before, layer) }
    }

    fn near(&self, before: Option<LayerBox>, layer: LayerBox) -> Vec<u8> {
        let mut out = Vec::new();
        let Some(near) = &self.near else { return out };
        if before.is_none() {
            near.begin(&mut out);
        }
        for level in self.shape.new_levels(before, layer) {
            near.write(&mut out, self.shape.rows_of(level));
        }
        out
    }

    fn new_receivers(&self, before: Option<LayerBox>, layer: LayerBox) -> Vec<u8> {
        let mut out = Vec::new();
        for level in self.shape.new_levels(before, layer) {
            let rows = self.shape.rows_of(level);
            self.codec.write(&mut out, &self.receivers, rows.clone(), level, &self.predictor);
            for emitter in &self.emitters {
                write_irradiance(&mut out, &emitter.irradiance[rows.clone()]);
            }
        }
        out
    }
}

fn sorted_receivers(receivers: &Receivers, arrangement: &Arrangement) -> Receivers {
    Receivers {
        blocks: arrangement.blocks.clone(),
        block: arrangement.block.clone(),
        texel: arrangement.sorted(&receivers.texel),
        position_m: arrangement.sorted(&receivers.position_m),
        normal: arrangement.sorted(&receivers.normal),
        albedo: arrangement.sorted(&receivers.albedo),
        emission: arrangement.sorted(&receivers.emission),
        links: arrangement.sorted(&receivers.links),
        coverage: arrangement.sorted(&receivers.coverage),
        edge: arrangement.sorted(&receivers.edge),
    }
}

/// `items` ascending by key, and where each came from; errs if two share a key.
pub fn ascending<T: Clone, K: Ord>(
    items: &[T],
    what: &'static str,
    key: impl Fn(&T) -> K,
) -> Result<(Vec<T>, Vec<usize>), ChunkError> {
    let mut source: Vec<usize> = (0..items.len()).collect();
    source.sort_by_key(|&index| key(&items[index]));
    let repeated = source.windows(2).find(|pair| key(&items[pair[0]]) == key(&items[pair[1]]));
    match repeated {
        Some(pair) => Err(ChunkError::Order { section: "encoder", what, index: pair[1] }),
        None => Ok((source.iter().map(|&index| items[index].clone()).collect(), source)),
    }
}

/// Bounds that hold all positions too.
fn grown(bounds_m: [[f32; 3]; 2], positions: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let [mut lo, mut hi] = bounds_m;
    for position in positions {
        for axis in 0..3 {
            lo[axis] = lo[axis].min(position[axis]);
            hi[axis] = hi[axis].max(position[axis]);
        }
    }
    [lo, hi]
}
