//! Clusters by layers: first bytes of their chunks, verified before they are decoded, of which later layers bring the rest.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use lightkiln_http::{DiskCache, Part};
use lightkiln_proto::chunk::{cluster_layers, decode_cluster, decode_cluster_prefix};
use lightkiln_proto::content::ClusterTransport;
use lightkiln_proto::manifest::{CLUSTERS, ChunkRef, ClusterRow, PrefixCheck};

use super::api::ApiClient;
use super::{Source, chunk_limit, chunk_path, note_unkept, verify};
use crate::error::{ClientError, Result};

/// Layers of a cluster's chunk as its directory lists them.
#[derive(Clone, Copy, Debug)]
pub struct Layers<'a> {
    /// Number of the cluster in the manifest.
    pub cluster: usize,
    /// Its row.
    pub row: &'a ClusterRow,
    /// Its chunk.
    pub chunk: &'a ChunkRef,
}

impl Layers<'_> {
    /// Layers; one at least.
    pub fn count(&self) -> usize {
        self.row.layers.len().max(1)
    }

    /// Bytes of the first so many layers; those of all are the chunk's.
    pub fn bytes_of(&self, layers: usize) -> u64 {
        let prefix = layers.checked_sub(1).filter(|last| *last < self.row.checks.len());
        match prefix.and_then(|last| self.row.layers.get(last)) {
            Some(layer) => layer.bytes.min(self.chunk.bytes),
            None if layers == 0 => 0,
            None => self.chunk.bytes,
        }
    }

    /// The number of layers that so many bytes are; `None` if they end amid one.
    pub fn within(&self, bytes: u64) -> Option<usize> {
        (1..=self.count()).rev().find(|&layers| self.bytes_of(layers) == bytes)
    }

    /// Whether bytes are the first ones of the chunk up to the end of a layer.
    fn are_prefix(&self, bytes: &[u8]) -> bool {
        let layers = self.within(bytes.len() as u64);
        let check =
            layers.filter(|&layers| layers < self.count()).and_then(|layers| self.row.checks.get(layers - 1));
        check.is_some_and(|check| *check == PrefixCheck::of(bytes))
    }

    /// The bytes, if they are whole layers of the chunk, or all of it.
    fn verified(&self, place: &str, bytes: Vec<u8>) -> Result<Vec<u8>> {
        if bytes.len() as u64 >= self.chunk.bytes {
            return verify(place, self.chunk.digest, bytes);
        }
        if self.are_prefix(&bytes) {
            return Ok(bytes);
        }
        let (place, digest, bytes) = (place.to_owned(), self.chunk.digest, bytes.len() as u64);
        Err(ClientError::WrongPrefix { place, digest, bytes })
    }
}

/// First layers of a chunk, verified.
#[derive(Debug)]
pub struct Came {
    /// Their bytes.
    pub bytes: Vec<u8>,
    /// The error that came before the last of those that were wanted.
    pub lost: Option<ClientError>,
}

impl From<Vec<u8>> for Came {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, lost: None }
    }
}

impl Source {
    /// First bytes of a cluster's chunk, verified: its first `wanted` layers, or more where more are at hand. `have` are layers of it
    /// that are not fetched again; those after them that came before a line was lost are given with its error.
    pub fn layers(&self, of: Layers<'_>, wanted: usize, have: &[u8]) -> Result<Came> {
        chunk_limit(of.chunk)?;
        let end = of.bytes_of(wanted);
        if have.len() as u64 >= end {
            return Ok(have.to_vec().into());
        }
        match self {
            Self::Bundle(folder) => {
                let path = chunk_path(folder, of.chunk.digest);
                let bytes = read_on(&path, have, end)?;
                of.verified(&path.display().to_string(), bytes).map(Came::from)
            }
            Self::Server { client, cache: None, .. } => fetched(client, of, have, end),
            Self::Server { client, cache: Some(cache), .. } => cached(cache, client, of, have, end),
        }
    }
}

/// Layers from the cache as far as they are there, the rest from the server and into the cache.
fn cached(cache: &DiskCache, client: &ApiClient, of: Layers<'_>, have: &[u8], end: u64) -> Result<Came> {
    let digest = of.chunk.digest;
    if let Some(whole) = cache.get(digest).filter(|bytes| bytes.len() as u64 == of.chunk.bytes) {
        return Ok(whole.into());
    }
    let kept = cache.get_prefix(digest, |bytes| of.are_prefix(bytes)).unwrap_or_default();
    let have = if kept.len() > have.len() { &kept } else { have };
    if have.len() as u64 >= end {
        return Ok(have.to_vec().into());
    }
    let came = fetched(client, of, have, end)?;
    note_unkept(match came.bytes.len() as u64 == of.chunk.bytes {
        true => cache.put(digest, &came.bytes),
        false => cache.put_prefix(digest, &came.bytes),
    });
    Ok(came)
}

/// The bytes that are there, and those after them up to `end` from the server; up to the last whole layer if it is lost amid them.
fn fetched(client: &ApiClient, of: Layers<'_>, have: &[u8], end: u64) -> Result<Came> {
    let from = have.len() as u64;
    let (Part { start, bytes }, ended) = client.chunk_part(of.chunk.digest, from..end, of.chunk.bytes);
    let mut bytes = if start == from { [have, &bytes].concat() } else { bytes };
    if let Err(error) = ended {
        let mut ends = (1..=of.count()).rev().map(|layers| of.bytes_of(layers));
        let Some(whole) = ends.find(|end| (from + 1..=bytes.len() as u64).contains(end)) else {
            return Err(error);
        };
        bytes.truncate(whole as usize);
        let bytes = of.verified(client.base(), bytes)?;
        return Ok(Came { bytes, lost: (whole < end).then_some(error) });
    }
    // A server that ignores ranges, and breaks off amid a later layer.
    if (end..of.chunk.bytes).contains(&(bytes.len() as u64)) {
        bytes.truncate(end as usize);
    }
    of.verified(client.base(), bytes).map(Came::from)
}

/// The bytes that are there, and those after them up to `end` from a file.
fn read_on(path: &Path, have: &[u8], end: u64) -> Result<Vec<u8>> {
    let failed = |source| ClientError::File { action: "read", path: path.to_owned(), source };
    let from = have.len() as u64;
    let mut file = File::open(path).map_err(failed)?;
    file.seek(SeekFrom::Start(from)).map_err(failed)?;
    let mut bytes = have.to_vec();
    file.take(end.saturating_sub(from)).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

/// Decodes the layers that verified bytes are, which must be those that the directory lists; with their number.
pub fn decoded_layers(of: Layers<'_>, bytes: &[u8]) -> Result<(ClusterTransport, usize)> {
    let Layers { cluster, row, chunk } = of;
    let undecoded = |source: lightkiln_proto::chunk::ChunkError| ClientError::Chunk {
        digest: chunk.digest,
        role: CLUSTERS,
        source: Box::new(source),
    };
    let wrong = |problem: String| Err(ClientError::inconsistent(format!("cluster {cluster}"), problem));
    let listed = cluster_layers(bytes, chunk.bytes).map_err(undecoded)?;
    if listed != row.layers {
        return wrong(format!("its directory lists layers {:?}, its chunk {listed:?}", row.layers));
    }
    let is_whole = bytes.len() as u64 == chunk.bytes;
    let (found, layers) = if is_whole {
        (decode_cluster(bytes).map_err(undecoded)?, listed.len())
    } else {
        let (found, layer) = decode_cluster_prefix(bytes, chunk.bytes).map_err(undecoded)?;
        (found, listed.iter().take_while(|listed| listed.bytes <= layer.bytes).count())
    };
    let (receivers, most) = (found.receivers.len() as u64, u64::from(row.receivers));
    if receivers > most || is_whole && receivers < most {
        return wrong(format!("its directory lists {most} receivers, {receivers} came"));
    }
    Ok((found, layers))
}
