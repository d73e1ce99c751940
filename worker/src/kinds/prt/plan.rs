//! Task `prt.plan`: the chunk of patches, cluster cells, tasks of rays and of colours for each, the overview, and assemble; and the
//! manifest as far as it is known, for whoever follows the bake.

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::kinds::prt::{Body, NAME, PATCHES, Settings, tasks};
use lightkiln_proto::kinds::voxels::{VoxelPresence, walked_part};
use lightkiln_proto::kinds::{OUTLINE_OUTPUT, TaskKind};
use lightkiln_proto::manifest::{ChunkRef, OVERVIEW};
use lightkiln_proto::voxels::WalkedBlocks;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::colourless::TRANSPORT_INPUT;
use super::{BakeParams, TracedSettings, TransportParams};
use crate::assemble::{self, KindPart};
use crate::emitters::EmitterSet;
use crate::factors::{CELLS_ARTEFACT, ClusterCell, cell_names, cells, encoded_cells};
use crate::kinds::voxels;
use crate::lightmap::{Lightmap, World};
use crate::patches::{self, PatchTree};
use crate::reads::{Common, STAGE_ARTEFACT, alike};
use crate::scene::model::{LitBy, MeshInstance, Scene};
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
    /// Tasks of rays, or of whatever else gives clusters without colours.
    rays: Vec<TaskSpec>,
    /// Tasks of their colours.
    colours: Vec<TaskSpec>,
    /// Tasks of voxels.
    voxels: Vec<TaskSpec>,
    /// Clusters have no factors.
    is_bare: bool,
}

/// Runs the task: inputs are the outputs of all scene tasks; outputs `cells`, `stage`, `patch-set`, `outline`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let (world, tree) = (World::of(context)?, PatchTree::of(context)?);
    let planned = planned(context, &bake.settings, &world.all_receivers())?;
    let (plan, mut artefacts) = planned.with_assemble(context, tasks::ASSEMBLE, json!(bake));
    let patch_set = artefacts.iter().find(|(name, _)| name == PATCH_SET).map_or(&[][..], |(_, bytes)| bytes);
    let outline = outline(context, &bake, &world.geometry.scene, &tree, patch_set)?;
    artefacts.push((OUTLINE_OUTPUT.to_owned(), outline));
    Ok(TaskOutput { artefacts, plan, ..TaskOutput::default() })
}

/// Receivers, ascending, and the task that casts their rays.
pub struct Rays<'a> {
    /// The task.
    pub task: TaskKind,
    /// Before the names of cells in labels.
    pub label: &'static str,
    /// Settings of what is traced.
    pub traced: TracedSettings,
    /// The same as a bake of such receivers has.
    pub settings: &'a Settings,
    /// The receivers.
    pub receivers: Vec<u32>,
}

/// The tasks over the outputs of all scene tasks, which are a context's inputs, for some receivers, ascending.
pub fn planned(context: &Context, settings: &Settings, receivers: &[u32]) -> Result<Planned, TaskError> {
    let [own, walked] = by_light(&*World::of(context)?, settings, receivers);
    let traced = TracedSettings::from(settings);
    let own = Rays { task: tasks::TRANSPORT, label: "cluster", traced, settings, receivers: own };
    let bare = walked_part(settings);
    let traced = TracedSettings::from(&bare).bare();
    let task = lightkiln_proto::kinds::voxels::tasks::RECEIVERS;
    let walked = Rays { task, label: "cluster walked", traced, settings: &bare, receivers: walked };
    let all: Vec<Rays<'_>> =
        [own].into_iter().chain((!walked.receivers.is_empty()).then_some(walked)).collect();
    planned_of(context, settings, &all)
}

/// By block whether its receivers have the light of walks.
fn is_walked(world: &World, settings: &Settings) -> Vec<bool> {
    let VoxelPresence { walk_lit_m, .. } = settings.has_voxels;
    let has_voxels = settings.has_voxels.is_on();
    let is_walked = |instance: &MeshInstance| {
        let is_small = || walk_lit_m > 0.0 && instance.size_m() <= walk_lit_m;
        has_voxels && instance.lit_by.map_or_else(is_small, |by| by == LitBy::Walks)
    };
    let by_instance: Vec<bool> = world.geometry.scene.instances.iter().map(is_walked).collect();
    world.lightmap.blocks.iter().map(|block| by_instance[block.instance as usize]).collect()
}

/// Of some receivers those whose light is that of their own rays, and those that have it from walks.
fn by_light(world: &World, settings: &Settings, receivers: &[u32]) -> [Vec<u32>; 2] {
    let is_walked = is_walked(world, settings);
    let of = |receiver: u32| is_walked[world.lightmap.receivers[receiver as usize].block as usize];
    let (walked, own) = receivers.iter().partition(|receiver| of(**receiver));
    [own, walked]
}

/// Blocks whose receivers have the light of walks.
pub fn lit_by_walks(world: &World, settings: &Settings) -> WalkedBlocks {
    let blocks = world.lightmap.blocks.iter().zip(is_walked(world, settings));
    WalkedBlocks::new(blocks.filter(|(_, is_walked)| *is_walked).map(|(block, _)| block.key).collect())
}

/// As [`planned`], with rays by other tasks.
pub fn planned_of(context: &Context, settings: &Settings, rays: &[Rays<'_>]) -> Result<Planned, TaskError> {
    let world = World::of(context)?;
    let tree = PatchTree::of(context)?;
    let emitters = EmitterSet::of(context, &world.geometry)?;
    let cells_by: Vec<Vec<ClusterCell>> =
        rays.iter().map(|of| cells_of(&world.lightmap, &of.receivers, of.settings)).collect();
    let cells: Vec<ClusterCell> = cells_by.iter().flatten().cloned().collect();
    let common = |of: &Rays<'_>| Common::of(&world, &tree, &emitters, &(of.task.version, &of.traced));
    let commons: Vec<_> = rays.iter().map(common).collect();
    let Some((common, stage)) = commons.first() else {
        return Err(TaskError::bad_input("no task casts rays"));
    };
    let own = [
        (CELLS_ARTEFACT, encoded_cells(&cells)?),
        (STAGE_ARTEFACT, stage.encoded()?),
        (PATCH_SET, patches::encoded(&tree, &world.lightmap, settings.patches.sky_parts)?),
    ];
    let artefacts: Vec<_> = own.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect();
    let (rays_of, colours, voxels_of) = (Vec::new(), Vec::new(), Vec::new());
    let is_bare = rays.iter().all(|of| of.traced.is_bare);
    let common = common.clone();
    let mut planned = Planned { artefacts, common, rays: rays_of, colours, voxels: voxels_of, is_bare };
    let of_all = [CELLS_ARTEFACT, STAGE_ARTEFACT].map(|name| planned.input(name));
    let mut cluster = 0;
    for ((of, cells), (common, _)) in rays.iter().zip(&cells_by).zip(&commons) {
        let names: Vec<Digest> =
            cells.par_iter().map(|cell| alike(&world, common, &cell.bounds_m, &cell.receivers)).collect();
        for ((cell, label), name) in cells.iter().zip(cell_names(cells)).zip(names) {
            let cost = cell.receivers.len() as u64 * u64::from(of.settings.transport.transport_rays);
            let mut inputs = context.as_inputs(is_read_by_transport);
            inputs.extend(of_all.iter().cloned());
            let of_cell = json!(TransportParams { cluster, settings: of.traced.clone() });
            let (label, cost) = (format!("{} {label}", of.label), RAYS_PER_RAY * cost / 1000);
            planned.add(
                context,
                of.task.task(label, of_cell, inputs, cost).alike(name),
                cell.receivers.len(),
            );
            cluster += 1;
        }
    }
    if settings.has_voxels.is_on() {
        let stage = planned.input(STAGE_ARTEFACT);
        planned.voxels = voxels::planned(context, &world, &settings.voxels, stage, &planned.common)?;
    }
    Ok(planned)
}

/// Cells of some receivers, ascending.
pub fn cells_of(lightmap: &Lightmap, receivers: &[u32], settings: &Settings) -> Vec<ClusterCell> {
    let positions_m: Vec<Vec3> =
        receivers.iter().map(|&receiver| lightmap.receivers[receiver as usize].position_m).collect();
    let mut cells = cells(&positions_m, settings.factors.cluster_receivers);
    for place in cells.iter_mut().flat_map(|cell| &mut cell.receivers) {
        *place = receivers[*place as usize];
    }
    cells
}

impl Planned {
    /// An artefact of the plan as an input.
    pub fn input(&self, name: &str) -> TaskInput {
        let bytes =
            self.artefacts.iter().find(|(other, _)| other == name).map_or(&[][..], |(_, bytes)| bytes);
        TaskInput::Artefact { name: name.into(), digest: Digest::of(bytes) }
    }

    /// All tasks, assemble last, and the artefacts.
    pub fn with_assemble(
        self,
        context: &Context,
        assemble: TaskKind,
        params: Value,
    ) -> (Vec<TaskSpec>, Vec<(String, Vec<u8>)>) {
        let (mut plan, results) = self.tasks();
        let inputs = context.as_inputs(|_| true).into_iter().chain(results).collect();
        plan.push(assemble.task("bundle", params, inputs, 1));
        (plan, self.artefacts)
    }

    /// Adds a task whose outputs are those of `prt.transport`, of so many receivers, and that of its colours.
    pub fn add(&mut self, context: &Context, transport: TaskSpec, receivers: usize) {
        let mut inputs = context.as_inputs(is_read_by_colour);
        inputs.push(TaskInput::Task { name: TRANSPORT_INPUT.into(), key: transport.key });
        let cost = receivers as u64 / 1000 + 1;
        self.colours.push(tasks::COLOUR.task(transport.label.clone(), Value::Null, inputs, cost));
        self.rays.push(transport);
    }

    /// All tasks, the overview among them where clusters have factors, and the inputs of assemble beside the outputs of the scene tasks.
    pub fn tasks(&self) -> (Vec<TaskSpec>, Vec<TaskInput>) {
        let mut results = vec![self.input(PATCH_SET)];
        results.extend(crate::task::results_of(&self.colours));
        // Those of colours take a thousandth of their receivers each, and one more.
        let cost = 10 * self.colours.iter().map(|task| task.cost).sum::<u64>() + 1;
        let overview = || tasks::OVERVIEW.task(OVERVIEW, Value::Null, results.clone(), cost);
        let overview: Vec<TaskSpec> = (!self.is_bare).then(overview).into_iter().collect();
        results.extend(crate::task::results_of(&overview));
        results.extend(crate::task::results_of(&self.voxels));
        let tasks = self.rays.iter().chain(&self.colours).chain(&overview).chain(&self.voxels);
        let tasks = tasks.cloned().collect();
        (tasks, results)
    }
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
