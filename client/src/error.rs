//! Everything that can go wrong in the client: what was wrong, where, and what to do.

use std::io;
use std::path::PathBuf;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::ManifestError;
use lightkiln_proto::problem::{Problem, RetryClass};
use thiserror::Error;

/// Result of the client's calls.
pub type Result<T> = std::result::Result<T, ClientError>;

/// The client's one error.
#[derive(Debug, Error)]
pub enum ClientError {
    /// The server answered with a problem (RFC 9457).
    #[error("{call}: the server says {}: {}", .problem.title, .problem.detail)]
    Server {
        /// Method and URL.
        call: String,
        /// What the server said.
        problem: Box<Problem>,
    },
    /// The server answered with an error that is no problem document.
    #[error("{call}: answered with status {status}; is this a Lightkiln server, and is the URL right?")]
    Status {
        /// Method and URL.
        call: String,
        /// HTTP status.
        status: u16,
    },
    /// The server was not reached, or the connection broke.
    #[error("{call}: no answer; check that the server runs and that the URL is right")]
    Network {
        /// Method and URL.
        call: String,
        /// Why.
        #[source]
        source: Box<ureq::Error>,
    },
    /// A call was stopped by its owner while it waited.
    #[error("{call}: stopped")]
    Stopped {
        /// Method and URL, or what was waited for.
        call: String,
    },
    /// A URL or a path that cannot be a source.
    #[error("'{text}' {problem}")]
    Source {
        /// What was given.
        text: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// A file could not be read or written.
    #[error("cannot {action} {path}", path = .path.display())]
    File {
        /// `read`, `write`, …
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
    /// Something is larger than its limit.
    #[error("{what} has {bytes} bytes, more than the {limit} that are read; it is broken or not ours")]
    TooLarge {
        /// What it is.
        what: String,
        /// Its length.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// Bytes whose digest is not the one asked for.
    #[error(
        "{place}: chunk {wanted} holds other bytes (their digest is {got}); delete it and fetch it again"
    )]
    WrongDigest {
        /// Where the bytes came from.
        place: String,
        /// Digest asked for.
        wanted: Digest,
        /// Digest of the bytes.
        got: Digest,
    },
    /// Text that should be JSON of a known shape.
    #[error("{place} is not what it should be")]
    Json {
        /// Where it came from.
        place: String,
        /// Why.
        #[source]
        source: serde_json::Error,
    },
    /// A manifest that cannot be used.
    #[error("{place} cannot be used")]
    Manifest {
        /// Where it came from.
        place: String,
        /// Why.
        #[source]
        source: ManifestError,
    },
    /// A chunk that does not decode.
    #[error("chunk {digest} of role '{role}' does not decode; fetch or bake it again")]
    Chunk {
        /// Its digest.
        digest: Digest,
        /// Its role in the manifest.
        role: &'static str,
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Manifest and chunks contradict each other, or exceed a limit.
    #[error("the bake is inconsistent: {place}: {problem}; bake it again")]
    Inconsistent {
        /// Manifest entry or chunk.
        place: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A camera, light or size given by hand that cannot be used.
    #[error("{what}: {problem}")]
    Argument {
        /// The argument as given.
        what: String,
        /// What is wrong and how it should look.
        problem: String,
    },
    /// The graphics adapter is absent or cannot hold the bake.
    #[error("no picture by the graphics adapter: {problem}; the processor can draw it, slower")]
    Adapter {
        /// Why.
        problem: String,
    },
    /// The picture could not be encoded.
    #[error("cannot write the picture {path}", path = .path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: Box<image::ImageError>,
    },
}

impl ClientError {
    /// Whether the same call may succeed later.
    pub fn retry_class(&self) -> RetryClass {
        match self {
            Self::Server { problem, .. } => problem.code.row().1,
            Self::Status { status: 408 | 425 | 429 | 500 | 502 | 503 | 504 | 507, .. } => RetryClass::Backoff,
            Self::Network { source, .. } => network_retry_class(source),
            Self::Status { .. }
            | Self::Stopped { .. }
            | Self::Source { .. }
            | Self::File { .. }
            | Self::TooLarge { .. }
            | Self::WrongDigest { .. }
            | Self::Json { .. }
            | Self::Manifest { .. }
            | Self::Chunk { .. }
            | Self::Inconsistent { .. }
            | Self::Argument { .. }
            | Self::Adapter { .. }
            | Self::Picture { .. } => RetryClass::Never,
        }
    }

    /// A contradiction between a manifest and its chunks.
    pub fn inconsistent(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Inconsistent { place: place.into(), problem: problem.into() }
    }
}

impl From<ManifestError> for ClientError {
    fn from(source: ManifestError) -> Self {
        Self::Manifest { place: "the manifest".to_owned(), source }
    }
}

fn network_retry_class(error: &ureq::Error) -> RetryClass {
    match error {
        ureq::Error::Io(_)
        | ureq::Error::Timeout(_)
        | ureq::Error::HostNotFound
        | ureq::Error::ConnectionFailed
        | ureq::Error::Protocol(_) => RetryClass::Backoff,
        _ => RetryClass::Never,
    }
}
