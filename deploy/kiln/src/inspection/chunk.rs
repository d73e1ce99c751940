//! Figures of one chunk: what it holds, and the bytes of its sections. All of it is decoded first, so a chunk that is
//! shown is a chunk that can be read.

use std::fmt;

use lightkiln_proto::chunk::{ChunkError, ENTRY_BYTES, HEADER_BYTES, container};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::Kinds;
use lightkiln_proto::manifest::Layer;
use serde::Serialize;
use serde_json::Value;

/// A chunk in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChunkFigures {
    /// Kind of chunk.
    pub kind: &'static str,
    /// Digest of its bytes.
    pub digest: String,
    /// Length.
    pub bytes: u64,
    /// Its content, by name.
    pub content: Value,
    /// Prefixes that are coarser versions, smallest first.
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
    /// Decodes a chunk of any kind in the table and counts its content.
    pub fn of(kinds: &Kinds, bytes: &[u8]) -> Result<Self, ChunkError> {
        let kind = container::kind_of(bytes)?;
        let row = kinds.chunk(kind).ok_or(ChunkError::UnknownKind { found: kind.0 })?;
        let content = (row.describe)(bytes)?;
        let length = bytes.len() as u64;
        let layers = row.layers.map_or_else(|| Ok(Vec::new()), |layers| layers(bytes, length))?;
        let digest = Digest::of(bytes).to_string();
        let sections = sections(bytes, row.sections);
        Ok(Self { kind: row.name, digest, bytes: length, content, layers, sections })
    }
}

/// Reads the section table of a chunk that has been decoded, so its lengths hold.
fn sections(bytes: &[u8], names: &[(u8, &'static str)]) -> Vec<Section> {
    let short = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
    let long = |raw: &[u8]| u32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]);
    let (head_bytes, count) = (short(HEADER_BYTES - 4), short(HEADER_BYTES - 2));
    let table = &bytes[HEADER_BYTES + head_bytes..][..count * ENTRY_BYTES];
    let section = |raw: &[u8]| Section {
        name: names.iter().find(|(tag, _)| *tag == raw[0]).map_or("unknown", |(_, name)| name),
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
        let figures = ChunkFigures::of(&Kinds::new(), &bytes).unwrap();
        assert_eq!((figures.kind, figures.bytes), ("texture", bytes.len() as u64));
        assert_eq!(figures.content["file_bytes"], 1000);
        assert_eq!(figures.sections.len(), 1);
        assert_eq!((figures.sections[0].name, figures.sections[0].raw_bytes), ("file", 1000));
        assert!(figures.sections[0].stored_bytes < 100);
    }

    #[test]
    fn bytes_that_are_no_chunk_are_an_error() {
        for bytes in [&b""[..], b"LKCH", b"hello, this is no chunk", &[0xff; 64]] {
            assert!(ChunkFigures::of(&Kinds::new(), bytes).is_err(), "{bytes:?}");
        }
    }
}
