//! Kinds of bake: one folder each, and a table that runner and evaluation ask. No other room names a kind.

pub mod captured;
pub mod cloud;
pub mod field;
pub mod grid;
pub mod prt;
pub mod sh;
pub mod transfer;
pub mod voxels;

use std::collections::BTreeMap;
use std::sync::Arc;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_proto::kinds::SceneTask;
use lightkiln_proto::manifest::Manifest;
use serde::{Deserialize, Serialize};

use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::task::{
    ArtefactSource, Context, LocalRun, MemoryCache, Progress, TaskError, TaskOutput, TaskRunner,
};
use crate::{draw, lightmap, patches, scene, vantage};

/// Bytes of decoded values that a bake made anew may hold between its tasks.
const MEMORY_BYTES: usize = 4 << 30;

/// A task kind and its code.
#[derive(Clone, Copy)]
pub struct TaskRow {
    /// Name on the wire.
    pub name: &'static str,
    /// Runs one task of the kind.
    pub run: fn(&Context, &TaskSpec) -> Result<TaskOutput, TaskError>,
}

/// The worker's side of a kind of bake.
pub trait BakeKind: Send + Sync {
    /// Name, as in manifests.
    fn name(&self) -> &'static str;

    /// Tasks of the kind's own.
    fn tasks(&self) -> Vec<TaskRow>;

    /// Names of the classes of error that it tells apart.
    fn error_classes(&self) -> Vec<&'static str> {
        Vec::new()
    }

    /// Whether it has light in free space: [`Evaluated::in_space`].
    fn has_space(&self) -> bool {
        false
    }

    /// Whether it has a lightmap, which pixels are read through.
    fn has_lightmap(&self) -> bool {
        true
    }

    /// Whether its bakes can be measured under any light: else [`Evaluated::own_light`] alone.
    fn is_relightable(&self) -> bool {
        true
    }

    /// A bake of the kind as evaluation sees it: its world made anew from the scene bundle, its chunks decoded. `kinds` is
    /// the whole table, for [`made_anew`].
    ///
    /// Errors when the world is prepared otherwise now than it was then.
    fn evaluated(
        &self,
        kinds: &BakeKinds,
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: ChunkBytes,
        progress: &Progress,
    ) -> Result<Box<dyn Evaluated>, EvaluationError>;
}

/// A table of kinds.
#[derive(Clone)]
pub struct BakeKinds(Vec<&'static dyn BakeKind>);

impl BakeKinds {
    /// The kinds of this crate.
    pub fn new() -> Self {
        Self(vec![
            &prt::Prt,
            &sh::Sh,
            &grid::Grid,
            &cloud::Cloud,
            &captured::Captured,
            &voxels::Voxels,
            &transfer::Transfer,
        ])
    }

    /// The table with one more kind.
    ///
    /// # Panics
    /// If the table has a kind or a task of that name.
    #[must_use]
    pub fn with(mut self, kind: &'static dyn BakeKind) -> Self {
        assert!(self.get(kind.name()).is_none(), "two kinds are named '{}'", kind.name());
        self.0.push(kind);
        let rows = self.rows();
        for task in kind.tasks() {
            let like = rows.iter().filter(|row| row.name == task.name).count();
            assert!(like == 1, "two tasks are named '{}'", task.name);
        }
        self
    }

    /// The kind of that name.
    pub fn get(&self, name: &str) -> Option<&'static dyn BakeKind> {
        self.0.iter().copied().find(|kind| kind.name() == name)
    }

    /// The shared tasks and those of the kinds.
    fn rows(&self) -> Vec<TaskRow> {
        scene_tasks().into_iter().chain(self.0.iter().flat_map(|kind| kind.tasks())).collect()
    }

    /// Names of the classes of error that some kind tells apart, each once.
    pub fn error_classes(&self) -> Vec<&'static str> {
        let mut names: Vec<&str> = self.0.iter().flat_map(|kind| kind.error_classes()).collect();
        names.sort_unstable();
        names.dedup();
        names
    }

    /// A bake as evaluation sees it, by the kind that its manifest names.
    ///
    /// Errors when the scene is not the one of the manifest, or no kind of the table made it.
    pub fn evaluated(
        &self,
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: ChunkBytes,
        progress: &Progress,
    ) -> Result<Box<dyn Evaluated>, EvaluationError> {
        let found = Digest::of(&scene);
        if found != manifest.scene {
            return Err(EvaluationError::OtherScene { wanted: manifest.scene, found });
        }
        let unknown = || EvaluationError::UnknownKind { kind: manifest.kind.clone() };
        self.get(&manifest.kind).ok_or_else(unknown)?.evaluated(self, manifest, scene, bytes, progress)
    }
}

impl Default for BakeKinds {
    fn default() -> Self {
        Self::new()
    }
}

/// Parameters of a kind's plan and assemble.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct BakeParams<S> {
    settings: S,
    /// Scene bundle, named in the manifest.
    scene: Digest,
    /// Versions of the task kinds that a plan plans: nobody reads them, they are part of its key.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    plans: BTreeMap<String, u32>,
}

/// Parameters of a kind's transport, with the settings that it depends on.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct TransportParams<S> {
    /// Index of the cluster cell.
    cluster: usize,
    settings: S,
}

/// Tasks over a scene that kinds share.
fn scene_tasks() -> Vec<TaskRow> {
    let run = |task: SceneTask| match task {
        SceneTask::Import => scene::task::run,
        SceneTask::Unwrap => lightmap::charts::run,
        SceneTask::Draw => draw::run,
        SceneTask::Frame => vantage::run,
        SceneTask::Place => lightmap::place::run,
        SceneTask::Patches => patches::run,
    };
    SceneTask::ALL.map(|task| TaskRow { name: task.name(), run: run(task) }).into()
}

/// Runs the shared tasks and those of a table of kinds.
#[derive(Clone)]
pub struct Runner(Arc<Vec<TaskRow>>);

impl Runner {
    /// A runner of the table's kinds.
    pub fn new(kinds: &BakeKinds) -> Self {
        Self(Arc::new(kinds.rows()))
    }
}

impl TaskRunner for Runner {
    fn kinds(&self) -> Vec<String> {
        self.0.iter().map(|row| row.name.to_owned()).collect()
    }

    fn run(
        &self,
        task: &TaskSpec,
        inputs: &[Artefact],
        alike: &[Vec<Artefact>],
        source: &dyn ArtefactSource,
        memory: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError> {
        let row = self.0.iter().find(|row| row.name == task.kind);
        let row = row.ok_or_else(|| TaskError::UnknownKind { kind: task.kind.clone() })?;
        (row.run)(&Context { inputs, alike, source, memory, progress }, task)
    }
}

/// A bake's tasks, as far as an evaluation runs them anew.
pub struct FirstTasks<'a, P> {
    /// Table that has the tasks to run, those of the kind among them.
    pub kinds: &'a BakeKinds,
    /// First tasks over a scene bundle, as the kind's contract plans them.
    pub plan: P,
    /// Names of the kind's own tasks that run beside the shared ones: its plan, and others that plan in turn.
    pub run: &'a [&'a str],
    /// Name of the task that is left out and whose inputs the evaluation reads, such as the kind's transport.
    pub up_to: &'a str,
    /// Names of those that have the same inputs, but may wait for others, and stand in for it where none of it is planned, the first ones first.
    pub or_else: &'a [&'a str],
}

/// Makes a bake's world anew for [`BakeKind::evaluated`]: runs its first tasks inside the process, and calls `made` with the
/// surroundings of the first task of the name `up_to` that is ready, and with all outputs.
///
/// Errors as the bake's own tasks would, and when no task of that name is planned, or it waits for one that is not among those to run.
pub fn made_anew<T>(
    first: FirstTasks<impl FnOnce(Digest) -> Vec<TaskSpec>>,
    scene: Vec<u8>,
    progress: &Progress,
    made: impl FnOnce(&Context, &LocalRun) -> Result<T, EvaluationError>,
) -> Result<T, EvaluationError> {
    let FirstTasks { kinds, plan, run: own, up_to, or_else } = first;
    let mut run = LocalRun::new(MEMORY_BYTES, progress);
    let plan = plan(run.shelf.put(scene));
    let is_run = |kind: &str| own.contains(&kind) || SceneTask::ALL.iter().any(|task| task.name() == kind);
    let left_out = run.run(&Runner::new(kinds), plan, is_run, |_| {}).map_err(EvaluationError::Prepare)?;
    let absent = || TaskError::bad_input(format!("no task '{up_to}' is left whose inputs are all there"));
    let is_ready = |task: &&TaskSpec| task.kind == up_to && run.is_ready(task);
    let is_planned = left_out.iter().any(|task| task.kind == up_to);
    let instead = || or_else.iter().find_map(|kind| left_out.iter().find(|task| task.kind == *kind));
    let task = left_out.iter().find(is_ready);
    let task = task.or_else(|| instead().filter(|_| !is_planned)).ok_or_else(absent);
    let inputs = run.resolved(task.map_err(EvaluationError::Prepare)?);
    made(&run.context(&inputs), &run)
}

#[cfg(test)]
mod tests;
