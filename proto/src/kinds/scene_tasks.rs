//! Tasks over a scene that kinds of bake share. Their parameters hold only the settings that they depend on, so that kinds
//! and settings which agree in those share the results by key.
//!
//! ```text
//! bundle ─▶ import ─▶ unwrap ─┬▶ draw      meshes and textures as chunks
//!                     │       └▶ place ─▶ patches
//!                     └▶ frame             camera and light where the file has none
//! ```

use serde_json::{Value, json};

use crate::ids::{Digest, TaskKey};
use crate::jobs::{TaskInput, TaskSpec};
use crate::settings::{PlaceSettings, TexelSettings};

/// Shared tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SceneTask {
    /// Scene bundle → imported scene.
    Import,
    /// Imported scene → a lightmap chart for every triangle.
    Unwrap,
    /// Scene and unwrap → chunks of meshes and textures.
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
            Self::Import | Self::Unwrap | Self::Draw | Self::Frame | Self::Place | Self::Patches => 1,
        }
    }

    fn task(self, params: Value, inputs: Vec<TaskInput>, cost: u64) -> TaskSpec {
        TaskSpec::new(self.name(), self.version(), "scene", params, inputs, cost)
    }
}

/// The shared tasks of one scene.
#[derive(Clone, Debug)]
pub struct SceneTasks {
    /// Bundle → outputs `scene`, `warnings`.
    pub import: TaskSpec,
    /// Input `import/…` → output `unwrap`.
    pub unwrap: TaskSpec,
    /// Inputs `import/…`, `unwrap/…` → outputs `geometry/N`, `texture/N`.
    pub draw: TaskSpec,
    /// Input `import/…` → output `framing` (JSON).
    pub frame: TaskSpec,
    /// Inputs `import/…`, `unwrap/…` → output `lightmap`.
    pub place: TaskSpec,
    /// Inputs `import/…`, `unwrap/…`, `place/…` → output `patches`.
    pub patches: TaskSpec,
}

impl SceneTasks {
    /// The tasks over a scene bundle.
    pub fn of(scene: Digest, texels: &TexelSettings, place: &PlaceSettings) -> Self {
        let bundle = TaskInput::Artefact { name: "bundle".into(), digest: scene };
        let import = SceneTask::Import.task(Value::Null, vec![bundle], 1);
        let imported = || task_input("import", import.key);
        let unwrap = SceneTask::Unwrap.task(json!({ "texels": texels }), vec![imported()], 5);
        let unwrapped = || task_input("unwrap", unwrap.key);
        let draw = SceneTask::Draw.task(Value::Null, vec![imported(), unwrapped()], 2);
        let frame = SceneTask::Frame.task(Value::Null, vec![imported()], 2);
        let params = json!({ "place": place });
        let place = SceneTask::Place.task(params, vec![imported(), unwrapped()], 10);
        let placed = task_input("place", place.key);
        let patches = SceneTask::Patches.task(Value::Null, vec![imported(), unwrapped(), placed], 5);
        Self { import, unwrap, draw, frame, place, patches }
    }

    /// Inputs through which a later task sees the outputs of all of `tasks`, by the names above.
    pub fn inputs(&self, tasks: impl IntoIterator<Item = SceneTask>) -> Vec<TaskInput> {
        let input = |task: SceneTask| {
            let (name, spec) = match task {
                SceneTask::Import => ("import", &self.import),
                SceneTask::Unwrap => ("unwrap", &self.unwrap),
                SceneTask::Draw => ("draw", &self.draw),
                SceneTask::Frame => ("frame", &self.frame),
                SceneTask::Place => ("place", &self.place),
                SceneTask::Patches => ("patches", &self.patches),
            };
            task_input(name, spec.key)
        };
        tasks.into_iter().map(input).collect()
    }

    /// The tasks named, in their order.
    pub fn only(self, tasks: &[SceneTask]) -> Vec<TaskSpec> {
        let Self { import, unwrap, draw, frame, place, patches } = self;
        let all = SceneTask::ALL.into_iter().zip([import, unwrap, draw, frame, place, patches]);
        all.filter(|(task, _)| tasks.contains(task)).map(|(_, spec)| spec).collect()
    }
}

fn task_input(name: &str, key: TaskKey) -> TaskInput {
    TaskInput::Task { name: name.to_owned(), key }
}
