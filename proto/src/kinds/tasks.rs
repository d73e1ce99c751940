//! Tasks of a kind's own, and the first ones of its bakes.

use std::collections::BTreeMap;

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

    /// The shared tasks, and this one as the plan of the rest: it sees their outputs, all settings and the scene. `rest` are
    /// the task kinds that it plans: a plan of former versions of theirs is not taken for this one.
    pub fn planned(
        self,
        label: &str,
        scene: Digest,
        settings: &impl Serialize,
        shared: SceneTasks,
        rest: &[Self],
    ) -> Vec<TaskSpec> {
        let mut params = json!({ "settings": settings, "scene": scene });
        if !rest.is_empty() {
            let versions: BTreeMap<&str, u32> = rest.iter().map(|kind| (kind.name, kind.version)).collect();
            params["plans"] = json!(versions);
        }
        let plan = self.task(label, params, shared.inputs(), PLAN_COST);
        shared.into_specs().chain([plan]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plan_of_other_versions_of_what_it_plans_is_another_task() {
        let plan = TaskKind { name: "a.plan", version: 1 };
        let key = |version: u32| {
            let rest = [TaskKind { name: "a.transport", version }];
            let scene = Digest::of(b"scene");
            let specs = plan.planned("all", scene, &json!({}), SceneTasks::of(scene), &rest);
            specs.last().map(|spec| spec.key)
        };
        assert!(key(1).is_some() && key(1) == key(1));
        assert_ne!(key(1), key(2));
    }
}
