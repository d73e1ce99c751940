//! Stored bytes, named by their blake3 digest: scenes, artefacts, chunks, manifests and reports alike.
//!
//! Bytes are checked against their digest before they are stored, and whenever all of them are read; a range cannot be.
//! They never change.
//!
//! **Names.** Each time that bytes are written anew they get a name of their own, digest and generation, and a name is
//! never used twice. So a removal that comes late, from a process that slept meanwhile, cannot meet bytes that were
//! stored after it. The queue's store says which generation counts ([`crate::storage`]).

mod error;
mod objects;
mod s3;

use std::ops::Range;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use lightkiln_proto::ids::Digest;

use crate::random;

pub use error::{ChunkError, Result};
pub use objects::ObjectChunks;
pub(crate) use objects::StreamCheck;

/// Name of stored bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChunkName {
    /// Digest of the bytes.
    pub digest: Digest,
    /// Tells copies that were written at different times; 0 is that of farms before generations.
    pub generation: u64,
}

impl ChunkName {
    /// A name that nobody has used.
    pub fn fresh(digest: Digest) -> Self {
        Self { digest, generation: random::generation() }
    }
}

impl From<Digest> for ChunkName {
    /// The first generation.
    fn from(digest: Digest) -> Self {
        Self { digest, generation: 0 }
    }
}

/// A chunk as a listing shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Listed {
    /// Its name.
    pub name: ChunkName,
    /// Its length.
    pub bytes: u64,
    /// When it was written by the storage's clock, Unix milliseconds.
    pub written_ms: i64,
}

/// Outcome of storing bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// False when they were there already.
    pub is_new: bool,
    /// Their length.
    pub bytes: u64,
}

/// Bytes as they arrive or leave.
pub type ByteStream<E = ChunkError> = BoxStream<'static, Result<Bytes, E>>;

/// A store of bytes.
#[async_trait]
pub trait ChunkStore: Send + Sync {
    /// Stores bytes that are at hand.
    async fn put_if_absent(&self, name: ChunkName, bytes: Bytes) -> Result<Stored>;

    /// Stores bytes as they arrive, at most `limit` of them; only a few MiB are in memory at a time.
    ///
    /// Nothing is stored unless all came and their digest is right. Bytes that are stored already are read all the same.
    async fn put_stream(&self, name: ChunkName, bytes: ByteStream, limit: u64) -> Result<Stored>;

    /// Reads all of a chunk into memory; refuses those longer than `limit`.
    async fn get(&self, name: ChunkName, limit: u64) -> Result<Bytes>;

    /// Reads a range, which must lie within the chunk, as it comes. When it is the whole chunk and its bytes are damaged,
    /// the stream ends in an error before it is complete.
    async fn get_range(&self, name: ChunkName, range: Range<u64>) -> Result<ByteStream>;

    /// Length of a chunk, or none if it is not there.
    async fn head(&self, name: ChunkName) -> Result<Option<u64>>;

    /// Removes a chunk, if it is there.
    async fn delete(&self, name: ChunkName) -> Result<()>;

    /// All chunks, in no particular order.
    fn list(&self) -> BoxStream<'static, Result<Listed>>;
}
