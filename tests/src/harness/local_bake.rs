//! A bake without server, queue or files: its tasks run one after another in the order of their dependencies.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, bail, ensure};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, MANIFEST_OUTPUT, REPORT_OUTPUT, TaskInput, TaskSpec};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::{Settings, initial_plan};
use lightkiln_worker::prt::PrtRunner;
use lightkiln_worker::task::{ArtefactSource, FetchError, MemoryCache, Progress, TaskRunner};

/// A finished bake with all its bytes.
#[derive(Debug)]
pub struct LocalBake {
    /// Manifest as decoded.
    pub manifest: Manifest,
    /// Manifest as written.
    pub manifest_bytes: Vec<u8>,
    /// Report.
    pub report: serde_json::Value,
    /// Every artefact by digest, chunks among them.
    pub artefacts: BTreeMap<Digest, Arc<Vec<u8>>>,
    /// Digest of the last output of each name.
    pub outputs: BTreeMap<String, Digest>,
    /// Closest-hit and occlusion rays cast.
    pub rays: [u64; 2],
    /// Seconds per task kind.
    pub secs: BTreeMap<String, f64>,
}

#[derive(Debug, Default)]
struct Store(Mutex<BTreeMap<Digest, Arc<Vec<u8>>>>);

impl Store {
    fn put(&self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(digest, Arc::new(bytes));
        digest
    }
}

impl ArtefactSource for Store {
    fn get(&self, digest: Digest) -> Result<Arc<Vec<u8>>, FetchError> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.get(&digest).cloned().ok_or(FetchError::NotFound { digest })
    }
}

/// Bakes a scene bundle with settings given as JSON.
pub fn bake(bundle: Vec<u8>, settings: &serde_json::Value) -> Result<LocalBake> {
    let settings = Settings::from_json(settings)?;
    let store = Store::default();
    let scene = store.put(bundle);
    let (memory, progress) = (MemoryCache::new(4 << 30), Progress::new());
    let mut waiting: Vec<TaskSpec> = initial_plan(scene, &settings);
    let mut done: BTreeMap<TaskKey, Vec<Artefact>> = BTreeMap::new();
    let mut secs: BTreeMap<String, f64> = BTreeMap::new();
    let mut results = BTreeMap::new();
    let mut known: BTreeSet<TaskKey> = waiting.iter().map(|task| task.key).collect();
    while !waiting.is_empty() {
        let ready = waiting.iter().position(|task| task.dependencies().all(|key| done.contains_key(&key)));
        let Some(ready) = ready else { bail!("no task of {} is ready: the plan has a cycle", waiting.len()) };
        let task = waiting.remove(ready);
        let started = std::time::Instant::now();
        let inputs = resolve(&task, &done, &store)?;
        let output = PrtRunner
            .run(&task, &inputs, &store, &memory, &progress)
            .with_context(|| format!("{} {}", task.kind, task.label))?;
        *secs.entry(task.kind.clone()).or_default() += started.elapsed().as_secs_f64();
        let mut outputs = Vec::new();
        for (name, bytes) in output.artefacts {
            let length = bytes.len() as u64;
            let digest = store.put(bytes);
            results.insert(name.clone(), digest);
            outputs.push(Artefact { name, digest, bytes: length });
        }
        ensure!(done.insert(task.key, outputs).is_none(), "task {} ran twice", task.label);
        waiting.extend(output.plan.into_iter().filter(|task| known.insert(task.key)));
    }
    let bytes_of = |name: &str| -> Result<Arc<Vec<u8>>> {
        Ok(store.get(*results.get(name).with_context(|| format!("no task gave '{name}'"))?)?)
    };
    let manifest_bytes = bytes_of(MANIFEST_OUTPUT)?.as_ref().clone();
    let report = serde_json::from_slice(&bytes_of(REPORT_OUTPUT)?)?;
    Ok(LocalBake {
        manifest: serde_json::from_slice(&manifest_bytes)?,
        manifest_bytes,
        report,
        artefacts: store.0.into_inner().unwrap_or_else(PoisonError::into_inner),
        outputs: results,
        rays: [progress.rays_closest(), progress.rays_occlusion()],
        secs,
    })
}

/// A task's inputs as a server would resolve them.
fn resolve(task: &TaskSpec, done: &BTreeMap<TaskKey, Vec<Artefact>>, store: &Store) -> Result<Vec<Artefact>> {
    let mut inputs = Vec::new();
    for input in &task.inputs {
        match input {
            TaskInput::Artefact { name, digest } => {
                let bytes = store.get(*digest)?.len() as u64;
                inputs.push(Artefact { name: name.clone(), digest: *digest, bytes });
            }
            TaskInput::Task { name, key } => {
                let outputs = done.get(key).with_context(|| format!("{name} is not done"))?;
                let named = |output: &Artefact| Artefact {
                    name: format!("{name}/{}", output.name),
                    ..output.clone()
                };
                inputs.extend(outputs.iter().map(named));
            }
        }
    }
    Ok(inputs)
}
