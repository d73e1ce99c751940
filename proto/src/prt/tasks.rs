//! Task kinds of the relightable bake and its first tasks.

use crate::ids::Digest;
use crate::jobs::{TaskInput, TaskSpec};
use crate::prt::Settings;

/// What the tasks of a relightable bake do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TaskKind {
    /// Scene bundle → imported scene.
    Import,
    /// Imported scene → unwrap, receivers, probes, clusters, and the plan of the rest.
    Prepare,
    /// A batch of probes → their relight rays' hits.
    Relight,
    /// A cluster → its factorised transport.
    Transport,
    /// Everything → manifest and report.
    Assemble,
}

impl TaskKind {
    /// All kinds in the order of the graph.
    pub const ALL: [Self; 5] = [Self::Import, Self::Prepare, Self::Relight, Self::Transport, Self::Assemble];

    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Import => "prt.import",
            Self::Prepare => "prt.prepare",
            Self::Relight => "prt.relight",
            Self::Transport => "prt.transport",
            Self::Assemble => "prt.assemble",
        }
    }

    /// Reads a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Rises whenever the kind's code gives other bytes for the same inputs.
    pub fn version(self) -> u32 {
        match self {
            Self::Prepare => 11,
            Self::Transport => 8,
            Self::Relight => 2,
            Self::Import | Self::Assemble => 1,
        }
    }

    /// A task of this kind.
    pub fn task(
        self,
        label: impl Into<String>,
        params: serde_json::Value,
        inputs: Vec<TaskInput>,
        cost: u64,
    ) -> TaskSpec {
        TaskSpec::new(self.name(), self.version(), label, params, inputs, cost)
    }
}

/// Import and prepare; prepare plans the rest.
pub fn initial_plan(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let scene_input = TaskInput::Artefact { name: "bundle".into(), digest: scene };
    let import = TaskKind::Import.task("scene", serde_json::Value::Null, vec![scene_input], 1);
    let params = serde_json::json!({ "settings": settings, "scene": scene });
    let imported = TaskInput::Task { name: "import".into(), key: import.key };
    let prepare = TaskKind::Prepare.task("scene", params, vec![imported], 10);
    vec![import, prepare]
}
