//! Kind `transfer`: an object that moves through other bakes (METHOD.md §2.17).
//!
//! `transfer.plan` (all of `prt.plan`) → `prt.transport`, `prt.colour`, `prt.overview`, `voxels.region`, `voxels.top`, and `transfer.volume` by
//! level → `transfer.assemble`.

mod nodes;
mod parts;
mod volume;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::transfer::{
    Body, NAME, Settings, TransferSettings, TransferTotals, first_tasks, tasks,
};
use lightkiln_proto::kinds::voxels::tasks::RECEIVERS;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::transfer::{LEVELS, NEAREST, TRANSFER, decode_transfer};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{BakeKind, BakeKinds, TaskRow, prt};
use crate::assemble::{KindPart, assembled, chunk_refs};
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::lightmap::World;
use crate::task::{Context, Progress, TaskError, TaskOutput, params};

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Transfer;

impl BakeKind for Transfer {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan },
            TaskRow { name: tasks::VOLUME.name, run: volume::run },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble },
        ]
    }

    fn error_classes(&self) -> Vec<&'static str> {
        prt::Prt.error_classes()
    }

    fn evaluated(
        &self,
        kinds: &BakeKinds,
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: ChunkBytes,
        progress: &Progress,
    ) -> Result<Box<dyn Evaluated>, EvaluationError> {
        let settings: Settings = manifest.settings()?;
        let first = (scene, |scene| first_tasks(scene, &settings), tasks::PLAN.name, &[RECEIVERS.name][..]);
        let traced = (&settings.relightable()).into();
        Ok(Box::new(prt::evaluated_of(kinds, manifest, first, traced, bytes, progress)?))
    }
}

type BakeParams = super::BakeParams<Settings>;

/// Parameters of a level.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct VolumeParams {
    level: u32,
    settings: TransferSettings,
}

/// Label of the task of a level; `transfer/0` is the finest.
fn label(level: u32) -> String {
    format!("{TRANSFER} {level}")
}

/// Task `transfer.plan`: inputs are the outputs of all scene tasks; outputs those of `prt.plan` but its outline.
fn plan(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let world = World::of(context)?;
    let [low_m, high_m] = world.geometry.bounds_m();
    let longest_m = (high_m - low_m).max_element();
    let farthest_m = low_m.abs().max(high_m.abs()).max_element();
    if !(1e-5..=1e5).contains(&longest_m) || longest_m < NEAREST * farthest_m {
        let problem = format!(
            "the object is {longest_m} m long and reaches {farthest_m} m away from its origin: one that moves has 0.00001 to 100000 m, and {NEAREST} of \
             that distance; scale it, or move it to its origin"
        );
        return Err(TaskError::bad_input(problem));
    }
    let settings = bake.settings.relightable();
    let surfaces = prt::planned(context, &settings, &world.all_receivers())?;
    let BakeParams { settings: Settings { transfer, .. }, .. } = &bake;
    let rays = u64::from(transfer.transfer_nodes).pow(3) * u64::from(transfer.transfer_rays);
    let of_level = |level: u32| {
        let own = json!(VolumeParams { level, settings: transfer.clone() });
        let inputs = context.as_inputs(prt::is_read_by_transport);
        tasks::VOLUME.task(label(level), own, inputs, rays / 1000 + 1)
    };
    let levels: Vec<TaskSpec> = (0..LEVELS).map(of_level).collect();
    let (mut plan, results) = surfaces.tasks();
    let mut inputs = context.as_inputs(|_| true);
    inputs.extend(results);
    inputs.extend(crate::task::results_of(&levels));
    plan.extend(levels);
    plan.push(tasks::ASSEMBLE.task("bundle", json!(bake), inputs, 1));
    Ok(TaskOutput { artefacts: surfaces.artefacts, plan, ..TaskOutput::default() })
}

/// Task `transfer.assemble`: inputs of [`prt::Assembled::of`], and the chunk of each level.
fn assemble(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let prt::Assembled { body, clusters, mut chunks, mut report } =
        prt::Assembled::of(context, &settings.relightable())?;
    let mut totals = TransferTotals::default();
    let mut refs = Vec::new();
    for level in 0..LEVELS {
        let name = format!("{}/{}", label(level).replace(' ', "/"), volume::CHUNK);
        let found = decode_transfer(&context.bytes(&name)?)
            .map_err(|error| TaskError::bad_input_from("a level of the volume cannot be read", error))?;
        let [low, high] = found.box_m;
        totals.half_side_m = (0..3).map(|axis| 0.5 * (high[axis] - low[axis])).fold(0.0, f32::max);
        totals.nodes.push(found.node_count() as u64);
        totals.parts.push(found.parts.len() as u64);
        totals.resident_bytes += 4 * found.codes.len() as u64;
        refs.extend(chunk_refs(context, &name));
    }
    // Coarse before fine, as they are drawn from far to near.
    refs.reverse();
    chunks.push((TRANSFER, refs));
    report["transfer"] = json!(totals);
    let body = Body { totals: body.totals, patches: body.patches, voxels: body.voxels, transfer: totals };
    assembled(
        context,
        KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks },
        report,
    )
}
