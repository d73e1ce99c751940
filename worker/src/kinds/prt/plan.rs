//! Task `prt.plan`: the chunk of patches, cluster cells, tasks of rays and of colours for each, the overview, and assemble; and the
//! manifest as far as it is known, for whoever follows the bake.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::kinds::OUTLINE_OUTPUT;
use lightkiln_proto::kinds::prt::{Body, NAME, PATCHES, Settings, tasks};
use lightkiln_proto::manifest::{ChunkRef, OVERVIEW};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::colourless::TRANSPORT_INPUT;
use super::{BakeParams, TracedSettings, TransportParams};
use crate::assemble::{self, KindPart};
use crate::emitters::EmitterSet;
use crate::factors::{CELLS_ARTEFACT, cell_names, cells, encoded_cells};
use crate::lightmap::World;
use crate::patches::{self, PatchTree};
use crate::reads::{Common, STAGE_ARTEFACT, alike};
use crate::scene::model::Scene;
use crate::task::{Context, TaskError, TaskOutput, params};

/// Name of the chunk of patches among outputs, and among the inputs of assemble.
pub const PATCH_SET: &str = "patch-set";
/// Rays cast for each of a receiver's own, in the estimate of costs: its links' tests among them.
const RAYS_PER_RAY: u64 = 2;

/// Tasks of a relightable bake, whatever else its kind plans.
pub struct Planned {
    /// `cells`, `stage`, `patch-set`.
    pub artefacts: Vec<(String, Vec<u8>)>,
    /// What all tasks of rays depend on.
    pub common: Common,
    /// Tasks of rays and of colours, and the overview.
    pub tasks: Vec<TaskSpec>,
    /// Inputs of assemble, beside the outputs of the scene tasks.
    pub results: Vec<TaskInput>,
}

/// Runs the task: inputs are the outputs of all scene tasks; outputs `cells`, `stage`, `patch-set`, `outline`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let Planned { mut artefacts, tasks: mut plan, results, .. } = planned(context, &bake.settings)?;
    let inputs = context.as_inputs(|_| true).into_iter().chain(results).collect();
    plan.push(tasks::ASSEMBLE.task("bundle", json!(bake), inputs, 1));
    let (world, tree) = (World::of(context)?, PatchTree::of(context)?);
    let patch_set = artefacts.iter().find(|(name, _)| name == PATCH_SET).map_or(&[][..], |(_, bytes)| bytes);
    let outline = outline(context, &bake, &world.geometry.scene, &tree, patch_set)?;
    artefacts.push((OUTLINE_OUTPUT.to_owned(), outline));
    Ok(TaskOutput { artefacts, plan, ..TaskOutput::default() })
}

/// The tasks over the outputs of all scene tasks, which are a context's inputs.
pub fn planned(context: &Context, settings: &Settings) -> Result<Planned, TaskError> {
    let traced = TracedSettings::from(settings);
    let world = World::of(context)?;
    let tree = PatchTree::of(context)?;
    let emitters = EmitterSet::of(context, &world.geometry)?;
    let cells = cells(&world.lightmap.positions_m(), settings.factors.cluster_receivers);
    let (common, stage) = Common::of(&world, &tree, &emitters, &(tasks::TRANSPORT.version, &traced));
    let own = [
        (CELLS_ARTEFACT, encoded_cells(&cells)?),
        (STAGE_ARTEFACT, stage.encoded()?),
        (PATCH_SET, patches::encoded(&tree, &world.lightmap, settings.patches.sky_parts)?),
    ];
    let input = |(name, bytes): &(&str, Vec<u8>)| TaskInput::Artefact {
        name: (*name).into(),
        digest: Digest::of(bytes),
    };

    let names: Vec<Digest> =
        cells.par_iter().map(|cell| alike(&world, &common, &cell.bounds_m, &cell.receivers)).collect();
    let (mut rays, mut colours) = (Vec::new(), Vec::new());
    for (cluster, ((cell, label), name)) in cells.iter().zip(cell_names(&cells)).zip(names).enumerate() {
        let cost = cell.receivers.len() as u64 * u64::from(settings.transport.transport_rays);
        let mut inputs = context.as_inputs(is_read_by_transport);
        inputs.extend(own[..2].iter().map(input));
        let of_cell = json!(TransportParams { cluster, settings: traced.clone() });
        let label = format!("cluster {label}");
        let cost = RAYS_PER_RAY * cost / 1000;
        let transport = tasks::TRANSPORT.task(label.clone(), of_cell, inputs, cost).alike(name);
        let mut inputs = context.as_inputs(is_read_by_colour);
        inputs.push(TaskInput::Task { name: TRANSPORT_INPUT.into(), key: transport.key });
        colours.push(tasks::COLOUR.task(label, Value::Null, inputs, cell.receivers.len() as u64 / 1000 + 1));
        rays.push(transport);
    }
    let mut results = vec![input(&own[2])];
    results.extend(crate::task::results_of(&colours));
    let cost = world.lightmap.receivers.len() as u64 / 100 + 1;
    let overview = tasks::OVERVIEW.task(OVERVIEW, Value::Null, results.clone(), cost);
    results.extend(crate::task::results_of(std::slice::from_ref(&overview)));
    let tasks = rays.into_iter().chain(colours).chain([overview]).collect();
    let artefacts = own.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect();
    Ok(Planned { artefacts, common, tasks, results })
}

/// The manifest of a bake that has no clusters yet.
fn outline(
    context: &Context,
    BakeParams { settings, scene: bundle, .. }: &BakeParams,
    scene: &Scene,
    tree: &PatchTree,
    patch_set: &[u8],
) -> Result<Vec<u8>, TaskError> {
    let body = Body { patches: tree.patches.len() as u64, ..Body::default() };
    let patches = ChunkRef { digest: Digest::of(patch_set), bytes: patch_set.len() as u64 };
    let (clusters, chunks) = (Vec::new(), vec![(PATCHES, vec![patches])]);
    let part = KindPart { kind: NAME, scene: *bundle, settings, body: &body, clusters, chunks };
    Ok(assemble::stored(context, scene, part)?.json)
}

fn is_read_by_colour(name: &str) -> bool {
    ["import/scene", "unwrap/", "place/"].iter().any(|read| name.starts_with(read))
}

/// Whether an output of the scene tasks is an input of tasks that cast rays.
pub fn is_read_by_transport(name: &str) -> bool {
    ["import/scene", "unwrap/", "place/", "patches/"].iter().any(|read| name.starts_with(read))
}
