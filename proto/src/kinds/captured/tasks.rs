//! Tasks of a bake of captured light, and the first of them.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::{SceneTasks, TaskKind, cloud, grid};

/// Scene → probes in free space, and the plan of the rest.
pub const PLAN: TaskKind = TaskKind { name: "captured.plan", version: 5 };
/// Some probes → their depth maps and their light, as a chunk.
pub const GATHER: TaskKind = TaskKind { name: "captured.gather", version: 2 };
/// Everything → manifest and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "captured.assemble", version: 1 };

/// The tasks of a scene without a lightmap, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    // Probes stand as those of the other kinds with a field.
    let rest = [GATHER, ASSEMBLE, grid::tasks::PLAN, cloud::tasks::PLAN];
    PLAN.planned("probes", scene, settings, SceneTasks::of(scene), &rest)
}
