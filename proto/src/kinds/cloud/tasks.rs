//! Tasks of a bake with a field, and the first of them.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::prt::{self, tasks as relightable};
use crate::kinds::voxels::tasks as voxels;
use crate::kinds::{SceneTasks, TaskKind};

/// Receivers and patches → the tasks of a relightable bake, probes in free space, and the plan of the rest.
pub const PLAN: TaskKind = TaskKind { name: "cloud.plan", version: 6 };
/// Some probes → their depth maps and factorised transport, as a chunk.
pub const GATHER: TaskKind = TaskKind { name: "cloud.gather", version: 2 };
/// Some receivers and the light of probes → the factors of surfaces that have the field's light.
pub const LIT: TaskKind = TaskKind { name: "cloud.lit", version: 1 };
/// Everything → manifest, directory and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "cloud.assemble", version: 1 };

/// The tasks that every kind of a scene shares, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let prt::Settings { texels, place, .. } = settings.relightable();
    let shared = SceneTasks::of(scene).unwrapped(&texels).placed(&place).patched();
    let of_voxels = [voxels::RECEIVERS, voxels::REGION, voxels::TOP];
    let surfaces = [relightable::TRANSPORT, relightable::COLOUR, relightable::OVERVIEW];
    let rest = [&surfaces[..], &of_voxels, &[GATHER, LIT, ASSEMBLE]].concat();
    PLAN.planned("clusters and probes", scene, settings, shared, &rest)
}
