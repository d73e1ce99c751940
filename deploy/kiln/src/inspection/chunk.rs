//! Figures of one chunk: what it holds, and the bytes of its sections. All of it is decoded first, so a chunk that is
//! shown is a chunk that can be read.

use std::fmt;

use lightkiln_proto::chunk::{
    self, ChunkError, ChunkKind, ENTRY_BYTES, HEADER_BYTES, cluster_layers, decode_cluster, decode_geometry,
    decode_patches, decode_probe_batch, decode_texture,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::Layer;
use lightkiln_proto::prt::RelightHit;
use serde::Serialize;
use serde_json::{Value, json};

/// Names of section tags 1, 2, … by kind, as FORMAT.md has them.
const CLUSTER_SECTIONS: &[&str] = &["base", "receivers", "factors", "factors low", "near"];
const PROBES_SECTIONS: &[&str] = &["base", "hits"];
const GEOMETRY_SECTIONS: &[&str] =
    &["draws", "positions", "normals", "lightmap", "triangles", "uvs", "colours"];
const TEXTURE_SECTIONS: &[&str] = &["file"];
const PATCHES_SECTIONS: &[&str] = &["patches", "leaves"];

/// A chunk in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChunkFigures {
    /// Kind of chunk.
    pub kind: &'static str,
    /// Digest of its bytes.
    pub digest: String,
    /// Length.
    pub bytes: u64,
    /// What it holds, by name.
    pub content: Value,
    /// Prefixes that are coarser versions, smallest first; clusters only.
    pub layers: Vec<Layer>,
    /// Sections in order.
    pub sections: Vec<Section>,
}

/// One section as the chunk's table lists it; FORMAT.md says what tags and parts mean.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Section {
    /// FORMAT.md's name for the tag.
    pub name: &'static str,
    /// Tag.
    pub tag: u8,
    /// Part numbers.
    pub part: [u8; 3],
    /// Bytes in the chunk.
    pub stored_bytes: u32,
    /// Bytes once decompressed.
    pub raw_bytes: u32,
}

impl ChunkFigures {
    /// Decodes a chunk of any kind and counts what is in it.
    pub fn of(bytes: &[u8]) -> Result<Self, ChunkError> {
        let kind_byte = bytes.get(chunk::MAGIC.len() + 2).copied().unwrap_or(0);
        // A kind that is none is reported by the decoder of the first.
        let found = ChunkKind::ALL.into_iter().find(|(kind, _)| *kind as u8 == kind_byte);
        let (kind, name) = found.unwrap_or(ChunkKind::ALL[0]);
        let (content, section_names) = match kind {
            ChunkKind::Cluster => (cluster(bytes)?, CLUSTER_SECTIONS),
            ChunkKind::Probes => (probes(bytes)?, PROBES_SECTIONS),
            ChunkKind::Geometry => (geometry(bytes)?, GEOMETRY_SECTIONS),
            ChunkKind::Texture => (texture(bytes)?, TEXTURE_SECTIONS),
            ChunkKind::Patches => (patches(bytes)?, PATCHES_SECTIONS),
        };
        let length = bytes.len() as u64;
        let layers = match kind {
            ChunkKind::Cluster => cluster_layers(bytes, length)?,
            _ => Vec::new(),
        };
        let digest = Digest::of(bytes).to_string();
        let sections = sections(bytes, section_names);
        Ok(Self { kind: name, digest, bytes: length, content, layers, sections })
    }
}

fn cluster(bytes: &[u8]) -> Result<Value, ChunkError> {
    let cluster = decode_cluster(bytes)?;
    Ok(json!({
        "receivers": cluster.receivers.len(),
        "blocks": cluster.receivers.blocks.len(),
        "probes": cluster.probes.len(),
        "bands": cluster.bands,
        "sky": cluster.sky,
        "rank": cluster.rank,
        "emitters": cluster.emitters.len(),
        "near hits": cluster.near.len(),
        "receivers with near hits": cluster.near.ranges().filter(|hits| !hits.is_empty()).count(),
        "bounds_m": cluster.bounds_m,
    }))
}

fn probes(bytes: &[u8]) -> Result<Value, ChunkError> {
    let batch = decode_probe_batch(bytes)?;
    let count = |wanted: fn(&RelightHit) -> bool| batch.hits.iter().filter(|hit| wanted(hit)).count();
    Ok(json!({
        "probes": batch.probes.len(),
        "relight_rays": batch.relight_rays,
        "blocks": batch.blocks.len(),
        "hits_receiver": count(|hit| matches!(hit, RelightHit::Receiver { .. })),
        "hits_sky": count(|hit| matches!(hit, RelightHit::Sky)),
        "hits_dark": count(|hit| matches!(hit, RelightHit::Dark)),
    }))
}

fn geometry(bytes: &[u8]) -> Result<Value, ChunkError> {
    let draws = decode_geometry(bytes)?.draws;
    Ok(json!({
        "draws": draws.len(),
        "vertices": draws.iter().map(|draw| draw.position_m.len()).sum::<usize>(),
        "triangles": draws.iter().map(|draw| draw.triangles.len()).sum::<usize>(),
    }))
}

fn patches(bytes: &[u8]) -> Result<Value, ChunkError> {
    let set = decode_patches(bytes)?;
    Ok(json!({
        "patches": set.patches.len(),
        "leaves": set.leaf_starts.len().saturating_sub(1),
        "receivers": set.texel.len(),
        "blocks": set.blocks.len(),
        "sky_parts": set.sky_parts,
    }))
}

fn texture(bytes: &[u8]) -> Result<Value, ChunkError> {
    let texture = decode_texture(bytes)?;
    Ok(json!({ "media_type": texture.media_type, "file_bytes": texture.bytes.len() }))
}

/// Reads the section table of a chunk that has been decoded, so its lengths hold.
fn sections(bytes: &[u8], names: &[&'static str]) -> Vec<Section> {
    let short = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
    let long = |raw: &[u8]| u32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]);
    let (head_bytes, count) = (short(HEADER_BYTES - 4), short(HEADER_BYTES - 2));
    let table = &bytes[HEADER_BYTES + head_bytes..][..count * ENTRY_BYTES];
    let section = |raw: &[u8]| Section {
        name: names.get(usize::from(raw[0]).wrapping_sub(1)).copied().unwrap_or("unknown"),
        tag: raw[0],
        part: [raw[1], raw[2], raw[3]],
        stored_bytes: long(&raw[4..8]),
        raw_bytes: long(&raw[8..12]),
    };
    table.chunks_exact(ENTRY_BYTES).map(section).collect()
}

impl fmt::Display for ChunkFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} chunk, {} bytes, digest {}", self.kind, self.bytes, self.digest)?;
        for (name, value) in self.content.as_object().into_iter().flatten() {
            writeln!(f, "  {name:14} {value}")?;
        }
        for layer in &self.layers {
            let Layer { bytes, level, bands, rank } = layer;
            writeln!(f, "layer: first {bytes} bytes: level {level}, bands {bands}, rank {rank}")?;
        }
        for Section { name, part, stored_bytes, raw_bytes, .. } in &self.sections {
            writeln!(f, "section {name:10} {part:?}: {stored_bytes} bytes ({raw_bytes} decompressed)")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::chunk::encode_texture;

    use super::*;

    #[test]
    fn texture_chunk_is_told_with_its_sections() {
        let bytes = encode_texture("image/png", &[7; 1000]).unwrap();
        let figures = ChunkFigures::of(&bytes).unwrap();
        assert_eq!((figures.kind, figures.bytes), ("texture", bytes.len() as u64));
        assert_eq!(figures.content["file_bytes"], 1000);
        assert_eq!(figures.sections.len(), 1);
        assert_eq!((figures.sections[0].name, figures.sections[0].raw_bytes), ("file", 1000));
        assert!(figures.sections[0].stored_bytes < 100);
    }

    #[test]
    fn bytes_that_are_no_chunk_are_an_error() {
        for bytes in [&b""[..], b"LKCH", b"hello, this is no chunk", &[0xff; 64]] {
            assert!(ChunkFigures::of(bytes).is_err(), "{bytes:?}");
        }
    }
}
