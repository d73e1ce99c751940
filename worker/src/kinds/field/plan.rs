//! Plan of a bake with a field: the tasks of a relightable bake, the probes, a task for each cell of them, and assemble.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskInput;
use lightkiln_proto::kinds::field::{FieldSettings, LitSettings};
use lightkiln_proto::kinds::{TaskKind, prt::Settings};
use serde_json::{Value, json};

use super::before::alike;
use super::lit::{LitParams, by_light};
use super::{GatherParams, Survey, Surveyed};
use crate::emitters::EmitterSet;
use crate::factors::{CELLS_ARTEFACT, cell_names, encoded_cells};
use crate::geometry::Geometry;
use crate::kinds::prt;
use crate::lightmap::World;
use crate::reads::{self, STAGE_ARTEFACT};
use crate::task::{Context, TaskError, TaskOutput, results_of};

/// Name of the cells of receivers that have the field's light among outputs; their tasks see them as [`CELLS_ARTEFACT`].
const LIT_CELLS: &str = "lit-cells";

/// Settings and task kinds of a bake with a field, for its plan.
pub struct FieldPlan<'a> {
    /// Settings of surfaces.
    pub relightable: Settings,
    /// Settings of probes.
    pub field: &'a FieldSettings,
    /// Whether probes are fitted to light between them.
    pub is_fitted: bool,
    /// Settings of surfaces that have the field's light.
    pub lit_by_probes: &'a LitSettings,
    /// Task of some probes.
    pub gather: TaskKind,
    /// Task of some receivers of such surfaces.
    pub lit: TaskKind,
    /// The last task, and its parameters.
    pub assemble: (TaskKind, Value),
    /// Role of the chunk of tetrahedra, where there are some.
    pub tetrahedra: Option<&'static str>,
}

/// Runs the plan of a kind: inputs are the outputs of all scene tasks; outputs those of `prt.plan` but its outline, `probes`,
/// `field-cells`, the chunk of tetrahedra, and `placement`, counts, and `lit-cells`, where there are some.
pub fn planned(
    context: &Context,
    plan: &FieldPlan<'_>,
    survey: impl FnOnce(&Geometry) -> Result<Survey, TaskError>,
) -> Result<TaskOutput, TaskError> {
    let FieldPlan { relightable, field, is_fitted, lit_by_probes, gather, lit, assemble, tetrahedra } = plan;
    let world = World::of(context)?;
    let geometry = &world.geometry;
    let [own, of_field] = by_light(&geometry.scene, &world.lightmap, lit_by_probes);
    let mut surfaces = prt::planned(context, relightable, &own)?;
    let surveyed = Surveyed::of(survey(geometry)?, *tetrahedra)?;
    let stage = surfaces.input(STAGE_ARTEFACT);
    let emitters = EmitterSet::of(context, geometry)?;
    let rays = field.probe_rays + relightable.transport.emitter_rays;
    let mut fields = Vec::new();
    for (cell, (of, name)) in surveyed.cells.iter().zip(cell_names(&surveyed.cells)).enumerate() {
        let of_cell = GatherParams {
            cell,
            sky_parts: relightable.patches.sky_parts,
            patches_max: relightable.patches.patches_max,
            rank_max: relightable.factors.rank_max,
            emitter_rays: relightable.transport.emitter_rays,
            is_fitted: *is_fitted,
            field: (*field).clone(),
        };
        let mut inputs = context.as_inputs(prt::is_read_by_transport);
        inputs.extend(surveyed.inputs_of_gather());
        inputs.push(stage.clone());
        let cost = of.receivers.len() as u64 * u64::from(rays) / 1000 + 1;
        let bounds_m = geometry.near_bounds_m();
        let alike = alike(&surfaces.common, *gather, &surveyed.survey, (of, &of_cell), bounds_m, &emitters);
        let task = gather.task(format!("field {name}"), json!(of_cell), inputs, cost);
        fields.push(task.alike(alike));
    }
    let cells = prt::cells_of(&world.lightmap, &of_field, relightable);
    let encoded = encoded_cells(&cells)?;
    let lit_cells = TaskInput::Artefact { name: CELLS_ARTEFACT.into(), digest: Digest::of(&encoded) };
    for (cell, (of, name)) in cells.iter().zip(cell_names(&cells)).enumerate() {
        let of_cell =
            LitParams { cell, settings: relightable.clone(), tetrahedra: tetrahedra.map(str::to_owned) };
        let mut inputs = context.as_inputs(prt::is_read_by_transport);
        inputs.push(lit_cells.clone());
        inputs.push(stage.clone());
        inputs.extend(surveyed.tetrahedra());
        inputs.extend(results_of(&fields));
        let receivers = reads::alike(&world, &surfaces.common, &of.bounds_m, &of.receivers);
        // Which of the cells it is says nothing about it.
        let all = json!([lit.name, lit.version, LitParams { cell: 0, ..of_cell.clone() }, receivers]);
        let alike = surfaces.common.name(all.to_string().as_bytes());
        let cost = of.receivers.len() as u64 / 100 + 1;
        let task = lit.task(format!("cluster lit {name}"), json!(of_cell), inputs, cost);
        surfaces.add(context, task.alike(alike), of.receivers.len());
    }
    let (mut plan, results) = surfaces.tasks();
    let mut inputs = context.as_inputs(|_| true);
    inputs.extend(results);
    inputs.extend(surveyed.inputs_of_assemble());
    inputs.extend(results_of(&fields));
    plan.extend(fields);
    let (assemble, params) = assemble;
    plan.push(assemble.task("bundle", params.clone(), inputs, 1));
    let counters = surveyed.counters();
    let mut artefacts = surfaces.artefacts;
    artefacts.extend(surveyed.into_artefacts());
    if !cells.is_empty() {
        artefacts.push((LIT_CELLS.to_owned(), encoded));
    }
    Ok(TaskOutput { artefacts, plan, counters, ..TaskOutput::default() })
}
