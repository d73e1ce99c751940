//! The GLB container: a 12-byte header, a JSON chunk, then at most one binary chunk.
//!
//! The `gltf` crate's own reader overflows on a stated length below 12 and refuses unknown chunks, which the
//! specification asks to skip; so this one is ours.

use super::error::{ImportError, Result};

const MAGIC: &[u8; 4] = b"glTF";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BIN_CHUNK: &[u8; 4] = b"BIN\0";

/// The two parts of a GLB, borrowed from it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Glb<'a> {
    /// The glTF JSON.
    pub(super) json: &'a [u8],
    /// The first binary chunk: buffer 0 without a URI.
    pub(super) bin: Option<&'a [u8]>,
}

/// Whether these bytes claim to be a GLB.
pub(super) fn is_glb(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// Splits a GLB into its chunks.
///
/// Errors on another version than 2, on lengths beyond the file and on a first chunk that is not JSON.
pub(super) fn split(bytes: &[u8]) -> Result<Glb<'_>> {
    let version = read_u32(bytes, 4)?;
    if version != 2 {
        return Err(ImportError::version(&format!("{version}.0")));
    }
    let stated = read_u32(bytes, 8)? as usize;
    if stated > bytes.len() || stated < HEADER_BYTES {
        let problem = format!("it states {stated} bytes and has {}", bytes.len());
        return Err(ImportError::Glb { problem });
    }
    let mut chunks = Chunks { rest: &bytes[HEADER_BYTES..stated] };
    let json = match chunks.next_chunk()? {
        Some((kind, json)) if kind == JSON_CHUNK => json,
        _ => return Err(ImportError::Glb { problem: "its first chunk is not JSON".to_owned() }),
    };
    let mut bin = None;
    while let Some((kind, body)) = chunks.next_chunk()? {
        if kind == BIN_CHUNK && bin.is_none() {
            bin = Some(body);
        }
    }
    Ok(Glb { json, bin })
}

/// A GLB of the two parts.
pub(super) fn joined(mut json: Vec<u8>, bin: &[u8]) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    let bin_bytes = bin.len().next_multiple_of(4);
    let has_bin = bin_bytes > 0;
    let total = HEADER_BYTES
        + CHUNK_HEADER_BYTES
        + json.len()
        + usize::from(has_bin) * (CHUNK_HEADER_BYTES + bin_bytes);
    let mut glb = Vec::with_capacity(total);
    glb.extend_from_slice(MAGIC);
    let number = |glb: &mut Vec<u8>, number: usize| glb.extend((number as u32).to_le_bytes());
    number(&mut glb, 2);
    number(&mut glb, total);
    number(&mut glb, json.len());
    glb.extend_from_slice(JSON_CHUNK);
    glb.append(&mut json);
    if has_bin {
        number(&mut glb, bin_bytes);
        glb.extend_from_slice(BIN_CHUNK);
        glb.extend_from_slice(bin);
        glb.resize(total, 0);
    }
    glb
}

/// A chunk's type and body.
type Chunk<'a> = (&'a [u8], &'a [u8]);

struct Chunks<'a> {
    rest: &'a [u8],
}

impl<'a> Chunks<'a> {
    fn next_chunk(&mut self) -> Result<Option<Chunk<'a>>> {
        // Fewer bytes than a chunk header are padding that some exporters leave.
        if self.rest.len() < CHUNK_HEADER_BYTES {
            return Ok(None);
        }
        let length = read_u32(self.rest, 0)? as usize;
        let (header, body) = self.rest.split_at(CHUNK_HEADER_BYTES);
        if length > body.len() {
            let problem = format!("a chunk states {length} bytes and {} are left", body.len());
            return Err(ImportError::Glb { problem });
        }
        let (body, rest) = body.split_at(length);
        self.rest = rest;
        Ok(Some((&header[4..], body)))
    }
}

fn read_u32(bytes: &[u8], offset: usize) -> Result<u32> {
    match bytes.get(offset..offset + 4) {
        Some(&[a, b, c, d]) => Ok(u32::from_le_bytes([a, b, c, d])),
        _ => Err(ImportError::Glb { problem: "it ends inside its header".to_owned() }),
    }
}
