//! Tasks of the bake by spherical harmonics, and the first of them.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::{SceneTasks, TaskKind};

/// Receivers → probes, cluster cells, and the plan of the rest.
pub const PLAN: TaskKind = TaskKind { name: "sh.plan", version: 4 };
/// A batch of probes → their relight rays' hits.
pub const RELIGHT: TaskKind = TaskKind { name: "sh.relight", version: 8 };
/// A cluster cell → its factorised transport.
pub const TRANSPORT: TaskKind = TaskKind { name: "sh.transport", version: 14 };
/// Everything → manifest, directory and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "sh.assemble", version: 4 };

/// The tasks that kinds of a scene share, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared = SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place);
    PLAN.planned("probes", scene, settings, shared, &[RELIGHT, TRANSPORT, ASSEMBLE])
}
