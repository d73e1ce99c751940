//! Task `sh.assemble`: the manifest's body, its clusters and the report.

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::sh::{Body, NAME, PROBES};
use lightkiln_proto::manifest::CLUSTERS;
use serde_json::json;

use super::{BakeParams, ProbeSet};
use crate::assemble::{KindPart, assembled, chunk_refs};
use crate::factors::CellIndex;
use crate::task::{Context, TaskError, TaskOutput, params};

/// Runs the task: inputs are the outputs of the scene tasks, `probes`, `probes/N/chunk` of every batch, and `cluster/N/…`
/// of every cell.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let index = CellIndex::of_inputs(context)?;
    let totals = index.totals();
    let set = ProbeSet::of(context)?;
    let mut report = index.report(settings.probes.rank_error);
    report["probe_spacing_m"] = json!(set.spacing_m);
    report["uncovered_bound_met"] =
        json!(totals.uncovered_fraction <= f64::from(settings.probes.uncovered_max));
    let body = Body { totals, probes: set.probes.len() as u64, probe_spacing_m: set.spacing_m };
    let chunks = vec![(CLUSTERS, index.chunks), (PROBES, chunk_refs(context, "probes/"))];
    let clusters = index.clusters;
    assembled(
        context,
        KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks },
        report,
    )
}
