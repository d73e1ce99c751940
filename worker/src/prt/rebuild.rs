//! The world of a bake made anew from its scene and settings, without queue or files: import and prepare, one after the
//! other. Both are deterministic, so what comes out is what the bake's own tasks worked in.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput};
use lightkiln_proto::prt::{Settings, initial_plan};

use super::runner::PrtRunner;
use super::world::World;
use crate::task::{ArtefactSource, FetchError, MemoryCache, Progress, TaskError, TaskRunner};

/// Artefacts of one rebuild.
#[derive(Default)]
struct Shelf(Mutex<BTreeMap<Digest, Arc<Vec<u8>>>>);

impl Shelf {
    fn put(&self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(digest, Arc::new(bytes));
        digest
    }
}

impl ArtefactSource for Shelf {
    fn get(&self, digest: Digest) -> Result<Arc<Vec<u8>>, FetchError> {
        let held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        held.get(&digest).cloned().ok_or(FetchError::NotFound { digest })
    }
}

impl World {
    /// Imports a scene bundle and prepares it with these settings.
    ///
    /// Errors as the bake's own tasks would.
    pub fn rebuild(bundle: Vec<u8>, settings: &Settings, progress: &Progress) -> Result<Self, TaskError> {
        let shelf = Shelf::default();
        let memory = MemoryCache::new(0);
        let plan = initial_plan(shelf.put(bundle), settings);
        let mut outputs: BTreeMap<String, Artefact> = BTreeMap::new();
        for task in &plan {
            let mut inputs = Vec::new();
            for input in &task.inputs {
                match input {
                    TaskInput::Artefact { name, digest } => {
                        inputs.push(Artefact { name: name.clone(), digest: *digest, bytes: 0 });
                    }
                    TaskInput::Task { name, .. } => inputs.extend(outputs.iter().map(|(output, found)| {
                        Artefact { name: format!("{name}/{output}"), ..found.clone() }
                    })),
                }
            }
            let output = PrtRunner.run(task, &inputs, &shelf, &memory, progress)?;
            for (name, bytes) in output.artefacts {
                let length = bytes.len() as u64;
                let digest = shelf.put(bytes);
                outputs.insert(name.clone(), Artefact { name, digest, bytes: length });
            }
        }
        let bytes = |name: &str| {
            let found =
                outputs.get(name).ok_or_else(|| TaskError::bad_input(format!("prepare gave no '{name}'")))?;
            Ok::<_, TaskError>(shelf.get(found.digest)?)
        };
        Self::from_artefacts(&bytes("scene")?, &bytes("stage")?)
    }
}
