//! Downloads a whole bake into a bundle folder: resumable, verified, atomic per file, manifest last.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{ChunkRef, Manifest};

use super::parallel::{for_each_parallel, parallel};
use super::{CHUNKS_FOLDER, MANIFEST_FILE, Source, chunk_path, read_limited};
use crate::error::{ClientError, Result};

/// Reason why a chunk does not decode.
type Reason = Box<dyn Error + Send + Sync>;

/// Result of a download.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Downloaded {
    /// Chunks fetched now.
    pub fetched: u64,
    /// Their bytes.
    pub fetched_bytes: u64,
    /// Chunks that were there already, right ones.
    pub kept: u64,
}

/// Every chunk that a manifest names, once, ascending by digest.
pub fn chunk_refs(manifest: &Manifest) -> Vec<ChunkRef> {
    let all = manifest.chunks.values().flatten().cloned();
    let by_digest: BTreeMap<Digest, ChunkRef> = all.map(|chunk| (chunk.digest, chunk)).collect();
    by_digest.into_values().collect()
}

/// Fetches the chunks of a role and decodes each as it lands; results in the manifest's order.
pub fn decoded<T: Send>(
    source: &Source,
    manifest: &Manifest,
    role: &'static str,
    decode: impl Fn(&[u8]) -> std::result::Result<T, Reason> + Sync,
) -> Result<Vec<T>> {
    decoded_chunks(source, manifest.chunks(role), role, decode)
}

/// Fetches some chunks of a role and decodes each as it lands; results in their order.
pub fn decoded_chunks<T: Send>(
    source: &Source,
    chunks: &[ChunkRef],
    role: &'static str,
    decode: impl Fn(&[u8]) -> std::result::Result<T, Reason> + Sync,
) -> Result<Vec<T>> {
    let (values, ended) = parallel(source, &sizes_of(chunks), |index| {
        let digest = chunks[index].digest;
        let bytes = source.chunk(&chunks[index])?;
        decode(&bytes).map_err(|source| ClientError::Chunk { digest, role, source })
    });
    ended?;
    Ok(values.into_iter().flatten().collect())
}

fn sizes_of(chunks: &[ChunkRef]) -> Vec<u64> {
    chunks.iter().map(|chunk| chunk.bytes).collect()
}

/// Writes the bake into `folder`. Chunks that are there and right are kept; the manifest is written last, so a
/// folder with a manifest is whole.
pub fn download_bundle(source: &Source, folder: &Path) -> Result<(Manifest, Downloaded)> {
    let (manifest_bytes, manifest) = source.manifest()?;
    let chunks = chunk_refs(&manifest);
    let chunks_folder = folder.join(CHUNKS_FOLDER);
    fs::create_dir_all(&chunks_folder).map_err(|error| ClientError::File {
        action: "create",
        path: chunks_folder.clone(),
        source: error,
    })?;
    let done = Mutex::new(Downloaded::default());
    for_each_parallel(source, &sizes_of(&chunks), |index| {
        let chunk = &chunks[index];
        let path = chunk_path(folder, chunk.digest);
        let kept = is_right(&path, chunk);
        if !kept {
            write_atomically(&path, &source.chunk(chunk)?)?;
        }
        let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
        if kept {
            done.kept += 1;
        } else {
            done.fetched += 1;
            done.fetched_bytes += chunk.bytes;
        }
        Ok(())
    })?;
    write_atomically(&folder.join(MANIFEST_FILE), &manifest_bytes)?;
    Ok((manifest, done.into_inner().unwrap_or_else(PoisonError::into_inner)))
}

fn is_right(path: &Path, chunk: &ChunkRef) -> bool {
    path.is_file() && read_limited(path, chunk.bytes).is_ok_and(|bytes| Digest::of(&bytes) == chunk.digest)
}

/// Writes a file through `NAME.part-PID` beside it, so that under its own name it is whole or as it was.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let failed = |source| ClientError::File { action: "write", path: path.to_owned(), source };
    let part = path.with_extension(format!("part-{}", std::process::id()));
    let written = fs::File::create(&part)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&part, path));
    if written.is_err() {
        // Best effort: the error that matters is the one above.
        let _ = fs::remove_file(&part);
    }
    written.map_err(failed)
}
