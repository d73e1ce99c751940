//! Kind `captured`: light at probes in free space under the lights of the scene's file, which cannot change afterwards (METHOD.md §2.14).
//!
//! `captured.plan` (probes, on a lattice or in tetrahedra) → `captured.gather` by cell of probes → `captured.assemble`. No surface has
//! receivers or patches: probes light them too.

mod evaluated;
mod gather;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::captured::{Body, NAME, Settings, Structure, TETRAHEDRA, tasks};
use lightkiln_proto::manifest::Manifest;
use serde_json::json;

use super::field::{self, Assembled, Surveyed};
use super::{BakeKind, BakeKinds, TaskRow, cloud, grid};
use crate::assemble::{KindPart, assembled};
use crate::evaluate::{ChunkBytes, Evaluated, EvaluationError};
use crate::factors::cell_names;
use crate::geometry::Geometry;
use crate::reference::Lighting;
use crate::task::{Context, Progress, TaskError, TaskOutput, params, results_of};

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Captured;

impl BakeKind for Captured {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![
            TaskRow { name: tasks::PLAN.name, run: plan },
            TaskRow { name: tasks::GATHER.name, run: gather::run },
            TaskRow { name: tasks::ASSEMBLE.name, run: assemble },
        ]
    }

    fn error_classes(&self) -> Vec<&'static str> {
        field::CLASSES.into()
    }

    fn has_space(&self) -> bool {
        true
    }

    fn has_lightmap(&self) -> bool {
        false
    }

    fn is_relightable(&self) -> bool {
        false
    }

    fn evaluated(
        &self,
        kinds: &BakeKinds,
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: ChunkBytes,
        progress: &Progress,
    ) -> Result<Box<dyn Evaluated>, EvaluationError> {
        Ok(Box::new(evaluated::evaluated(kinds, manifest, scene, bytes, progress)?))
    }
}

type BakeParams = super::BakeParams<Settings>;

/// The light that is captured. Errors where the scene has none.
fn lighting(geometry: &Geometry) -> Result<Lighting, TaskError> {
    field::light_of_file(geometry).ok_or_else(|| {
        TaskError::bad_input(
            "a bake of kind 'captured' has the light of the scene file's lights, and the file has none; add lights or emissive surfaces to \
             it, or bake another kind, whose light can be chosen afterwards",
        )
    })
}

/// Role of the chunk of tetrahedra, if there are some.
fn role_of(settings: &Settings) -> Option<&'static str> {
    matches!(settings.capture.structure(), Structure::Tetrahedra(_)).then_some(TETRAHEDRA)
}

/// Task `captured.plan`: inputs are the outputs of all scene tasks.
fn plan(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let Settings { field, capture, .. } = &bake.settings;
    let geometry = Geometry::of(context)?;
    lighting(&geometry)?;
    let survey = match capture.structure() {
        Structure::Lattice(lattice) => grid::survey(&geometry, (field, &lattice), context.progress)?,
        Structure::Tetrahedra(cloud) => cloud::survey(&geometry, (field, &cloud), context.progress)?,
    };
    let surveyed = Surveyed::of(survey, role_of(&bake.settings))?;
    let rays = field.probe_rays * (1 + capture.field_paths) + capture.field_emitter_rays;
    let mut of_cells = Vec::new();
    for (cell, (of, name)) in surveyed.cells.iter().zip(cell_names(&surveyed.cells)).enumerate() {
        let params = gather::Params { cell, field: field.clone(), capture: capture.clone() };
        let mut inputs = context.as_inputs(|name| name.starts_with("import/scene"));
        inputs.extend(surveyed.inputs_of_gather());
        let cost = of.receivers.len() as u64 * u64::from(rays) / 1000 + 1;
        of_cells.push(tasks::GATHER.task(format!("field {name}"), json!(params), inputs, cost));
    }
    let mut inputs = context.as_inputs(|_| true);
    inputs.extend(surveyed.inputs_of_assemble());
    inputs.extend(results_of(&of_cells));
    of_cells.push(tasks::ASSEMBLE.task("bundle", json!(bake), inputs, 1));
    let counters = surveyed.counters();
    let artefacts = surveyed.into_artefacts();
    Ok(TaskOutput { artefacts, plan: of_cells, counters, ..TaskOutput::default() })
}

/// Task `captured.assemble`: inputs are the outputs of all scene tasks, `probes`, the chunk of tetrahedra, and `field/…` of every cell.
fn assemble(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let Assembled { totals: field, chunks } = Assembled::of(context, role_of(&settings))?;
    let report = json!({ "field": field });
    let body = Body { field };
    let part = KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters: Vec::new(), chunks };
    assembled(context, part, report)
}
