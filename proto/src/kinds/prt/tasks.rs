//! Tasks of the relightable bake, and the first of them.

use super::Settings;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::{SceneTasks, TaskKind};

/// Receivers and patches → cluster cells, the chunk of patches, and the plan of the rest.
pub const PLAN: TaskKind = TaskKind { name: "prt.plan", version: 5 };
/// A cluster cell → its factorised transport, without colours, and the record of what was read for it.
pub const TRANSPORT: TaskKind = TaskKind { name: "prt.transport", version: 34 };
/// The transport of a cell → its chunks, with the colours of its receivers and the radiance of emitters.
pub const COLOUR: TaskKind = TaskKind { name: "prt.colour", version: 2 };
/// Everything → manifest, directory and report.
pub const ASSEMBLE: TaskKind = TaskKind { name: "prt.assemble", version: 5 };

/// The tasks that every kind of a scene shares, and the plan of the rest.
pub fn first_tasks(scene: Digest, settings: &Settings) -> Vec<TaskSpec> {
    let shared = SceneTasks::of(scene).unwrapped(&settings.texels).placed(&settings.place).patched();
    PLAN.planned("clusters", scene, settings, shared, &[TRANSPORT, COLOUR, ASSEMBLE])
}
