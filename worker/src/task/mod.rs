//! A task as its runner sees it: source of inputs, outputs, errors, progress. Bake maths sees this module and nothing of HTTP, files or clocks.

pub mod artefact;
mod context;
mod local;
mod memory_cache;
mod progress;

use std::collections::BTreeMap;
use std::error::Error as StdError;
use std::sync::Arc;

use lightkiln_proto::api::Blame;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use thiserror::Error;

pub use context::{Context, params, results_of};
pub use local::{LocalRun, Shelf};
pub use memory_cache::MemoryCache;
pub use progress::{Cancelled, Progress};

/// Runs tasks of the kinds that it names. Pure but for its inputs: the same task gives the same artefacts and plan.
pub trait TaskRunner: Send + Sync {
    /// Task kinds that it knows, as they stand on the wire.
    fn kinds(&self) -> Vec<String>;

    /// Runs one task to its end, on the calling thread and its rayon pool.
    ///
    /// `inputs` are the task's inputs, resolved and in the task's order; their bytes come from `source`. `alike` are the outputs
    /// of tasks alike that were done before, newest first: they may save work and change no result.
    fn run(
        &self,
        task: &TaskSpec,
        inputs: &[Artefact],
        alike: &[Vec<Artefact>],
        source: &dyn ArtefactSource,
        memory: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError>;
}

/// Gives the bytes of stored artefacts, checked against their digest.
pub trait ArtefactSource: Send + Sync {
    /// The bytes whose blake3 digest is `digest`.
    fn get(&self, digest: Digest) -> Result<Arc<Vec<u8>>, FetchError>;

    /// Errs with [`FetchError::NotFound`] unless the artefact is stored where others can fetch it.
    fn require(&self, artefact: &Artefact) -> Result<(), FetchError> {
        self.get(artefact.digest).map(drop)
    }

    /// As [`Self::require`], for each of them.
    fn require_all(&self, artefacts: &[&Artefact]) -> Result<(), FetchError> {
        artefacts.iter().try_for_each(|artefact| self.require(artefact))
    }

    /// Brings the bytes of artefacts near, of which each will be asked for: where they are far away, they do not come one by one.
    fn bring(&self, _: &[Digest]) -> Result<(), FetchError> {
        Ok(())
    }
}

/// Outputs of a finished task, before they are stored.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TaskOutput {
    /// Name inside the task and bytes; a pure function of the task's key.
    pub artefacts: Vec<(String, Vec<u8>)>,
    /// Tasks to add to the bake; a pure function of the task's key.
    pub plan: Vec<TaskSpec>,
    /// Counters for people. The runtime adds `secs`, and rays by kind, where they are absent.
    pub counters: BTreeMap<String, f64>,
    /// Word for people about how it came about.
    pub note: String,
}

/// The bytes of an artefact could not be had.
#[derive(Debug, Error)]
pub enum FetchError {
    /// Nobody has it.
    #[error("artefact {digest} is not in the store; submit the bake again so that it is made anew")]
    NotFound {
        /// Digest asked for.
        digest: Digest,
    },
    /// It came with other bytes than its digest says, more than once.
    #[error("artefact {digest} arrived damaged each time it was fetched")]
    Corrupt {
        /// Digest asked for.
        digest: Digest,
    },
    /// The store does not answer.
    #[error("artefact {digest} could not be fetched")]
    Unavailable {
        /// Digest asked for.
        digest: Digest,
        /// Why.
        #[source]
        source: Box<dyn StdError + Send + Sync>,
    },
    /// The task was given up meanwhile.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A task ended without a result.
#[derive(Debug, Error)]
pub enum TaskError {
    /// Input that cannot be baked, on this worker or any other.
    #[error("{what}")]
    BadInput {
        /// Fault, place and remedy.
        what: String,
        /// The cause, if another error was.
        #[source]
        source: Option<Box<dyn StdError + Send + Sync>>,
    },
    /// The runner does not know the kind of task.
    #[error("this worker cannot run tasks of kind '{kind}'; update it to the server's version")]
    UnknownKind {
        /// The kind.
        kind: String,
    },
    /// The task was given up because its lease or bake is gone.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// An input could not be had.
    #[error("an input could not be had")]
    Fetch(#[source] FetchError),
    /// The code that ran it panicked: a fault of Lightkiln's own.
    #[error("the task's code panicked: {message}; please report it with this message")]
    Panicked {
        /// The panic's message.
        message: String,
    },
    /// This worker lacks a resource of the task's (memory, disk, threads).
    #[error("the worker has not enough {resource} for this task")]
    Exhausted {
        /// Resource that ran out.
        resource: &'static str,
        /// The cause, if another error was.
        #[source]
        source: Option<Box<dyn StdError + Send + Sync>>,
    },
}

impl From<FetchError> for TaskError {
    fn from(error: FetchError) -> Self {
        match error {
            FetchError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            error => Self::Fetch(error),
        }
    }
}

impl TaskError {
    /// Bad input in words of its own.
    pub fn bad_input(what: impl Into<String>) -> Self {
        Self::BadInput { what: what.into(), source: None }
    }

    /// Bad input found by another error: `what` says the place, `source` the fault.
    pub fn bad_input_from(
        what: impl Into<String>,
        source: impl Into<Box<dyn StdError + Send + Sync>>,
    ) -> Self {
        Self::BadInput { what: what.into(), source: Some(source.into()) }
    }

    /// Who is to blame; a cancelled task is nobody's fault and is released rather than failed.
    pub fn blame(&self) -> Blame {
        match self {
            Self::BadInput { .. } => Blame::Task,
            Self::UnknownKind { .. }
            | Self::Cancelled(_)
            | Self::Fetch(_)
            | Self::Panicked { .. }
            | Self::Exhausted { .. } => Blame::Worker,
        }
    }
}

/// The input of that name.
///
/// Errors with [`TaskError::BadInput`] when the task has none: its plan was made by other code.
pub fn input<'a>(inputs: &'a [Artefact], name: &str) -> Result<&'a Artefact, TaskError> {
    inputs
        .iter()
        .find(|artefact| artefact.name == name)
        .ok_or_else(|| TaskError::bad_input(format!("the task has no input named '{name}'")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_bad_input_is_blamed_on_the_task() {
        let digest = Digest::of(b"x");
        assert_eq!(TaskError::bad_input("no triangles").blame(), Blame::Task);
        assert_eq!(TaskError::from(FetchError::NotFound { digest }).blame(), Blame::Worker);
        assert_eq!(TaskError::Exhausted { resource: "memory", source: None }.blame(), Blame::Worker);
    }

    #[test]
    fn cancelled_fetch_is_a_cancelled_task() {
        let error = TaskError::from(FetchError::Cancelled(Cancelled));
        assert!(matches!(error, TaskError::Cancelled(_)), "{error}");
    }

    #[test]
    fn missing_input_is_named() {
        let error = input(&[], "import/scene").unwrap_err();
        assert!(error.to_string().contains("import/scene"), "{error}");
    }
}
