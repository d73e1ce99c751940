//! Tasks of the bake by spherical harmonics, and the first of them.

use serde_json::{Value, json};

use super::Settings;
use crate::ids::Digest;
use crate::jobs::{TaskInput, TaskSpec};
use crate::kinds::SceneTasks;

/// Tasks of the kind's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ShTask {
    /// Receivers → probes, cluster cells, and the plan of the rest.
    Plan,
    /// A batch of probes → their relight rays' hits.
    Relight,
    /// A cluster cell → its factorised transport.
    Transport,
    /// Everything → manifest and report.
    Assemble,
}

impl ShTask {
    /// All of them in the order of the graph.
    pub const ALL: [Self; 4] = [Self::Plan, Self::Relight, Self::Transport, Self::Assemble];

    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plan => "sh.plan",
            Self::Relight => "sh.relight",
            Self::Transport => "sh.transport",
            Self::Assemble => "sh.assemble",
        }
    }

    /// Rises whenever the task's code gives other bytes for the same inputs.
    pub fn version(self) -> u32 {
        match self {
            Self::Plan | Self::Relight | Self::Transport | Self::Assemble => 1,
        }
    }

    /// A task.
    pub fn task(
        self,
        label: impl Into<String>,
        params: Value,
        inputs: Vec<TaskInput>,
        cost: u64,
    ) -> TaskSpec {
        TaskSpec::new(self.name(), self.version(), label, params, inputs, cost)
    }
}

/// The tasks that kinds of a scene share, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared = SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place);
    let params = json!({ "settings": settings, "scene": scene });
    let plan = ShTask::Plan.task("probes", params, shared.inputs(), 10);
    shared.into_specs().chain([plan]).collect()
}
