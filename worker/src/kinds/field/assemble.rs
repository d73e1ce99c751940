//! Assemble of a bake with a field: the manifest's body, its clusters and fields, and the report.

use std::collections::BTreeMap;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::field::{Body, FIELD, FieldTotals};
use lightkiln_proto::kinds::prt::Settings;
use lightkiln_proto::manifest::ChunkRef;
use serde::Serialize;
use serde_json::json;

use super::gather::Account;
use super::{PLACEMENT_ARTEFACT, Survey};
use crate::assemble::{KindPart, assembled};
use crate::kinds::prt;
use crate::task::{Context, TaskError, TaskOutput};

/// Runs the last task of a kind: inputs are those of `prt.assemble`, `probes`, the chunk of tetrahedra where it has that `role`, and `field/…` of
/// every cell of probes.
pub fn field_assembled(
    context: &Context,
    (kind, scene): (&'static str, Digest),
    settings: &impl Serialize,
    relightable: &Settings,
    role: Option<&'static str>,
) -> Result<TaskOutput, TaskError> {
    let relightable = prt::Assembled::of(context, relightable)?;
    let Assembled { totals: field, chunks: of_field } = Assembled::of(context, role)?;
    let prt::Assembled { body, clusters, mut chunks, mut report } = relightable;
    report["field"] = json!(field);
    let body = Body { totals: body.totals, patches: body.patches, field, voxels: body.voxels };
    chunks.extend(of_field);
    assembled(context, KindPart { kind, scene, settings, body: &body, clusters, chunks }, report)
}

/// The part of a manifest that is a field's.
pub struct Assembled {
    /// Sums over its probes.
    pub totals: FieldTotals,
    /// Its chunks by role.
    pub chunks: Vec<(&'static str, Vec<ChunkRef>)>,
}

impl Assembled {
    /// Of a task's inputs: `probes`, the chunk of tetrahedra where it has that `role`, and `field/…` of every cell of probes.
    pub fn of(context: &Context, role: Option<&'static str>) -> Result<Self, TaskError> {
        let survey = Survey::of(context)?;
        let account = account(context)?;
        let totals = FieldTotals {
            spacing_m: survey.spacing_m,
            probes: account.probes,
            inside: survey.inside,
            mean_rank: account.ranks as f64 / account.probes.max(1) as f64,
            placement: placement(context)?,
        };
        let mut chunks = vec![(FIELD, field_chunks(context))];
        if let Some(role) = role {
            chunks.push((role, chunks_of(context, |name| name == role)));
        }
        Ok(Self { totals, chunks })
    }
}

/// Counts of how probes were placed, where there are some.
fn placement(context: &Context) -> Result<BTreeMap<String, u64>, TaskError> {
    let Some(artefact) = context.inputs.iter().find(|artefact| artefact.name == PLACEMENT_ARTEFACT) else {
        return Ok(BTreeMap::new());
    };
    serde_json::from_slice(&context.source.get(artefact.digest)?)
        .map_err(|error| TaskError::bad_input_from("the account of the placement cannot be read", error))
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

/// Chunks of all cells of probes among the inputs, in the order of the plan.
pub fn field_chunks(context: &Context) -> Vec<ChunkRef> {
    chunks_of(context, |name| is_of_field(name, "/chunk/"))
}

/// Chunks among the inputs, in the order of the plan.
fn chunks_of(context: &Context, is_one: impl Fn(&str) -> bool) -> Vec<ChunkRef> {
    let named = context.inputs.iter().filter(|artefact| is_one(&artefact.name));
    named.map(|artefact| ChunkRef { digest: artefact.digest, bytes: artefact.bytes }).collect()
}

fn is_of_field(name: &str, which: &str) -> bool {
    name.starts_with("field/") && name.contains(which)
}
