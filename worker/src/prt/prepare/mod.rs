//! Prepare task: unwrap, receivers, probes or patches, clusters, what is drawn, and the plan of the rest.

mod candidates;
mod cavities;
mod clusters;
mod coverage;
mod drawing;
mod lattice;
mod links;
mod patches;
mod plan;
mod polygon;
mod pools;
mod probes;
mod radius;
mod receivers;
mod shift;
mod texels;
mod unwraps;

pub(super) use clusters::halves;
pub(super) use probes::kernel;

use std::collections::BTreeMap;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::prt::{BasisKind, Settings};
use serde::Deserialize;

use super::artefact;
use super::runner::{Context, checked, decode_images};
use super::stage::{self, PatchTree, Stage};
use super::world::{Geometry, World};
use crate::task::{TaskError, TaskOutput};

/// Probes to aim at when the basis is patches.
const VANTAGE_PROBES: u32 = 40;

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// Settings of the bake.
    pub settings: Settings,
    /// Scene bundle, named in the manifest.
    pub scene: Digest,
}

/// Runs the task: inputs `import/scene`, `import/warnings`; outputs `stage`, `draws`, the chunks it names and those of patches.
pub fn run(context: &Context, params: &Params) -> Result<TaskOutput, TaskError> {
    let settings = &params.settings;
    checked(settings)?;
    let progress = context.progress;
    let scene = context.scene("import/scene")?;
    let scene_digest = context.digest("import/scene")?;
    let images = decode_images(&scene)?;
    progress.begin(0.0, 0.3, scene.instances.len() as u64);
    let texel_m = unwraps::texel_size_m(&scene, settings);
    let unwraps = unwraps::unwrap_instances(&scene, settings, texel_m, progress)?;
    let geometry = Geometry::new(&scene, &images);

    progress.begin(0.3, 0.6, 1);
    let mut blocks = receivers::blocks(&scene, &unwraps)?;
    let receivers =
        receivers::place(&scene, &images, &geometry, &unwraps, &mut blocks, settings, texel_m, progress)?;
    if receivers.is_empty() {
        return Err(TaskError::bad_input(format!(
            "no texel of {texel_m} m fits any surface: give a smaller texel_m, or more receivers_target"
        )));
    }
    let stage = Stage {
        scene: scene_digest,
        texel_m,
        probe_spacing_m: 0.0,
        first_block: receivers::first_blocks(&scene, &unwraps),
        unwraps,
        blocks,
        receivers,
        probes: Vec::new(),
        patches: PatchTree::default(),
        clusters: Vec::new(),
    };
    let mut world = World::with_geometry(scene, stage, images, geometry);
    let in_cavities = cavities::leave_out(&mut world, settings, progress)?;
    let (links, rays) = links::links(&world);
    progress.add_rays_occlusion(rays);
    world.stage.receivers.iter_mut().zip(links).for_each(|(receiver, links)| receiver.links = links);

    progress.begin(0.6, 0.9, 1);
    let mut counters = BTreeMap::new();
    counters.insert("texels_in_cavities".to_owned(), in_cavities as f64);
    match settings.basis {
        BasisKind::Sh => {
            let spacing_m = probes::spacing_m(&world, settings);
            world.stage.probe_spacing_m = spacing_m;
            let placed = probes::place(&world, settings, spacing_m, progress)?;
            counters.insert("probes_by_density".to_owned(), placed.len() as f64);
            world.stage.probes = coverage::complete(&world, settings, spacing_m, placed, progress)?;
            counters.insert("probes_total".to_owned(), world.stage.probes.len() as f64);
        }
        BasisKind::Patches => {
            // A few probes that light nothing: from them, cameras and lamps are chosen where a file has none.
            let few = Settings { probe_spacing_m: 0.0, probes_target: VANTAGE_PROBES, ..settings.clone() };
            let spacing_m = probes::spacing_m(&world, &few);
            world.stage.probe_spacing_m = spacing_m;
            world.stage.probes = probes::place(&world, &few, spacing_m, progress)?;
            for probe in &mut world.stage.probes {
                probe.radius_m = spacing_m;
            }
            world.stage.patches = patches::tree(&world)?;
            counters.insert("patches".to_owned(), world.stage.patches.patches.len() as f64);
        }
    }
    world.stage.clusters = clusters::cells(&world.stage, settings);

    progress.begin(0.9, 1.0, 1);
    let drawn = drawing::chunks(&world)?;
    let stage_bytes = artefact::encode(stage::MAGIC, &world.stage)?;
    let stage_digest = Digest::of(&stage_bytes);
    let patches = patches::chunk(&world.stage, settings)?;
    let plan = plan::tasks(&world.stage, stage_digest, context, params, &drawn, patches.as_deref())?;
    let mut artefacts = vec![("stage".to_owned(), stage_bytes)];
    artefacts.extend(drawn.into_artefacts());
    artefacts.extend(patches.map(|bytes| ("patches/0".to_owned(), bytes)));
    Ok(TaskOutput { artefacts, plan, counters })
}
