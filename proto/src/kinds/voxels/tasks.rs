//! Tasks of voxels.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::{SceneTasks, TaskKind, prt};

/// As `prt.plan`, of a bake without transport.
pub const PLAN: TaskKind = TaskKind { name: "voxels.plan", version: 1 };
/// A cluster cell → its receivers with the light of emitters, without colours, and the record of what was read for them.
pub const RECEIVERS: TaskKind = TaskKind { name: "voxels.receivers", version: 1 };
/// Surfaces in a cube → its elements, a chunk of the finest levels.
pub const REGION: TaskKind = TaskKind { name: "voxels.region", version: 1 };
/// All surfaces → elements of the coarser levels, a chunk.
pub const TOP: TaskKind = TaskKind { name: "voxels.top", version: 1 };
/// Everything → manifest, directory and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "voxels.assemble", version: 1 };

/// The tasks that every kind of a scene shares, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared = SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place).patched();
    // Rays are those of transport.
    let rest = [prt::tasks::TRANSPORT, RECEIVERS, prt::tasks::COLOUR, REGION, TOP, ASSEMBLE];
    PLAN.planned("voxels", scene, settings, shared, &rest)
}
