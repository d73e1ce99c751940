//! Errors of farm stores.

use lightkiln_proto::api::BakeState;
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::problem::ProblemCode;
use thiserror::Error;

/// Result of a store's call.
pub type Result<T, E = StoreError> = std::result::Result<T, E>;

/// Why a store refused or failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// No bake of that id.
    #[error("there is no bake '{bake}'")]
    NoSuchBake {
        /// The name asked for.
        bake: String,
    },
    /// The key was used with another body.
    #[error("Idempotency-Key '{key}' was used before with another body; use a new key for a new bake")]
    IdempotencyConflict {
        /// The key.
        key: String,
    },
    /// The name of a bearer was given before.
    #[error("there is a token of '{name}' already, or was once; choose another name")]
    BearerExists {
        /// The name.
        name: String,
    },
    /// No bearer of that name.
    #[error("there is no token of '{name}'")]
    NoSuchBearer {
        /// The name asked for.
        name: String,
    },
    /// The bake's state does not allow the call.
    #[error("bake '{bake}' is {state:?} and cannot be {action}")]
    StateConflict {
        /// The bake.
        bake: String,
        /// Its state.
        state: BakeState,
        /// The change asked for, as a participle.
        action: &'static str,
    },
    /// Bytes that a bake or a result names are not stored.
    #[error("chunk {digest} is not stored; PUT /v1/chunks/{digest} first")]
    MissingChunk {
        /// The chunk.
        digest: Digest,
    },
    /// No room under the farm's quota.
    #[error(
        "no room left for chunks: {used} bytes are stored, and {wanted} more would exceed the farm's quota"
    )]
    OverQuota {
        /// Bytes stored.
        used: u64,
        /// Bytes to be stored.
        wanted: u64,
    },
    /// The tasks do not form a graph that can be run.
    #[error("the plan cannot be taken")]
    Plan(#[from] PlanError),
    /// No room on the disk that holds the state.
    #[error("no room left for the farm's state")]
    Full(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The database does not answer now.
    #[error("the farm's database does not answer")]
    Unavailable(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The database let other calls through instead of this one, again and again.
    #[error("the farm's database is too busy")]
    Contended(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// Stored state cannot be read, or was written by a newer version.
    #[error("the farm's state cannot be used: {what}")]
    Corrupt {
        /// The unusable part.
        what: String,
        /// Why.
        #[source]
        source: Option<Box<dyn std::error::Error + Send + Sync>>,
    },
}

impl StoreError {
    /// The problem that a caller sees.
    pub fn code(&self) -> ProblemCode {
        match self {
            Self::NoSuchBake { .. } | Self::NoSuchBearer { .. } => ProblemCode::NotFound,
            Self::BearerExists { .. } => ProblemCode::StateConflict,
            Self::IdempotencyConflict { .. } => ProblemCode::IdempotencyConflict,
            Self::StateConflict { .. } => ProblemCode::StateConflict,
            Self::Plan(_) => ProblemCode::BadRequest,
            Self::MissingChunk { .. } => ProblemCode::NotStored,
            Self::Full(_) | Self::OverQuota { .. } => ProblemCode::StorageFull,
            Self::Unavailable(_) | Self::Contended(_) => ProblemCode::Unavailable,
            Self::Corrupt { .. } => ProblemCode::Internal,
        }
    }
}

/// Why a list of tasks is no plan.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PlanError {
    /// Too many tasks.
    #[error("a plan holds at most {max} tasks, this one {count}")]
    TooManyTasks {
        /// Tasks given.
        count: usize,
        /// Limit.
        max: usize,
    },
    /// A text or number of a task is out of bounds.
    #[error("task {key}: {what}")]
    Field {
        /// The task.
        key: TaskKey,
        /// The fault, and the limit.
        what: String,
    },
    /// A key that is not the task's own.
    #[error(
        "task {key} must have the key {computed}, the digest of its kind, version, parameters and inputs; see whether server and \
         workers are of one version"
    )]
    WrongKey {
        /// The key given.
        key: TaskKey,
        /// The task's own.
        computed: TaskKey,
    },
    /// One key, two different tasks.
    #[error("task {key} was given before with another kind, other parameters or other inputs")]
    KeyClash {
        /// The key.
        key: TaskKey,
    },
    /// A dependency that the bake does not hold.
    #[error("a task needs task {needs}, which is neither in the plan nor in the bake")]
    UnknownDependency {
        /// The missing task.
        needs: TaskKey,
    },
}
