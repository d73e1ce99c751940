//! Errors of chunk stores.

use std::error::Error;
use std::io;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;

/// Result of a chunk store's call.
pub type Result<T, E = ChunkError> = std::result::Result<T, E>;

/// Why bytes could not be stored or read.
#[derive(Debug, thiserror::Error)]
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
        /// The chunk asked for.
        digest: Digest,
    },
    /// The bytes stored under the digest are others.
    #[error("the stored bytes of chunk {digest} are damaged")]
    Damaged {
        /// The chunk.
        digest: Digest,
    },
    /// The bytes stopped coming.
    #[error("the upload broke off")]
    Broken(#[source] Box<dyn Error + Send + Sync>),
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
            Self::Broken(_) => ProblemCode::BrokeOff,
            Self::Full(_) => ProblemCode::StorageFull,
            Self::Unavailable(_) => ProblemCode::Unavailable,
        }
    }
}

impl From<object_store::Error> for ChunkError {
    /// Tells a full disk from other trouble.
    fn from(error: object_store::Error) -> Self {
        let mut cause: Option<&(dyn Error + 'static)> = Some(&error);
        while let Some(error) = cause {
            let kind = error.downcast_ref::<io::Error>().map(io::Error::kind);
            if matches!(kind, Some(io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)) {
                break;
            }
            cause = error.source();
        }
        if cause.is_some() { Self::Full(error) } else { Self::Unavailable(error) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full_disk() -> object_store::Error {
        let source = io::Error::from(io::ErrorKind::StorageFull);
        object_store::Error::Generic { store: "test", source: Box::new(source) }
    }

    #[test]
    fn full_disk_is_told_apart() {
        assert!(matches!(full_disk().into(), ChunkError::Full(_)));
        let other = object_store::Error::Generic { store: "test", source: "other".into() };
        assert!(matches!(other.into(), ChunkError::Unavailable(_)));
    }
}
