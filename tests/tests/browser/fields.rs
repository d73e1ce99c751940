//! Decoded content as names and texts, as `pages/decode.js` makes them of the browser's: numbers of arrays by their bytes.

use std::collections::BTreeMap;

use lightkiln_proto::chunk::{
    CLUSTER, ChunkError, DIRECTORY, GEOMETRY, PATCHES, TEXTURE, decode_cluster, decode_directory,
    decode_geometry, decode_patches, decode_texture,
};
use lightkiln_proto::chunk::{Texture, container};
use lightkiln_proto::content::{ClusterTransport, Geometry, NearHits, NearSurface, PatchSet, Receivers};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{ChunkRef, ClusterRow};

/// Fields by path.
#[derive(Default, Debug, PartialEq)]
pub struct Fields(pub BTreeMap<String, String>);

impl Fields {
    fn put(&mut self, name: impl Into<String>, value: String) {
        assert!(self.0.insert(name.into(), value).is_none(), "a field twice");
    }

    fn bytes<const N: usize>(&mut self, name: impl Into<String>, numbers: impl IntoIterator<Item = [u8; N]>) {
        self.put(name, numbers.into_iter().flatten().map(|byte| format!("{byte:02x}")).collect());
    }

    fn f32s<'a>(&mut self, name: impl Into<String>, numbers: impl IntoIterator<Item = &'a f32>) {
        self.bytes(name, numbers.into_iter().map(|number| number.to_le_bytes()));
    }

    fn u64s(&mut self, name: impl Into<String>, numbers: &[u64]) {
        self.bytes(name, numbers.iter().map(|number| number.to_le_bytes()));
    }

    fn number(&mut self, name: impl Into<String>, number: impl Into<f64>) {
        self.bytes(name, [number.into().to_le_bytes()]);
    }

    fn count(&mut self, name: impl Into<String>, count: usize) {
        self.number(name, count as f64);
    }

    fn key(&mut self, name: impl Into<String>, key: Option<u64>) {
        self.put(name, key.map_or("null".to_owned(), |key| format!("{key:x}")));
    }

    /// One digest of all.
    pub fn digest(&self) -> String {
        let lines: String = self.0.iter().map(|(name, value)| format!("{name}={value}\n")).collect();
        Digest::of(lines.as_bytes()).to_string()
    }
}

/// Fields of a chunk of any kind that a browser reads.
pub fn of_chunk(bytes: &[u8]) -> Result<Fields, ChunkError> {
    let kind = container::kind_of(bytes)?;
    let mut fields = Fields::default();
    match kind {
        CLUSTER => cluster(&mut fields, &decode_cluster(bytes)?),
        GEOMETRY => geometry(&mut fields, &decode_geometry(bytes)?),
        TEXTURE => texture(&mut fields, &decode_texture(bytes)?),
        PATCHES => patches(&mut fields, &decode_patches(bytes)?),
        DIRECTORY => directory(&mut fields, &decode_directory(bytes)?),
        container::ChunkKind(found) => return Err(ChunkError::UnknownKind { found }),
    }
    Ok(fields)
}

/// Fields of a cluster.
pub fn cluster(fields: &mut Fields, cluster: &ClusterTransport) {
    fields.f32s("boundsM", cluster.bounds_m.as_flattened());
    receivers(fields, &cluster.receivers);
    let factors = &cluster.factors;
    fields.u64s("factors.keys", &factors.keys);
    fields.number("factors.bands", factors.bands);
    fields.put("factors.sky", factors.sky.to_string());
    fields.number("factors.rank", factors.rank);
    fields.f32s("factors.u", &factors.u);
    fields.f32s("factors.vt", &factors.vt);
    fields.f32s("factors.steps.u", &factors.steps.u);
    fields.f32s("factors.steps.vt", &factors.steps.vt);
    fields.f32s("factors.steps.scale", &factors.steps.scale);
    for (index, emitter) in cluster.emitters.iter().enumerate() {
        fields.number(format!("emitters.{index}.emitter"), emitter.emitter);
        fields.f32s(format!("emitters.{index}.irradiance"), emitter.irradiance.as_flattened());
    }
    near(fields, &cluster.near);
}

fn receivers(fields: &mut Fields, receivers: &Receivers) {
    let put = |name: &str| format!("receivers.{name}");
    fields.count(put("length"), receivers.len());
    fields.u64s(put("blocks"), &receivers.blocks);
    fields.bytes(put("block"), receivers.block.iter().map(|block| block.to_le_bytes()));
    fields.bytes(put("texel"), receivers.texel.as_flattened().iter().map(|axis| axis.to_le_bytes()));
    fields.f32s(put("positionM"), receivers.position_m.as_flattened());
    fields.f32s(put("normal"), receivers.normal.as_flattened());
    fields.f32s(put("albedo"), receivers.albedo.as_flattened());
    fields.f32s(put("emission"), receivers.emission.as_flattened());
    fields.bytes(put("links"), receivers.links.iter().map(|links| [*links]));
    fields.bytes(put("coverage"), receivers.coverage.iter().map(|bits| bits.to_le_bytes()));
    fields.bytes(put("edge"), receivers.edge.iter().map(|edge| edge.0.to_le_bytes()));
}

fn near(fields: &mut Fields, near: &NearHits) {
    fields.count("near.length", near.len());
    fields.number("near.reachM", near.reach_m);
    fields.bytes("near.count", near.count.iter().map(|count| [*count]));
    fields.f32s("near.weight", &near.weight);
    fields.u64s("near.blocks", &near.blocks);
    let of = |surface: &NearSurface| match *surface {
        NearSurface::Texel { block, texel } => (0_u8, block, texel, [0.0; 3], [0.0; 3]),
        NearSurface::Own { albedo, normal } => (1, 0, [0; 2], albedo, normal),
    };
    let surfaces: Vec<_> = near.surface.iter().map(of).collect();
    fields.bytes("near.surface.isOwn", surfaces.iter().map(|surface| [surface.0]));
    fields.bytes("near.surface.block", surfaces.iter().map(|surface| surface.1.to_le_bytes()));
    fields.bytes("near.surface.texel", surfaces.iter().flat_map(|surface| surface.2).map(u16::to_le_bytes));
    fields.f32s("near.surface.albedo", surfaces.iter().flat_map(|surface| &surface.3));
    fields.f32s("near.surface.normal", surfaces.iter().flat_map(|surface| &surface.4));
    fields.bytes("near.offset", near.offset.as_flattened().iter().map(|steps| steps.to_le_bytes()));
}

fn geometry(fields: &mut Fields, geometry: &Geometry) {
    for (index, draw) in geometry.draws.iter().enumerate() {
        let put = |name: &str| format!("draws.{index}.{name}");
        fields.number(put("material"), draw.material);
        fields.key(put("front"), draw.front);
        fields.key(put("back"), draw.back);
        fields.f32s(put("positionM"), draw.position_m.as_flattened());
        fields.f32s(put("normal"), draw.normal.as_flattened());
        fields.f32s(put("uv"), draw.uv.as_flattened());
        fields.f32s(put("colour"), draw.colour.as_flattened());
        fields.f32s(put("lightmapTexel"), draw.lightmap_texel.as_flattened());
        fields
            .bytes(put("triangles"), draw.triangles.as_flattened().iter().map(|corner| corner.to_le_bytes()));
    }
}

fn texture(fields: &mut Fields, texture: &Texture) {
    fields.put("mediaType", texture.media_type.clone());
    fields.bytes("bytes", texture.bytes.iter().map(|byte| [*byte]));
}

fn patches(fields: &mut Fields, set: &PatchSet) {
    fields.count("patches.length", set.patches.len());
    fields.bytes("patches.key", set.patches.iter().map(|patch| patch.key.0.to_le_bytes()));
    fields.bytes("patches.firstLeaf", set.patches.iter().map(|patch| patch.first_leaf.to_le_bytes()));
    fields.bytes("patches.leafCount", set.patches.iter().map(|patch| patch.leaf_count.to_le_bytes()));
    fields.bytes("leafStarts", set.leaf_starts.iter().map(|start| start.to_le_bytes()));
    fields.u64s("blocks", &set.blocks);
    fields.bytes("block", set.block.iter().map(|block| block.to_le_bytes()));
    fields.bytes("texel", set.texel.as_flattened().iter().map(|axis| axis.to_le_bytes()));
    fields.bytes("area", set.area.iter().map(|area| [area.0]));
    fields.number("skyParts", set.sky_parts);
}

fn directory(fields: &mut Fields, (rows, chunks): &(Vec<ClusterRow>, Vec<ChunkRef>)) {
    for (index, (row, chunk)) in rows.iter().zip(chunks).enumerate() {
        let put = |name: &str| format!("rows.{index}.{name}");
        fields.f32s(put("boundsM"), row.bounds_m.as_flattened());
        fields.number(put("receivers"), row.receivers);
        fields.number(put("keys"), row.keys);
        fields.number(put("rank"), row.rank);
        fields.number(put("truncationError"), row.truncation_error);
        fields.number(put("quantisationError"), row.quantisation_error);
        fields.number(put("uncoveredFraction"), row.uncovered_fraction);
        for (layer, of) in row.layers.iter().enumerate() {
            let put = |name: &str| format!("rows.{index}.layers.{layer}.{name}");
            fields.number(put("bytes"), of.bytes as f64);
            fields.number(put("level"), of.level);
            fields.number(put("bands"), of.bands);
            fields.number(put("rank"), of.rank);
        }
        for (layer, check) in row.checks.iter().enumerate() {
            let hex = check.0.iter().map(|byte| format!("{byte:02x}")).collect();
            fields.put(format!("rows.{index}.checks.{layer}"), hex);
        }
        fields.put(format!("chunks.{index}.digest"), chunk.digest.to_string());
        fields.number(format!("chunks.{index}.bytes"), chunk.bytes as f64);
    }
}
