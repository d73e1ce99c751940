//! Kind `cloud`: a relightable bake with a field, light at probes that stand in free space, and tetrahedra between them.
//!
//! `cloud.plan` (all of `prt.plan`, probes, tetrahedra) → `prt.transport`, and `cloud.gather` by cell of probes → `cloud.lit` by cell of
//! receivers that probes light → `prt.colour`, `prt.overview` → `cloud.assemble`.

mod delaunay;
mod placement;
mod survey;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::cloud::{NAME, Settings, TETRAHEDRA, first_tasks, tasks};
use lightkiln_proto::kinds::voxels::tasks::RECEIVERS;
use lightkiln_proto::manifest::Manifest;
use serde_json::json;

use super::field::{self, FieldPlan};
use super::voxels::DIRECTIONS;
use super::{BakeKind, BakeKinds, TaskRow};
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::factors;
use crate::task::{Context, Progress, TaskError, TaskOutput, params};
pub(super) use survey::survey;

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cloud;

impl BakeKind for Cloud {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan },
            TaskRow { name: tasks::GATHER.name, run: field::gather },
            TaskRow { name: tasks::LIT.name, run: field::lit },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble },
        ]
    }

    fn error_classes(&self) -> Vec<&'static str> {
        [&factors::ERROR_CLASSES[..], &field::CLASSES, &[DIRECTIONS]].concat()
    }

    fn has_space(&self) -> bool {
        true
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
        let first = (
            scene,
            |scene| first_tasks(scene, &settings),
            tasks::PLAN.name,
            &[tasks::LIT.name, RECEIVERS.name][..],
        );
        let role = Some(TETRAHEDRA);
        Ok(Box::new(field::evaluated(
            kinds,
            manifest,
            first,
            &settings.relightable(),
            role,
            (bytes, progress),
        )?))
    }
}

type BakeParams = super::BakeParams<Settings>;

/// Task `cloud.plan`.
fn plan(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let plan = FieldPlan {
        relightable: bake.settings.relightable(),
        field: &bake.settings.field,
        is_fitted: bake.settings.cloud.field_fit == 1,
        lit_by_probes: &bake.settings.lit,
        gather: tasks::GATHER,
        lit: tasks::LIT,
        assemble: (tasks::ASSEMBLE, json!(bake)),
        tetrahedra: Some(TETRAHEDRA),
    };
    field::planned(context, &plan, |geometry| {
        survey(geometry, (&bake.settings.field, &bake.settings.cloud), context.progress)
    })
}

/// Task `cloud.assemble`.
fn assemble(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    field::field_assembled(context, (NAME, scene), &settings, &settings.relightable(), Some(TETRAHEDRA))
}
