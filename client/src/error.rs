//! The client's errors: each says the fault, its place, and the way out.

use std::io;
use std::path::PathBuf;

use lightkiln_http::CallError;
use lightkiln_proto::api::BakeState;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::ManifestError;
use lightkiln_proto::problem::RetryClass;
use thiserror::Error;

/// Result of the client's calls.
pub type Result<T> = std::result::Result<T, ClientError>;

/// The client's one error.
#[derive(Debug, Error)]
pub enum ClientError {
    /// A server cannot be called, or gave no answer of use.
    #[error(transparent)]
    Call(#[from] CallError),
    /// A path that cannot be a source, or a server that cannot be one any more.
    #[error("'{text}' {problem}")]
    Source {
        /// Text given.
        text: String,
        /// Fault and way out.
        problem: String,
    },
    /// A bake that was followed, and that ended without all of its light.
    #[error("bake {bake} {problem}")]
    Ended {
        /// The bake's id.
        bake: String,
        /// The state that it ended in; none of one that was deleted.
        state: Option<BakeState>,
        /// End and way out.
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
        /// Name of the thing.
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
        /// Source of the bytes.
        place: String,
        /// Digest asked for.
        wanted: Digest,
        /// Digest of the bytes.
        got: Digest,
    },
    /// First bytes of a chunk that are not those which its directory lists.
    #[error(
        "{place}: the first {bytes} bytes of chunk {digest} are none of its layers: they are damaged or end early; fetch them again"
    )]
    WrongPrefix {
        /// Source of the bytes.
        place: String,
        /// The chunk.
        digest: Digest,
        /// Bytes that came.
        bytes: u64,
    },
    /// Text that should be JSON of a known shape.
    #[error("{place} is malformed")]
    Json {
        /// Its source.
        place: String,
        /// Why.
        #[source]
        source: serde_json::Error,
    },
    /// A manifest that cannot be used.
    #[error("{place} cannot be used")]
    Manifest {
        /// Its source.
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
    /// Manifest and chunks contradict each other or exceed a limit.
    #[error("the bake is inconsistent: {place}: {problem}; bake it again")]
    Inconsistent {
        /// Manifest entry or chunk.
        place: String,
        /// The contradiction.
        problem: String,
    },
    /// An object whose meshes cannot be made at a time.
    #[error("object '{name}' cannot be drawn")]
    Object {
        /// Its name.
        name: String,
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A camera, light or size given by hand that cannot be used.
    #[error("{what}: {problem}")]
    Argument {
        /// The argument as given.
        what: String,
        /// Fault, and an example of the right form.
        problem: String,
    },
    /// The graphics adapter is absent or cannot hold the bake.
    #[error("no picture by the graphics adapter: {problem}; the processor can draw it, slower")]
    Adapter {
        /// Why.
        problem: String,
    },
    /// The graphics adapter has no room for a bake; it may have for less of its light.
    #[error(
        "no room on the graphics adapter: {problem}; it takes less with fewer or smaller shadow maps and pictures, or the processor draws it (--backend cpu)"
    )]
    AdapterFull {
        /// Buffer or texture that there is no room for.
        problem: String,
    },
    /// There is no window.
    #[error("no window: {problem}; 'kiln preview' draws pictures without one")]
    Window {
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
            Self::Call(error) => error.retry_class(),
            Self::Source { .. }
            | Self::Ended { .. }
            | Self::File { .. }
            | Self::TooLarge { .. }
            | Self::WrongDigest { .. }
            | Self::WrongPrefix { .. }
            | Self::Json { .. }
            | Self::Manifest { .. }
            | Self::Chunk { .. }
            | Self::Inconsistent { .. }
            | Self::Argument { .. }
            | Self::Adapter { .. }
            | Self::AdapterFull { .. }
            | Self::Object { .. }
            | Self::Window { .. }
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
