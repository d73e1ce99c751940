//! Kind `voxels`: receivers and patches without transport, whose light is that of walks at run time (METHOD.md §2.16).
//!
//! `voxels.plan` (cells, the chunk of patches) → `voxels.receivers` and `prt.colour` by cell, `voxels.region`, `voxels.top` → `voxels.assemble`.

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::voxels::{NAME, Settings, tasks};
use lightkiln_proto::manifest::Manifest;
use serde_json::json;

use super::run;
use crate::assemble::{KindPart, assembled};
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::kinds::prt::{self, Assembled, Rays, TracedSettings};
use crate::kinds::{BakeKind, BakeKinds, TaskRow};
use crate::lightmap::World;
use crate::task::{Context, Progress, TaskError, TaskOutput, params};

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Voxels;

impl BakeKind for Voxels {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan },
            TaskRow { name: tasks::RECEIVERS.name, run: prt::run_transport },
            TaskRow { name: tasks::REGION.name, run },
            TaskRow { name: tasks::TOP.name, run },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble },
        ]
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
        let plan = |scene| tasks::first_tasks(scene, &settings);
        let first = (scene, plan, tasks::PLAN.name, &[tasks::RECEIVERS.name][..]);
        Ok(Box::new(prt::evaluated_of(kinds, manifest, first, traced(&settings), bytes, progress)?))
    }
}

type BakeParams = crate::kinds::BakeParams<Settings>;

fn traced(settings: &Settings) -> TracedSettings {
    TracedSettings::from(&settings.relightable()).bare()
}

/// Task `voxels.plan`: inputs are the outputs of all scene tasks; outputs `cells`, `stage`, `patch-set`.
fn plan(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let settings = bake.settings.relightable();
    let rays = Rays {
        task: tasks::RECEIVERS,
        label: "cluster",
        traced: traced(&bake.settings),
        settings: &settings,
        receivers: World::of(context)?.all_receivers(),
    };
    let planned = prt::planned_of(context, &settings, &[rays])?;
    let (plan, artefacts) = planned.with_assemble(context, tasks::ASSEMBLE, json!(bake));
    Ok(TaskOutput { artefacts, plan, ..TaskOutput::default() })
}

/// Task `voxels.assemble`: inputs of [`Assembled::of`].
fn assemble(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let Assembled { body, clusters, chunks, report } = Assembled::of(context, &settings.relightable())?;
    let part = KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks };
    assembled(context, part, report)
}
