//! Tasks of the relightable bake, and the first of them.

use serde_json::{Value, json};

use super::Settings;
use crate::ids::Digest;
use crate::jobs::{TaskInput, TaskSpec};
use crate::kinds::SceneTasks;

/// Tasks of the kind's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PrtTask {
    /// Receivers and patches → cluster cells, the chunk of patches, and the plan of the rest.
    Plan,
    /// A cluster cell → its factorised transport.
    Transport,
    /// Everything → manifest and report.
    Assemble,
}

impl PrtTask {
    /// All of them in the order of the graph.
    pub const ALL: [Self; 3] = [Self::Plan, Self::Transport, Self::Assemble];

    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plan => "prt.plan",
            Self::Transport => "prt.transport",
            Self::Assemble => "prt.assemble",
        }
    }

    /// Rises whenever the task's code gives other bytes for the same inputs.
    pub fn version(self) -> u32 {
        match self {
            Self::Plan | Self::Assemble => 2,
            Self::Transport => 9,
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

/// The tasks that every kind of a scene shares, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared = SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place).patched();
    let params = json!({ "settings": settings, "scene": scene });
    let plan = PrtTask::Plan.task("clusters", params, shared.inputs(), 10);
    shared.into_specs().chain([plan]).collect()
}
