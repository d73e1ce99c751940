//! Task `grid.assemble`: the manifest's body, its clusters and fields, and the report.

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::grid::{Body, FIELD, FieldTotals, NAME};
use lightkiln_proto::manifest::ChunkRef;
use serde_json::json;

use super::gather::Account;
use super::{BakeParams, Survey};
use crate::assemble::{KindPart, assembled};
use crate::kinds::prt;
use crate::task::{Context, TaskError, TaskOutput, params};

/// Runs the task: inputs are those of `prt.assemble`, `probes`, and `field/…` of every cell of probes.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let relightable = prt::Assembled::of(context, &settings.relightable())?;
    let survey = Survey::of(context)?;
    let account = account(context)?;
    let field = FieldTotals {
        spacing_m: survey.spacing_m,
        probes: account.probes,
        inside: survey.inside,
        mean_rank: account.ranks as f64 / account.probes.max(1) as f64,
    };
    let prt::Assembled { body, clusters, mut chunks, mut report } = relightable;
    report["field"] = json!(field);
    let body = Body { totals: body.totals, patches: body.patches, field };
    chunks.push((FIELD, chunks_of(context)));
    assembled(
        context,
        KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks },
        report,
    )
}

/// Sums over all cells.
fn account(context: &Context) -> Result<Account, TaskError> {
    let mut all = Account::default();
    for artefact in context.inputs.iter().filter(|artefact| is_of_field(&artefact.name, "/account")) {
        let bytes = context.source.get(artefact.digest)?;
        let part: Account = serde_json::from_slice(&bytes)
            .map_err(|error| TaskError::bad_input_from("the account of probes cannot be read", error))?;
        all.probes += part.probes;
        all.ranks += part.ranks;
    }
    Ok(all)
}

/// Chunks of all cells, in the order of the plan.
fn chunks_of(context: &Context) -> Vec<ChunkRef> {
    let named = context.inputs.iter().filter(|artefact| is_of_field(&artefact.name, "/chunk/"));
    named.map(|artefact| ChunkRef { digest: artefact.digest, bytes: artefact.bytes }).collect()
}

fn is_of_field(name: &str, which: &str) -> bool {
    name.starts_with("field/") && name.contains(which)
}
