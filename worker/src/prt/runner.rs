//! Runs any task of a relightable bake.

use std::sync::Arc;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_proto::prt::{Settings, TaskKind};
use serde::de::DeserializeOwned;

use super::artefact;
use super::stage::{self, Stage};
use super::world::World;
use super::{assemble, import, prepare, relight, transport};
use crate::scene::model::Scene;
use crate::scene::texture::DecodedImages;
use crate::task::{ArtefactSource, MemoryCache, Progress, TaskError, TaskOutput, TaskRunner, input};

/// Runs the tasks of relightable bakes.
#[derive(Clone, Copy, Debug, Default)]
pub struct PrtRunner;

/// What a task sees while it runs.
pub(super) struct Context<'a> {
    pub inputs: &'a [Artefact],
    pub source: &'a dyn ArtefactSource,
    pub memory: &'a MemoryCache,
    pub progress: &'a Progress,
}

impl TaskRunner for PrtRunner {
    fn kinds(&self) -> Vec<String> {
        TaskKind::ALL.iter().map(|kind| kind.name().to_owned()).collect()
    }

    fn run(
        &self,
        task: &TaskSpec,
        inputs: &[Artefact],
        source: &dyn ArtefactSource,
        memory: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError> {
        let context = Context { inputs, source, memory, progress };
        match TaskKind::from_name(&task.kind) {
            Some(TaskKind::Import) => import::run(&context),
            Some(TaskKind::Prepare) => prepare::run(&context, &params(task)?),
            Some(TaskKind::Relight) => relight::run(&context, &params(task)?),
            Some(TaskKind::Transport) => transport::run(&context, &params(task)?),
            Some(TaskKind::Assemble) => assemble::run(&context, &params(task)?),
            None => Err(TaskError::UnknownKind { kind: task.kind.clone() }),
        }
    }
}

/// Reads a task's parameters.
fn params<T: DeserializeOwned>(task: &TaskSpec) -> Result<T, TaskError> {
    T::deserialize(&task.params).map_err(|error| {
        TaskError::bad_input_from(
            format!("the parameters of '{} {}' cannot be read", task.kind, task.label),
            error,
        )
    })
}

/// Settings as tasks carry them: validated once more, as a task may come from anywhere.
pub(super) fn checked(settings: &Settings) -> Result<(), TaskError> {
    let json = serde_json::to_value(settings)
        .map_err(|error| TaskError::bad_input_from("the settings cannot be read", error))?;
    Settings::from_json(&json)
        .map(drop)
        .map_err(|error| TaskError::bad_input_from("the settings are out of range", error))
}

impl Context<'_> {
    /// Bytes of the input of that name.
    pub fn bytes(&self, name: &str) -> Result<Arc<Vec<u8>>, TaskError> {
        Ok(self.source.get(input(self.inputs, name)?.digest)?)
    }

    /// Digest of the input of that name.
    pub fn digest(&self, name: &str) -> Result<Digest, TaskError> {
        Ok(input(self.inputs, name)?.digest)
    }

    /// The imported scene under that input name.
    pub fn scene(&self, name: &str) -> Result<Scene, TaskError> {
        Ok(artefact::decode(import::MAGIC, &self.bytes(name)?)?.0)
    }

    /// The world of inputs `scene` and `stage`, built once per worker.
    pub fn world(&self) -> Result<Arc<World>, TaskError> {
        self.memory.get_or_insert(self.digest("stage")?, || {
            let (stage, stage_bytes) = artefact::decode::<Stage>(stage::MAGIC, &self.bytes("stage")?)?;
            let scene = self.scene("scene")?;
            let images = decode_images(&scene)?;
            let bytes = 3 * stage_bytes + 200 * stage.receivers.len();
            Ok((World::new(scene, stage, images), bytes))
        })
    }
}

impl World {
    /// The world of an imported-scene artefact and a stage artefact, as `prt.import` and `prt.prepare` give them.
    pub fn from_artefacts(scene: &[u8], stage: &[u8]) -> Result<Self, TaskError> {
        let scene: Scene = artefact::decode(import::MAGIC, scene)?.0;
        let stage: Stage = artefact::decode(stage::MAGIC, stage)?.0;
        let images = decode_images(&scene)?;
        Ok(Self::new(scene, stage, images))
    }
}

/// Decodes a scene's images.
pub(super) fn decode_images(scene: &Scene) -> Result<Arc<DecodedImages>, TaskError> {
    DecodedImages::decode(scene)
        .map(Arc::new)
        .map_err(|error| TaskError::bad_input_from("an image of the scene cannot be decoded", error))
}
