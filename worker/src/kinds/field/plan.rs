//! Plan of a bake with a field: the tasks of a relightable bake, the probes, a task for each cell of them, and assemble.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskInput;
use lightkiln_proto::kinds::field::FieldSettings;
use lightkiln_proto::kinds::{TaskKind, prt::Settings};
use serde_json::{Value, json};

use super::before::alike;
use super::{GatherParams, Survey, Surveyed};
use crate::emitters::EmitterSet;
use crate::factors::cell_names;
use crate::geometry::Geometry;
use crate::kinds::prt;
use crate::reads::STAGE_ARTEFACT;
use crate::task::{Context, TaskError, TaskOutput, results_of};

/// Settings and task kinds of a bake with a field, for its plan.
pub struct FieldPlan<'a> {
    /// Settings of surfaces.
    pub relightable: Settings,
    /// Settings of probes.
    pub field: &'a FieldSettings,
    /// Whether probes are fitted to light between them.
    pub is_fitted: bool,
    /// Task of some probes.
    pub gather: TaskKind,
    /// The last task, and its parameters.
    pub assemble: (TaskKind, Value),
    /// Role of the chunk of tetrahedra, where there are some.
    pub tetrahedra: Option<&'static str>,
}

/// Runs the plan of a kind: inputs are the outputs of all scene tasks; outputs those of `prt.plan` but its outline, `probes`,
/// `field-cells`, the chunk of tetrahedra, and `placement`, counts, where there are some.
pub fn planned(
    context: &Context,
    plan: &FieldPlan<'_>,
    survey: impl FnOnce(&Geometry) -> Result<Survey, TaskError>,
) -> Result<TaskOutput, TaskError> {
    let FieldPlan { relightable, field, is_fitted, gather, assemble, tetrahedra } = plan;
    let prt::Planned { mut artefacts, common, tasks: mut plan, results } =
        prt::planned(context, relightable)?;
    let geometry = Geometry::of(context)?;
    let surveyed = Surveyed::of(survey(&geometry)?, *tetrahedra)?;
    let stage = artefacts.iter().find(|(name, _)| name == STAGE_ARTEFACT).map(|(_, bytes)| Digest::of(bytes));
    let stage = stage.map(|digest| TaskInput::Artefact { name: STAGE_ARTEFACT.into(), digest });
    let emitters = EmitterSet::of(context, &geometry)?;
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
        inputs.extend(stage.clone());
        let cost = of.receivers.len() as u64 * u64::from(rays) / 1000 + 1;
        let bounds_m = geometry.near_bounds_m();
        let alike = alike(&common, *gather, &surveyed.survey, (of, &of_cell), bounds_m, &emitters);
        let task = gather.task(format!("field {name}"), json!(of_cell), inputs, cost);
        fields.push(task.alike(alike));
    }
    let mut inputs = context.as_inputs(|_| true);
    inputs.extend(results);
    inputs.extend(surveyed.inputs_of_assemble());
    inputs.extend(results_of(&fields));
    plan.extend(fields);
    let (assemble, params) = assemble;
    plan.push(assemble.task("bundle", params.clone(), inputs, 1));
    let counters = surveyed.counters();
    artefacts.extend(surveyed.into_artefacts());
    Ok(TaskOutput { artefacts, plan, counters, ..TaskOutput::default() })
}
