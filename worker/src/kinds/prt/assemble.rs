//! Task `prt.assemble`: the manifest's body, its clusters and the report.

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::prt::{Body, NAME, PATCHES, Settings};
use lightkiln_proto::manifest::{CLUSTERS, ChunkRef, ClusterRow, OVERVIEW};
use lightkiln_proto::voxels::VOXELS;
use serde_json::Value;

use super::plan::{PATCH_SET, lit_by_walks};
use super::{BakeParams, overview};
use crate::assemble::{KindPart, assembled, chunk_refs};
use crate::factors::CellIndex;
use crate::kinds::voxels;
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::task::{Context, TaskError, TaskOutput, params};

/// The part of a manifest and of its report that is a relightable bake's, whatever its kind.
pub struct Assembled {
    /// Body.
    pub body: Body,
    /// Clusters.
    pub clusters: Vec<ClusterRow>,
    /// Chunks by role.
    pub chunks: Vec<(&'static str, Vec<ChunkRef>)>,
    /// The report.
    pub report: Value,
}

impl Assembled {
    /// Of a task's inputs: the outputs of the scene tasks, `patch-set`, `cluster/N/…` of every cell, `overview/…` and `voxels/…`, each of the last two
    /// where there are some.
    pub fn of(context: &Context, settings: &Settings) -> Result<Self, TaskError> {
        let index = CellIndex::of_inputs(context)?;
        let report = index.report(settings.patches.rank_error);
        let patches = PatchTree::of(context)?.patches.len() as u64;
        let mut voxels = voxels::totals(context)?;
        if let Some(voxels) = &mut voxels {
            voxels.walked = lit_by_walks(&*World::of(context)?, settings);
        }
        let body = Body { totals: index.totals(), patches, voxels };
        let overview = chunk_refs(context, &format!("{OVERVIEW}/{}", overview::OUTPUT));
        let patches = chunk_refs(context, PATCH_SET);
        let mut chunks = vec![(CLUSTERS, index.chunks), (PATCHES, patches)];
        chunks.extend((!overview.is_empty()).then_some((OVERVIEW, overview)));
        if body.voxels.is_some() {
            chunks.push((VOXELS, voxels::chunks(context)));
        }
        Ok(Self { body, clusters: index.clusters, chunks, report })
    }
}

/// Runs the task: inputs of [`Assembled::of`].
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let BakeParams { settings, scene, .. } = params(task)?;
    let Assembled { body, clusters, chunks, report } = Assembled::of(context, &settings)?;
    assembled(
        context,
        KindPart { kind: NAME, scene, settings: &settings, body: &body, clusters, chunks },
        report,
    )
}
