//! Tasks of the relightable bake, and the first of them.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::{SceneTasks, TaskKind, voxels};

/// Receivers and patches → cluster cells, the chunk of patches, the manifest without clusters for whoever follows the bake, and
/// the plan of the rest.
pub const PLAN: TaskKind = TaskKind { name: "prt.plan", version: 9 };
/// A cluster cell → its factorised transport, without colours, the record of what was read for it, and its rows.
pub const TRANSPORT: TaskKind = TaskKind { name: "prt.transport", version: 37 };
/// The transport of a cell → its chunks, with the colours of its receivers and the radiance of emitters, and their page of the
/// directory, for whoever follows the bake.
pub const COLOUR: TaskKind = TaskKind { name: "prt.colour", version: 3 };
/// The chunks of all cells → clusters of a few receivers and of coarse patches, which come first over a line.
pub const OVERVIEW: TaskKind = TaskKind { name: "prt.overview", version: 1 };
/// Everything → manifest, directory and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "prt.assemble", version: 6 };

/// The tasks that every kind of a scene shares, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared = SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place).patched();
    let of_voxels = [voxels::tasks::RECEIVERS, voxels::tasks::REGION, voxels::tasks::TOP];
    let rest = [&[TRANSPORT, COLOUR, OVERVIEW][..], &of_voxels, &[ASSEMBLE]].concat();
    PLAN.planned("clusters", scene, settings, shared, &rest)
}
