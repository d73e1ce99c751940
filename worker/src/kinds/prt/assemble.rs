//! Task `prt.assemble`: the manifest's body, its clusters and the report.

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::prt::{Body, NAME, PATCHES};
use lightkiln_proto::manifest::{CLUSTERS, OVERVIEW};

use super::plan::PATCH_SET;
use super::{BakeParams, overview};
use crate::assemble::{KindPart, assembled, chunk_refs};
use crate::factors::CellIndex;
use crate::patches::PatchTree;
use crate::task::{Context, TaskError, TaskOutput, params};

/// Runs the task: inputs are the outputs of the scene tasks, `patch-set`, `cluster/N/…` of every cell, and `overview/…`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let index = CellIndex::of_inputs(context)?;
    let report = index.report(settings.patches.rank_error);
    let patches = PatchTree::of(context)?.patches.len() as u64;
    let body = Body { totals: index.totals(), patches };
    let overview = chunk_refs(context, &format!("{OVERVIEW}/{}", overview::OUTPUT));
    let patches = chunk_refs(context, PATCH_SET);
    let chunks = vec![(CLUSTERS, index.chunks), (PATCHES, patches), (OVERVIEW, overview)];
    let clusters = index.clusters;
    assembled(
        context,
        KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks },
        report,
    )
}
