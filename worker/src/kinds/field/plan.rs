//! Plan of a bake with a field: the tasks of a relightable bake, the probes, a task for each cell of them, and assemble.

use std::collections::BTreeMap;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskInput;
use lightkiln_proto::kinds::field::{FieldSettings, encode_tetrahedra};
use lightkiln_proto::kinds::{TaskKind, prt::Settings};
use serde_json::{Value, json};

use super::before::alike;
use super::{GatherParams, PLACEMENT_ARTEFACT, PROBES_ARTEFACT, Survey};
use crate::emitters::EmitterSet;
use crate::factors::{CELLS_ARTEFACT, cell_names, cells, encoded_cells};
use crate::geometry::Geometry;
use crate::kinds::prt;
use crate::reads::STAGE_ARTEFACT;
use crate::task::{Context, TaskError, TaskOutput, results_of};

/// Most probes of a cell: one factorisation.
const CELL_PROBES: u32 = 32;

/// Name of the cells of probes among outputs; tasks of probes see them as [`CELLS_ARTEFACT`].
const FIELD_CELLS: &str = "field-cells";

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
    let survey = survey(&geometry)?;
    let cells = cells(&survey.positions_m(), CELL_PROBES);
    let mut own = vec![(PROBES_ARTEFACT, survey.encoded()?), (FIELD_CELLS, encoded_cells(&cells)?)];
    if let (Some(role), Some(set)) = (tetrahedra, survey.tetrahedra()) {
        let chunk = encode_tetrahedra(&set)
            .map_err(|error| TaskError::bad_input_from("the tetrahedra cannot be stored", error))?;
        own.push((role, chunk));
    }
    if !survey.account.is_empty() {
        let account: BTreeMap<&String, u64> =
            survey.account.iter().map(|(name, count)| (name, *count)).collect();
        own.push((PLACEMENT_ARTEFACT, json!(account).to_string().into_bytes()));
    }
    let input = |name: &str, which: usize| TaskInput::Artefact {
        name: name.into(),
        digest: Digest::of(&own[which].1),
    };
    let stage = artefacts.iter().find(|(name, _)| name == STAGE_ARTEFACT).map(|(_, bytes)| Digest::of(bytes));
    let stage = stage.map(|digest| TaskInput::Artefact { name: STAGE_ARTEFACT.into(), digest });
    let emitters = EmitterSet::of(context, &geometry)?;
    let rays = field.probe_rays + relightable.transport.emitter_rays;
    let mut fields = Vec::new();
    for (cell, (of, name)) in cells.iter().zip(cell_names(&cells)).enumerate() {
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
        inputs.extend([input(PROBES_ARTEFACT, 0), input(CELLS_ARTEFACT, 1)]);
        inputs.extend(stage.clone());
        let cost = of.receivers.len() as u64 * u64::from(rays) / 1000 + 1;
        let alike = alike(&common, *gather, &survey, (of, &of_cell), geometry.near_bounds_m(), &emitters);
        let task = gather.task(format!("field {name}"), json!(of_cell), inputs, cost);
        fields.push(task.alike(alike));
    }
    let mut inputs = context.as_inputs(|_| true);
    inputs.extend(results);
    inputs.push(input(PROBES_ARTEFACT, 0));
    inputs.extend(own.iter().zip(0..).skip(2).map(|((role, _), which)| input(role, which)));
    inputs.extend(results_of(&fields));
    plan.extend(fields);
    let (assemble, params) = assemble;
    plan.push(assemble.task("bundle", params.clone(), inputs, 1));
    let counters = [
        ("probes", survey.probes.len() as u64),
        ("probes_in_cells", survey.in_cells),
        ("places_inside", survey.inside),
    ];
    let placement = survey.account.iter().map(|(name, count)| (name.clone(), *count as f64));
    let counters = counters.map(|(name, count)| (name.to_owned(), count as f64)).into_iter().chain(placement);
    let counters = counters.collect();
    artefacts.extend(own.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)));
    Ok(TaskOutput { artefacts, plan, counters, ..TaskOutput::default() })
}
