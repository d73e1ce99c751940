//! Tasks of a kind's own, and the first ones of its bakes.

use serde::Serialize;
use serde_json::{Value, json};

use super::SceneTasks;
use crate::ids::Digest;
use crate::jobs::{TaskInput, TaskSpec};

/// Cost of a plan, in the units of [`TaskSpec`].
const PLAN_COST: u64 = 10;

/// A task of a kind's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskKind {
    /// Name on the wire.
    pub name: &'static str,
    /// Rises whenever the task's code gives other bytes for the same inputs.
    pub version: u32,
}

impl TaskKind {
    /// A task.
    pub fn task(
        self,
        label: impl Into<String>,
        params: Value,
        inputs: Vec<TaskInput>,
        cost: u64,
    ) -> TaskSpec {
        TaskSpec::new(self.name, self.version, label, params, inputs, cost)
    }

    /// The shared tasks, and this one as the plan of the rest: it sees their outputs, all settings and the scene.
    pub fn planned(
        self,
        label: &str,
        scene: Digest,
        settings: &impl Serialize,
        shared: SceneTasks,
    ) -> Vec<TaskSpec> {
        let params = json!({ "settings": settings, "scene": scene });
        let plan = self.task(label, params, shared.inputs(), PLAN_COST);
        shared.into_specs().chain([plan]).collect()
    }
}
