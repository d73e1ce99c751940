//! Errors of an evaluation.

use lightkiln_proto::chunk::ChunkError;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::ManifestError;
use lightkiln_proto::relight::Inconsistent;
use thiserror::Error;

use crate::reference::LightingError;
use crate::task::{Cancelled, TaskError};

/// An evaluation that cannot be made.
#[derive(Debug, Error)]
pub enum EvaluationError {
    /// A chunk does not decode.
    #[error("chunk {digest} is damaged; fetch or bake the bundle again")]
    Chunk {
        /// Which.
        digest: Digest,
        /// Its fault.
        #[source]
        source: ChunkError,
    },
    /// A chunk could not be read.
    #[error("chunk {digest} cannot be read")]
    Missing {
        /// Which.
        digest: Digest,
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The scene is not the one that was baked.
    #[error(
        "the scene's digest is {found}, but the bundle was baked from {wanted}: give the scene as it was then"
    )]
    OtherScene {
        /// The manifest's.
        wanted: Digest,
        /// The scene's.
        found: Digest,
    },
    /// No kind of bake of this program.
    #[error("the bundle is of kind '{kind:.40}', which this program cannot evaluate")]
    UnknownKind {
        /// The manifest's.
        kind: String,
    },
    /// Its settings or body cannot be read.
    #[error("the bundle's manifest cannot be used")]
    Manifest(#[from] ManifestError),
    /// Its chunks contradict each other.
    #[error("the bundle's chunks contradict each other; bake the scene again")]
    Inconsistent(#[from] Inconsistent),
    /// Import and prepare give something else than they did for the bake.
    #[error(
        "this version of Lightkiln prepares the scene otherwise than the bundle's did ({what}): bake it again"
    )]
    OtherStage {
        /// The first difference.
        what: String,
    },
    /// Import or prepare failed.
    #[error("the scene cannot be prepared")]
    Prepare(#[source] TaskError),
    /// A light that makes no sense, or can light nothing.
    #[error(transparent)]
    Lighting(#[from] LightingError),
    /// The file of lights cannot be read.
    #[error("the file of lights is wrong: {problem}")]
    LightFile {
        /// Fault and place.
        problem: String,
    },
    /// Nothing is left to be measured.
    #[error("no light is left to evaluate the bake with: {problem}")]
    NoLight {
        /// Why.
        problem: String,
    },
    /// The client cannot light the bake.
    #[error("the client cannot light the bake")]
    Client {
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The caller gave it up.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
