//! Task `prt.plan`: the chunk of patches, cluster cells, a transport task for each, and assemble.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::kinds::prt::tasks;
use serde_json::json;

use super::{BakeParams, TransportParams};
use crate::factors::{CELLS_ARTEFACT, cells, encoded_cells};
use crate::lightmap::{self, Lightmap};
use crate::patches::{self, PatchTree};
use crate::task::{Context, TaskError, TaskOutput, params};

/// Name of the chunk of patches among outputs, and among the inputs of assemble.
pub const PATCH_SET: &str = "patch-set";
/// Rays cast for each of a receiver's own, in the estimate of costs: its links' tests among them.
const RAYS_PER_RAY: u64 = 2;

/// Runs the task: inputs are the outputs of all scene tasks; outputs `cells`, `patch-set`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let settings = &bake.settings;
    let lightmap: Lightmap = context.decoded(lightmap::ARTEFACT_MAGIC, lightmap::ARTEFACT)?.0;
    let tree = PatchTree::of(context)?;
    let cells = cells(&lightmap.positions_m(), settings.factors.cluster_receivers);
    let cells_bytes = encoded_cells(&cells)?;
    let patches = patches::encoded(&tree, &lightmap, settings.patches.sky_parts)?;
    let own = [(CELLS_ARTEFACT, &cells_bytes), (PATCH_SET, &patches)];
    let own = own.map(|(name, bytes)| TaskInput::Artefact { name: name.into(), digest: Digest::of(bytes) });
    let scene_outputs = context.as_inputs(|_| true);

    let mut plan = Vec::new();
    for (cluster, cell) in cells.iter().enumerate() {
        let rays = cell.receivers.len() as u64 * u64::from(settings.transport.transport_rays);
        let mut inputs = context.as_inputs(is_read_by_transport);
        inputs.push(own[0].clone());
        let of_cell = json!(TransportParams { cluster, settings: settings.into() });
        let label = format!("cluster {cluster}");
        plan.push(tasks::TRANSPORT.task(label, of_cell, inputs, RAYS_PER_RAY * rays / 1000));
    }
    let mut inputs = scene_outputs;
    inputs.push(own[1].clone());
    inputs.extend(crate::task::results_of(&plan));
    plan.push(tasks::ASSEMBLE.task("bundle", json!(bake), inputs, 1));
    let artefacts = vec![(CELLS_ARTEFACT.to_owned(), cells_bytes), (PATCH_SET.to_owned(), patches)];
    Ok(TaskOutput { artefacts, plan, ..TaskOutput::default() })
}

fn is_read_by_transport(name: &str) -> bool {
    ["import/scene", "unwrap/", "place/", "patches/"].iter().any(|read| name.starts_with(read))
}
