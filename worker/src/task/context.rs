//! Surroundings of a running task: its inputs by name, the cache of decoded values, its progress.

use std::any::Any;
use std::sync::Arc;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskSpec};
use serde::de::DeserializeOwned;

use super::{ArtefactSource, MemoryCache, Progress, TaskError, artefact, input};

/// Inputs and surroundings of a running task.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Resolved inputs in the task's order.
    pub inputs: &'a [Artefact],
    /// Outputs of tasks alike that were done before, newest first.
    pub alike: &'a [Vec<Artefact>],
    /// Bytes of stored artefacts.
    pub source: &'a dyn ArtefactSource,
    /// Values that tasks of one worker share.
    pub memory: &'a MemoryCache,
    /// Progress and cancellation.
    pub progress: &'a Progress,
}

impl Context<'_> {
    /// Bytes of the input of that name.
    pub fn bytes(&self, name: &str) -> Result<Arc<Vec<u8>>, TaskError> {
        Ok(self.source.get(self.digest(name)?)?)
    }

    /// Whether there is an input of that name.
    pub fn has(&self, name: &str) -> bool {
        self.inputs.iter().any(|artefact| artefact.name == name)
    }

    /// Digest of the input of that name.
    pub fn digest(&self, name: &str) -> Result<Digest, TaskError> {
        Ok(input(self.inputs, name)?.digest)
    }

    /// Key in memory of a value made of all inputs of these names.
    pub fn digest_of_all(&self, names: &[&str]) -> Result<Digest, TaskError> {
        let digests: Result<Vec<_>, _> = names.iter().map(|name| self.digest(name)).collect();
        Ok(Digest::of(digests?.iter().map(Digest::to_string).collect::<Vec<_>>().join(" ").as_bytes()))
    }

    /// The inputs whose names `is_wanted`, as inputs of a later task.
    pub fn as_inputs(&self, is_wanted: impl Fn(&str) -> bool) -> Vec<TaskInput> {
        let wanted = self.inputs.iter().filter(|artefact| is_wanted(&artefact.name));
        let input = |found: &Artefact| TaskInput::Artefact { name: found.name.clone(), digest: found.digest };
        wanted.map(input).collect()
    }

    /// The input of that name decoded under its magic; also gives its decoded size in bytes.
    pub fn decoded<T: DeserializeOwned>(&self, magic: &[u8; 4], name: &str) -> Result<(T, usize), TaskError> {
        artefact::decode(magic, &self.bytes(name)?)
    }

    /// As [`Context::decoded`], once per worker.
    pub fn shared<T>(&self, magic: &[u8; 4], name: &str) -> Result<Arc<T>, TaskError>
    where
        T: DeserializeOwned + Any + Send + Sync,
    {
        self.memory.get_or_insert(self.digest(name)?, || self.decoded(magic, name))
    }
}

/// Reads a task's parameters.
///
/// Errors with [`TaskError::BadInput`] when they are not of this form: the plan was made by other code.
pub fn params<T: DeserializeOwned>(task: &TaskSpec) -> Result<T, TaskError> {
    T::deserialize(&task.params).map_err(|error| {
        TaskError::bad_input_from(
            format!("the parameters of '{} {}' cannot be read", task.kind, task.label),
            error,
        )
    })
}

/// All results of planned tasks as inputs of one that follows them: of `cluster 3`, outputs `cluster/3/…`.
pub fn results_of(plan: &[TaskSpec]) -> Vec<TaskInput> {
    let input = |task: &TaskSpec| TaskInput::Task { name: task.label.replace(' ', "/"), key: task.key };
    plan.iter().map(input).collect()
}
