//! Task `prt.assemble`: the manifest's body, its clusters and the report.

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::prt::{Body, NAME, PATCHES};
use lightkiln_proto::manifest::CLUSTERS;

use super::BakeParams;
use super::plan::PATCH_SET;
use crate::assemble::{KindPart, assembled, chunk_refs};
use crate::factors::CellIndex;
use crate::patches::PatchTree;
use crate::task::{Context, TaskError, TaskOutput, params};

/// Runs the task: inputs are the outputs of the scene tasks, `patch-set`, and `cluster/N/…` of every cell.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let index = CellIndex::of_inputs(context)?;
    let report = index.report(settings.patches.rank_error);
    let patches = PatchTree::of(context)?.patches.len() as u64;
    let body = Body { totals: index.totals(), patches };
    let chunks = vec![(CLUSTERS, index.chunks), (PATCHES, chunk_refs(context, PATCH_SET))];
    let clusters = index.clusters;
    assembled(
        context,
        KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks, report },
    )
}
