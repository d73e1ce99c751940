//! Fetches and decodes a bake's chunks.

use std::error::Error;
use std::sync::{Mutex, PoisonError};

use lightkiln_proto::chunk;
use lightkiln_proto::manifest::ChunkRef;

use super::{Contents, LoadedBake, Texture};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, fetch_all};

/// Why a chunk does not decode.
type Reason = Box<dyn Error + Send + Sync>;

impl LoadedBake {
    /// Fetches, verifies and decodes every chunk of a bake.
    pub fn load(source: &Source) -> Result<Self> {
        let (_, manifest) = source.manifest()?;
        let reference = |digest, bytes| ChunkRef { digest, bytes };
        let clusters: Vec<ChunkRef> =
            manifest.clusters.iter().map(|cluster| reference(cluster.digest, cluster.bytes)).collect();
        let contents = Contents {
            clusters: decoded(source, &clusters, "cluster", |bytes| Ok(chunk::decode_cluster(bytes)?))?,
            probes: decoded(source, &manifest.probes, "probes", |bytes| {
                Ok(chunk::decode_probe_batch(bytes)?)
            })?,
            patches: decoded(source, &manifest.patches, "patches", |bytes| {
                Ok(chunk::decode_patches(bytes)?)
            })?,
            geometry: decoded(source, &manifest.geometry, "geometry", |bytes| {
                Ok(chunk::decode_geometry(bytes)?)
            })?,
            textures: decoded(source, &manifest.textures, "texture", |bytes| {
                Ok(Texture::decode(&chunk::decode_texture(bytes)?.bytes)?)
            })?,
        };
        Self::assemble(manifest, contents)
    }
}

/// Fetches `chunks` and decodes each as it lands; results in their order.
fn decoded<T: Send>(
    source: &Source,
    chunks: &[ChunkRef],
    kind: &'static str,
    decode: impl Fn(&[u8]) -> std::result::Result<T, Reason> + Sync,
) -> Result<Vec<T>> {
    let slots: Vec<Mutex<Option<T>>> = chunks.iter().map(|_| Mutex::new(None)).collect();
    fetch_all(source, chunks, |index, bytes| {
        let digest = chunks[index].digest;
        let value = decode(&bytes).map_err(|source| ClientError::Chunk { digest, kind, source })?;
        *slots[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(value);
        Ok(())
    })?;
    let values = slots.into_iter().map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    Ok(values.flatten().collect())
}
