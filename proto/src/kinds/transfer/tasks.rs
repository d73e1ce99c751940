//! Tasks of a moving object's bake, and the first of them.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::prt::tasks as relightable;
use crate::kinds::voxels::tasks as voxels;
use crate::kinds::{SceneTasks, TaskKind};

/// Receivers and patches → the tasks of a relightable bake, those of the volume, and the last one.
pub const PLAN: TaskKind = TaskKind { name: "transfer.plan", version: 1 };
/// The object → a level of its volume, a chunk.
pub const VOLUME: TaskKind = TaskKind { name: "transfer.volume", version: 1 };
/// Everything → manifest, directory and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "transfer.assemble", version: 1 };

/// The tasks that every kind of a scene shares, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared =
        SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place).patched_from_around();
    let of_voxels = [voxels::RECEIVERS, voxels::REGION, voxels::TOP];
    let surfaces = [relightable::TRANSPORT, relightable::COLOUR, relightable::OVERVIEW];
    let rest = [&surfaces[..], &of_voxels, &[VOLUME, ASSEMBLE]].concat();
    PLAN.planned("clusters and volume", scene, settings, shared, &rest)
}
