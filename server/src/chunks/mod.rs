//! Stored bytes, named by their blake3 digest: scenes, artefacts, chunks, manifests and reports alike.
//!
//! Bytes are checked against their digest before they are stored, and whenever all of them are read; a range cannot be.
//! They never change.

mod objects;
mod s3;

use std::ops::Range;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use thiserror::Error;

pub use objects::ObjectChunks;

/// Why bytes could not be stored or read.
#[derive(Debug, Error)]
pub enum ChunkError {
    /// The bytes are not those of the digest.
    #[error("the bytes given for {wanted} have the digest {found}")]
    DigestMismatch {
        /// Digest in the call.
        wanted: Digest,
        /// Digest of the bytes.
        found: Digest,
    },
    /// More bytes than may be stored under one digest.
    #[error("more than {limit} bytes")]
    TooLarge {
        /// Limit in bytes.
        limit: u64,
    },
    /// No such bytes.
    #[error("there is no chunk {digest}")]
    NotFound {
        /// What was asked for.
        digest: Digest,
    },
    /// The bytes stored under the digest are others.
    #[error("the stored bytes of chunk {digest} are damaged")]
    Damaged {
        /// Whose bytes.
        digest: Digest,
    },
    /// The bytes stopped coming.
    #[error("the upload broke off")]
    Broken(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// No room.
    #[error("no room left for chunks")]
    Full(#[source] object_store::Error),
    /// The storage does not answer as it should.
    #[error("the chunk store does not answer")]
    Unavailable(#[source] object_store::Error),
}

impl ChunkError {
    /// The problem that a caller sees.
    pub fn code(&self) -> ProblemCode {
        match self {
            Self::DigestMismatch { .. } => ProblemCode::DigestMismatch,
            Self::TooLarge { .. } => ProblemCode::TooLarge,
            Self::NotFound { .. } => ProblemCode::NotFound,
            Self::Damaged { .. } => ProblemCode::Internal,
            Self::Broken(_) => ProblemCode::BadRequest,
            Self::Full(_) => ProblemCode::StorageFull,
            Self::Unavailable(_) => ProblemCode::Unavailable,
        }
    }
}

/// What became of bytes to store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// False when they were there already.
    pub is_new: bool,
    /// Their length.
    pub bytes: u64,
}

/// Bytes as they arrive or leave.
pub type ByteStream<E = ChunkError> = BoxStream<'static, Result<Bytes, E>>;

/// Where bytes are kept.
#[async_trait]
pub trait ChunkStore: Send + Sync {
    /// Stores bytes that are at hand.
    async fn put_if_absent(&self, digest: Digest, bytes: Bytes) -> Result<Stored, ChunkError>;

    /// Stores bytes as they arrive, at most `limit` of them; only a few MiB are in memory at a time.
    ///
    /// Nothing is stored unless all came and their digest is right. Bytes that are stored already are read all the same.
    async fn put_stream(&self, digest: Digest, bytes: ByteStream, limit: u64) -> Result<Stored, ChunkError>;

    /// Reads all of a chunk into memory; refuses those longer than `limit`.
    async fn get(&self, digest: Digest, limit: u64) -> Result<Bytes, ChunkError>;

    /// Reads a range, which must lie within the chunk, as it comes. When it is the whole chunk and its bytes are damaged,
    /// the stream ends in an error before it is complete.
    async fn get_range(&self, digest: Digest, range: Range<u64>) -> Result<ByteStream, ChunkError>;

    /// Length of a chunk, or none if it is not there.
    async fn head(&self, digest: Digest) -> Result<Option<u64>, ChunkError>;

    /// Removes a chunk, if it is there.
    async fn delete(&self, digest: Digest) -> Result<(), ChunkError>;

    /// All chunks and their lengths, in no particular order.
    fn list(&self) -> BoxStream<'static, Result<(Digest, u64), ChunkError>>;
}
