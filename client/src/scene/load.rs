//! Fetches and decodes chunks.

use std::error::Error;
use std::sync::{Mutex, PoisonError};

use lightkiln_proto::chunk;
use lightkiln_proto::content::Geometry;
use lightkiln_proto::manifest::{GEOMETRY, Manifest, TEXTURES};

use super::Texture;
use crate::error::{ClientError, Result};
use crate::fetch::{Source, fetch_all};

/// Reason why a chunk does not decode.
type Reason = Box<dyn Error + Send + Sync>;

/// Geometry and textures of a manifest.
pub(super) fn scene_chunks(source: &Source, manifest: &Manifest) -> Result<(Vec<Geometry>, Vec<Texture>)> {
    let geometry = decoded(source, manifest, GEOMETRY, |bytes| Ok(chunk::decode_geometry(bytes)?))?;
    let textures = decoded(source, manifest, TEXTURES, |bytes| {
        Ok(Texture::decode(&chunk::decode_texture(bytes)?.bytes)?)
    })?;
    Ok((geometry, textures))
}

/// Fetches the chunks of a role and decodes each as it lands; results in the manifest's order.
pub fn decoded<T: Send>(
    source: &Source,
    manifest: &Manifest,
    role: &'static str,
    decode: impl Fn(&[u8]) -> std::result::Result<T, Reason> + Sync,
) -> Result<Vec<T>> {
    let chunks = manifest.chunks(role);
    let slots: Vec<Mutex<Option<T>>> = chunks.iter().map(|_| Mutex::new(None)).collect();
    fetch_all(source, chunks, |index, bytes| {
        let digest = chunks[index].digest;
        let value = decode(&bytes).map_err(|source| ClientError::Chunk { digest, role, source })?;
        *slots[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(value);
        Ok(())
    })?;
    let values = slots.into_iter().map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    Ok(values.flatten().collect())
}
