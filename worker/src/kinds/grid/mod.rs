//! Kind `grid`: a relightable bake with a field, light at probes in free space on a lattice (METHOD.md §2.13).
//!
//! `grid.plan` (all of `prt.plan`, probes) → `prt.transport`, and `grid.gather` by cell of probes → `grid.lit` by cell of receivers that probes
//! light → `prt.colour`, `prt.overview` → `grid.assemble`.

mod cells;
mod standing;
mod survey;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::grid::{NAME, Settings, first_tasks, tasks};
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
pub struct Grid;

impl BakeKind for Grid {
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
        Ok(Box::new(field::evaluated(
            kinds,
            manifest,
            first,
            &settings.relightable(),
            None,
            (bytes, progress),
        )?))
    }
}

type BakeParams = super::BakeParams<Settings>;

/// Task `grid.plan`.
fn plan(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let plan = FieldPlan {
        relightable: bake.settings.relightable(),
        field: &bake.settings.field,
        is_fitted: bake.settings.lattice.field_fit == 1,
        lit_by_probes: &bake.settings.lit,
        gather: tasks::GATHER,
        lit: tasks::LIT,
        assemble: (tasks::ASSEMBLE, json!(bake)),
        tetrahedra: None,
    };
    let settings = (&bake.settings.field, &bake.settings.lattice);
    field::planned(context, &plan, |geometry| survey(geometry, settings, context.progress))
}

/// Task `grid.assemble`.
fn assemble(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    field::field_assembled(context, (NAME, scene), &settings, &settings.relightable(), None)
}
