//! A plan run inside the process, without queue or files: one task after another in the order of their dependencies.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, MAX_ALIKE, TaskInput, TaskSpec};

use super::{ArtefactSource, FetchError, MemoryCache, Progress, TaskError, TaskRunner};

/// Artefacts in memory, by digest.
#[derive(Debug, Default)]
pub struct Shelf(Mutex<BTreeMap<Digest, Arc<Vec<u8>>>>);

impl Shelf {
    /// Keeps bytes.
    pub fn put(&self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(digest, Arc::new(bytes));
        digest
    }

    /// All artefacts.
    pub fn into_artefacts(self) -> BTreeMap<Digest, Arc<Vec<u8>>> {
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ArtefactSource for Shelf {
    fn get(&self, digest: Digest) -> Result<Arc<Vec<u8>>, FetchError> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.get(&digest).cloned().ok_or(FetchError::NotFound { digest })
    }
}

/// A plan while it runs, and its results.
#[derive(Debug)]
pub struct LocalRun<'p> {
    /// Every artefact, inputs of the plan among them.
    pub shelf: Shelf,
    /// Rays cast, and whether to stop.
    pub progress: &'p Progress,
    memory: MemoryCache,
    done: BTreeMap<TaskKey, Vec<Artefact>>,
    /// By task kind and name; of several tasks of a kind, the last one's.
    outputs: BTreeMap<(String, String), Digest>,
    /// Outputs of the last tasks of a name in common, newest first.
    alike: BTreeMap<Digest, Vec<Vec<Artefact>>>,
    /// Label and note of each task that was run.
    pub notes: Vec<(String, String)>,
}

impl<'p> LocalRun<'p> {
    /// Nothing run yet; decoded values take `memory_bytes_max` at most.
    pub fn new(memory_bytes_max: usize, progress: &'p Progress) -> Self {
        Self {
            shelf: Shelf::default(),
            progress,
            memory: MemoryCache::new(memory_bytes_max),
            done: BTreeMap::new(),
            outputs: BTreeMap::new(),
            alike: BTreeMap::new(),
            notes: Vec::new(),
        }
    }

    /// Runs a plan, and the tasks that its tasks plan; `ended` is told of each. Gives the tasks whose kind is not `wanted`:
    /// they are left out.
    ///
    /// Errors with the first task that fails, or when the tasks left wait for each other.
    pub fn run(
        &mut self,
        runner: &dyn TaskRunner,
        plan: Vec<TaskSpec>,
        wanted: impl Fn(&str) -> bool,
        mut ended: impl FnMut(&TaskSpec),
    ) -> Result<Vec<TaskSpec>, TaskError> {
        let mut known: BTreeSet<TaskKey> = self.done.keys().copied().collect();
        let (mut waiting, mut left_out): (Vec<TaskSpec>, Vec<TaskSpec>) = Default::default();
        let mut planned = plan;
        loop {
            for task in planned.into_iter().filter(|task| known.insert(task.key)) {
                if wanted(&task.kind) { &mut waiting } else { &mut left_out }.push(task);
            }
            let Some(ready) = waiting.iter().position(|task| self.is_ready(task)) else { break };
            let task = waiting.remove(ready);
            planned = self.run_task(runner, &task)?;
            ended(&task);
        }
        match waiting.first() {
            None => Ok(left_out),
            Some(task) => Err(TaskError::bad_input(format!(
                "'{} {}' waits for a task that is not planned or is left out",
                task.kind, task.label
            ))),
        }
    }

    /// All tasks that it depends on are done.
    pub fn is_ready(&self, task: &TaskSpec) -> bool {
        task.dependencies().all(|key| self.done.contains_key(&key))
    }

    /// Digest of the output of that name of the last task of a kind.
    pub fn output(&self, kind: &str, name: &str) -> Option<Digest> {
        self.outputs.get(&(kind.to_owned(), name.to_owned())).copied()
    }

    /// Digests of the last outputs of that name of each task kind.
    pub fn outputs_named<'a>(&'a self, name: &'a str) -> impl Iterator<Item = Digest> + 'a {
        self.outputs.iter().filter(move |((_, known), _)| known == name).map(|(_, digest)| *digest)
    }

    /// Outputs of shared tasks as inputs of a later one: of `import/scene`, output `scene` of `scene.import`.
    pub fn scene_inputs(&self, paths: &[&str]) -> Vec<Artefact> {
        let of_path = |path: &&str| {
            let (task, name) = path.split_once('/')?;
            let digest = self.output(&format!("scene.{task}"), name)?;
            Some(Artefact { name: (*path).to_owned(), digest, bytes: self.length(digest) })
        };
        paths.iter().filter_map(of_path).collect()
    }

    /// Surroundings of a task with these inputs.
    pub fn context<'a>(&'a self, inputs: &'a [Artefact]) -> super::Context<'a> {
        super::Context {
            inputs,
            alike: &[],
            source: &self.shelf,
            memory: &self.memory,
            progress: self.progress,
        }
    }

    /// Runs one task whose dependencies are done; gives the tasks that it plans.
    fn run_task(&mut self, runner: &dyn TaskRunner, task: &TaskSpec) -> Result<Vec<TaskSpec>, TaskError> {
        let inputs = self.resolved(task);
        let alike = task.alike.and_then(|name| self.alike.get(&name)).map_or(&[][..], Vec::as_slice);
        let output = runner.run(task, &inputs, alike, &self.shelf, &self.memory, self.progress)?;
        self.notes.push((task.label.clone(), output.note));
        let mut outputs = Vec::new();
        for (name, bytes) in output.artefacts {
            let length = bytes.len() as u64;
            let digest = self.shelf.put(bytes);
            self.outputs.insert((task.kind.clone(), name.clone()), digest);
            outputs.push(Artefact { name, digest, bytes: length });
        }
        if let Some(name) = task.alike {
            let alike = self.alike.entry(name).or_default();
            alike.insert(0, outputs.clone());
            alike.truncate(MAX_ALIKE);
        }
        self.done.insert(task.key, outputs);
        Ok(output.plan)
    }

    /// Inputs of a task as far as its dependencies are done, as a server resolves them.
    pub fn resolved(&self, task: &TaskSpec) -> Vec<Artefact> {
        let mut inputs = Vec::new();
        for input in &task.inputs {
            match input {
                TaskInput::Artefact { name, digest } => {
                    let bytes = self.length(*digest);
                    inputs.push(Artefact { name: name.clone(), digest: *digest, bytes });
                }
                TaskInput::Task { name, key } => {
                    let named = |output: &Artefact| Artefact {
                        name: format!("{name}/{}", output.name),
                        ..output.clone()
                    };
                    inputs.extend(self.done.get(key).into_iter().flatten().map(named));
                }
            }
        }
        inputs
    }

    fn length(&self, digest: Digest) -> u64 {
        self.shelf.get(digest).map_or(0, |bytes| bytes.len() as u64)
    }
}
