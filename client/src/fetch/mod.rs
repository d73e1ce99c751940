//! Sources of bakes: bundles on disk and servers. Digests are verified, limits are checked.

pub mod api;
mod bundle;
mod following;
mod layers;
mod parallel;
#[cfg(test)]
mod tests;

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lightkiln_http::DiskCache;
use lightkiln_proto::api::MAX_CHUNK_BYTES;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{self, ChunkRef, DIRECTORY, Manifest, ManifestError};

use crate::error::{ClientError, Result};

pub use api::ApiClient;
pub use bundle::{Downloaded, chunk_refs, decoded, decoded_chunks, download_bundle, write_atomically};
pub use following::{Following, News, PATIENCE, check_outline, is_lost, outline_of};
pub use layers::{Came, Layers, decoded_layers};
pub(crate) use parallel::parallel;

/// The manifest's file in a bundle.
pub const MANIFEST_FILE: &str = "manifest.json";
/// The folder of chunks in a bundle.
pub const CHUNKS_FOLDER: &str = "chunks";
/// The report's file in a bundle; the only one that is not a pure function of scene and settings.
pub const REPORT_FILE: &str = "report.json";

/// Source of a bake.
#[derive(Clone)]
pub enum Source {
    /// A bundle: `manifest.json` and `chunks/<digest>`.
    Bundle(PathBuf),
    /// A bake of a server.
    Server {
        /// The server.
        client: Arc<ApiClient>,
        /// The bake's id there.
        bake: String,
        /// Where its chunks are kept for the next time.
        cache: Option<Arc<DiskCache>>,
    },
}

impl Source {
    /// A bundle folder; its manifest must exist.
    pub fn bundle(folder: impl Into<PathBuf>) -> Result<Self> {
        let folder = folder.into();
        if folder.join(MANIFEST_FILE).is_file() {
            return Ok(Self::Bundle(folder));
        }
        let text = folder.display().to_string();
        let problem = format!("holds no {MANIFEST_FILE}; give the folder that 'kiln bake --out' wrote");
        Err(ClientError::Source { text, problem })
    }

    /// A bake of a server, by the bake's id.
    pub fn server(client: ApiClient, bake: impl Into<String>) -> Self {
        Self::Server { client: Arc::new(client), bake: bake.into(), cache: None }
    }

    /// The same; chunks of a server are kept in a cache and taken from there. Chunks are named by their bytes, so none is ever stale.
    #[must_use]
    pub fn with_cache(self, chunks: DiskCache) -> Self {
        match self {
            Self::Server { client, bake, .. } => Self::Server { client, bake, cache: Some(Arc::new(chunks)) },
            bundle @ Self::Bundle(_) => bundle,
        }
    }

    /// The manifest, as bytes, and decoded with its directory.
    pub fn manifest(&self) -> Result<(Vec<u8>, Manifest)> {
        let (place, bytes) = match self {
            Self::Bundle(folder) => {
                let path = folder.join(MANIFEST_FILE);
                (path.display().to_string(), read_limited(&path, manifest::MAX_BYTES as u64)?)
            }
            Self::Server { client, bake, .. } => (format!("manifest of bake {bake}"), client.manifest(bake)?),
        };
        let manifest = parsed(&place, Manifest::from_json(&bytes))?;
        let pages = decoded(self, &manifest, DIRECTORY, |page| Ok(page.to_vec()))?;
        let manifest = parsed(&place, manifest.with_directory(&pages))?;
        Ok((bytes, manifest))
    }

    /// A chunk's bytes, verified.
    pub fn chunk(&self, chunk: &ChunkRef) -> Result<Vec<u8>> {
        let limit = chunk_limit(chunk)?;
        match self {
            Self::Bundle(folder) => {
                let path = chunk_path(folder, chunk.digest);
                let bytes = read_limited(&path, limit)?;
                verify(&path.display().to_string(), chunk.digest, bytes)
            }
            Self::Server { client, cache: None, .. } => client.chunk(chunk.digest, limit),
            Self::Server { client, cache: Some(cache), .. } => cached(cache, client, chunk, limit),
        }
    }
}

/// Path of a chunk in a bundle.
pub fn chunk_path(folder: &Path, digest: Digest) -> PathBuf {
    folder.join(CHUNKS_FOLDER).join(digest.to_string())
}

/// Most bytes of a chunk: its length in the manifest, which must be at most [`MAX_CHUNK_BYTES`].
fn chunk_limit(chunk: &ChunkRef) -> Result<u64> {
    if chunk.bytes <= MAX_CHUNK_BYTES {
        return Ok(chunk.bytes);
    }
    let what = format!("chunk {}", chunk.digest);
    Err(ClientError::TooLarge { what, bytes: chunk.bytes, limit: MAX_CHUNK_BYTES })
}

/// A chunk's bytes from the cache, else from the server and into the cache.
fn cached(cache: &DiskCache, client: &ApiClient, chunk: &ChunkRef, limit: u64) -> Result<Vec<u8>> {
    if let Some(bytes) = cache.get(chunk.digest).filter(|bytes| bytes.len() as u64 <= limit) {
        return Ok(bytes);
    }
    let bytes = client.chunk(chunk.digest, limit)?;
    note_unkept(cache.put(chunk.digest, &bytes));
    Ok(bytes)
}

/// A picture is worth more than its cache.
fn note_unkept(kept: std::io::Result<()>) {
    if let Err(error) = kept {
        tracing::warn!(%error, "a fetched chunk cannot be kept for the next time");
    }
}

fn verify(place: &str, wanted: Digest, bytes: Vec<u8>) -> Result<Vec<u8>> {
    let got = Digest::of(&bytes);
    if got == wanted {
        return Ok(bytes);
    }
    Err(ClientError::WrongDigest { place: place.to_owned(), wanted, got })
}

/// Reads a file of at most `limit` bytes.
pub(crate) fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let failed = |source| ClientError::File { action: "read", path: path.to_owned(), source };
    let mut file = fs::File::open(path).map_err(failed)?;
    let bytes = file.metadata().map_err(failed)?.len();
    if bytes > limit {
        return Err(ClientError::TooLarge { what: path.display().to_string(), bytes, limit });
    }
    let mut content = Vec::with_capacity(usize::try_from(bytes).unwrap_or(0));
    file.by_ref().take(limit).read_to_end(&mut content).map_err(failed)?;
    Ok(content)
}

fn parsed(place: &str, manifest: std::result::Result<Manifest, ManifestError>) -> Result<Manifest> {
    manifest.map_err(|error| match error {
        ManifestError::Json(source) => ClientError::Json { place: place.to_owned(), source },
        source => ClientError::Manifest { place: place.to_owned(), source },
    })
}
