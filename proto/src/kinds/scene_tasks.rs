//! Tasks over a scene that kinds of bake share. Their parameters hold only the settings that they depend on, so that kinds
//! and settings which agree in those share the results by key.
//!
//! ```text
//! bundle ─▶ import ─┬▶ frame                camera and light where the file has none
//!                   ├▶ draw                 meshes and textures as chunks, in the lightmap if there is one
//!                   └▶ unwrap ─▶ place ─▶ patches
//! ```

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::ids::Digest;
use crate::jobs::{TaskInput, TaskSpec};
use crate::settings::{PlaceSettings, TexelSettings};

/// Shared tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SceneTask {
    /// Scene bundle → imported scene.
    Import,
    /// Imported scene → a lightmap chart for every triangle.
    Unwrap,
    /// Scene, and unwrap where there is one → chunks of meshes and textures.
    Draw,
    /// Scene → vantage points: a camera and a light where the file has none.
    Frame,
    /// Scene and unwrap → receivers.
    Place,
    /// Receivers → the tree of surface patches.
    Patches,
}

impl SceneTask {
    /// All of them in the order of the graph.
    pub const ALL: [Self; 6] =
        [Self::Import, Self::Unwrap, Self::Draw, Self::Frame, Self::Place, Self::Patches];

    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Import => "scene.import",
            Self::Unwrap => "scene.unwrap",
            Self::Draw => "scene.draw",
            Self::Frame => "scene.frame",
            Self::Place => "scene.place",
            Self::Patches => "scene.patches",
        }
    }

    /// Rises whenever the task's code gives other bytes for the same inputs.
    pub fn version(self) -> u32 {
        match self {
            Self::Place => 30,
            Self::Patches => 8,
            Self::Draw => 6,
            Self::Frame => 6,
            Self::Import => 7,
            Self::Unwrap => 3,
        }
    }

    /// Name before the slash under which later tasks see its outputs.
    fn input_name(self) -> &'static str {
        self.name().trim_start_matches("scene.")
    }
}

/// Shared tasks of one scene: all that a kind's own are built on.
#[derive(Clone, Debug)]
pub struct SceneTasks(BTreeMap<SceneTask, TaskSpec>);

impl SceneTasks {
    /// Import, draws and framing over a scene bundle, without a lightmap.
    pub fn of(scene: Digest) -> Self {
        let bundle = TaskInput::Artefact { name: "bundle".into(), digest: scene };
        let mut tasks = Self(BTreeMap::new());
        let import = SceneTask::Import;
        let spec = TaskSpec::new(import.name(), import.version(), "scene", Value::Null, vec![bundle], 1);
        tasks.0.insert(import, spec);
        tasks.follow(SceneTask::Draw, [SceneTask::Import], Value::Null, 2);
        tasks.follow(SceneTask::Frame, [SceneTask::Import], Value::Null, 2);
        tasks
    }

    /// Adds the charts of a lightmap; draws then have coordinates in it.
    #[must_use]
    pub fn unwrapped(mut self, texels: &TexelSettings) -> Self {
        self.follow(SceneTask::Unwrap, [SceneTask::Import], json!({ "texels": texels }), 5);
        self.follow(SceneTask::Draw, [SceneTask::Import, SceneTask::Unwrap], Value::Null, 2);
        self
    }

    /// Adds the receivers of a lightmap.
    ///
    /// # Panics
    /// If there are no charts.
    #[must_use]
    pub fn placed(mut self, place: &PlaceSettings) -> Self {
        let params = json!({ "place": place });
        self.follow(SceneTask::Place, [SceneTask::Import, SceneTask::Unwrap], params, 10);
        self
    }

    /// Adds the tree of patches over the receivers.
    ///
    /// # Panics
    /// If there are no receivers.
    #[must_use]
    pub fn patched(self) -> Self {
        self.patched_by(Value::Null)
    }

    /// As [`Self::patched`], of a thing that is looked at from all around: surfaces that see nothing of it are seen.
    #[must_use]
    pub fn patched_from_around(self) -> Self {
        self.patched_by(json!({ "from_around": true }))
    }

    fn patched_by(mut self, params: Value) -> Self {
        let inputs = [SceneTask::Import, SceneTask::Unwrap, SceneTask::Place];
        self.follow(SceneTask::Patches, inputs, params, 5);
        self
    }

    /// Inputs through which a later task sees all outputs, as `import/…`, `draw/…` and so on.
    pub fn inputs(&self) -> Vec<TaskInput> {
        self.0.keys().map(|task| self.input(*task)).collect()
    }

    /// The tasks in the order of the graph.
    pub fn into_specs(self) -> impl Iterator<Item = TaskSpec> {
        self.0.into_values()
    }

    fn follow<const N: usize>(&mut self, task: SceneTask, after: [SceneTask; N], params: Value, cost: u64) {
        let inputs = after.map(|before| self.input(before)).into();
        self.0.insert(task, TaskSpec::new(task.name(), task.version(), "scene", params, inputs, cost));
    }

    fn input(&self, task: SceneTask) -> TaskInput {
        let spec = self.0.get(&task).expect("a task is added after those that it reads");
        TaskInput::Task { name: task.input_name().to_owned(), key: spec.key }
    }
}
