//! Assemble task: manifest and report of a finished bake.

mod materials;
mod pages;

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, MANIFEST_OUTPUT, REPORT_OUTPUT};
use lightkiln_proto::manifest::{Block, ChunkRef, ClusterRef, FORMAT, Manifest, Totals, VERSION};
use lightkiln_proto::prt::Settings;
use serde::Deserialize;
use serde_json::{Value, json};

use super::runner::Context;
use super::transport::CellIndex;
use super::world::World;
use crate::task::{TaskError, TaskOutput};

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    settings: Settings,
    /// Scene bundle.
    scene: Digest,
}

/// Clusters that the report lists as the worst.
const WORST: usize = 10;

/// Runs the task: inputs are `scene`, `stage`, `warnings` and every chunk; outputs the manifest and the report.
pub fn run(context: &Context, params: &Params) -> Result<TaskOutput, TaskError> {
    let world = context.world()?;
    let index = index(context)?;
    let s1_bounds = index.s1_criterion_bounds.clone();
    let manifest = manifest(context, params, &world, index)?;
    let report = report(context, &manifest, &s1_bounds)?;
    // By way of a JSON value: its maps are sorted, which makes the manifest canonical.
    let canonical = serde_json::to_value(&manifest)
        .map_err(|error| TaskError::bad_input_from("the manifest cannot be written", error))?;
    Ok(TaskOutput {
        artefacts: vec![
            (MANIFEST_OUTPUT.into(), canonical.to_string().into_bytes()),
            (REPORT_OUTPUT.into(), report.to_string().into_bytes()),
        ],
        ..TaskOutput::default()
    })
}

/// All clusters in the order of the plan, and sums over all cells.
fn index(context: &Context) -> Result<CellIndex, TaskError> {
    let mut all = CellIndex::default();
    for artefact in context.inputs {
        if artefact.name.starts_with("cluster/") && artefact.name.ends_with("/index") {
            let bytes = context.source.get(artefact.digest)?;
            let part: CellIndex = serde_json::from_slice(&bytes)
                .map_err(|error| TaskError::bad_input_from("the index of a cluster cannot be read", error))?;
            all.clusters.extend(part.clusters);
            all.s1_criterion_bounds.extend(part.s1_criterion_bounds);
            all.lit += part.lit;
            all.uncovered += part.uncovered;
            all.left_out += part.left_out;
            all.receivers_without_light += part.receivers_without_light;
        }
    }
    Ok(all)
}

fn chunk_refs(inputs: &[Artefact], prefix: &str) -> Vec<ChunkRef> {
    let named = inputs.iter().filter(|artefact| artefact.name.starts_with(prefix));
    named.map(|artefact| ChunkRef { digest: artefact.digest, bytes: artefact.bytes }).collect()
}

fn manifest(
    context: &Context,
    params: &Params,
    world: &World,
    index: CellIndex,
) -> Result<Manifest, TaskError> {
    let (scene, stage) = (&world.scene, &world.stage);
    let mut order: Vec<usize> = (0..stage.blocks.len()).collect();
    order.sort_by_key(|&index| stage.blocks[index].key);
    let sizes: Vec<[u32; 2]> = order.iter().map(|&index| stage.blocks[index].size).collect();
    let pages = pages::pack(&sizes);
    let blocks = order
        .iter()
        .zip(&pages.places)
        .map(|(&index, &(page, origin))| {
            let block = &stage.blocks[index];
            Block { key: block.key, name: block.name.clone(), size: block.size, page, origin }
        })
        .collect();
    let (materials, emitters) = materials::materials(world);
    let mut manifest = Manifest {
        format: FORMAT.to_owned(),
        version: VERSION,
        kind: lightkiln_proto::bake::PRT.to_owned(),
        scene: params.scene,
        settings: params.settings.clone(),
        texel_m: stage.texel_m,
        probe_spacing_m: stage.probe_spacing_m,
        bounds_m: bounds(world),
        totals: Totals::default(),
        pages: pages.sizes,
        blocks,
        materials,
        emitters,
        lights: scene.lights.clone(),
        cameras: scene.cameras.clone(),
        textures: chunk_refs(context.inputs, "texture/"),
        geometry: chunk_refs(context.inputs, "geometry/"),
        probes: chunk_refs(context.inputs, "probes/"),
        patches: chunk_refs(context.inputs, "patches/"),
        clusters: Vec::new(),
    };
    manifest.totals = totals(world, &manifest, &index);
    manifest.clusters = index.clusters;
    Ok(manifest)
}

fn bounds(world: &World) -> [[f32; 3]; 2] {
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for position in world.scene.instances.iter().flat_map(|instance| &instance.positions_m) {
        (low, high) = (low.min(*position), high.max(*position));
    }
    [low.to_array(), high.to_array()]
}

fn totals(world: &World, manifest: &Manifest, index: &CellIndex) -> Totals {
    let clusters = &index.clusters;
    let receivers: u64 = clusters.iter().map(|cluster| u64::from(cluster.receivers)).sum();
    let rank_sum: f64 =
        clusters.iter().map(|cluster| f64::from(cluster.receivers) * f64::from(cluster.rank)).sum();
    let bytes = |refs: &[ChunkRef]| refs.iter().map(|chunk| chunk.bytes).sum::<u64>();
    let bytes_light = bytes(&manifest.probes)
        + bytes(&manifest.patches)
        + clusters.iter().map(|cluster| cluster.bytes).sum::<u64>();
    Totals {
        receivers,
        probes: world.stage.probes.len() as u64,
        patches: world.stage.patches.patches.len() as u64,
        clusters: clusters.len() as u64,
        triangles: world.geometry.triangles.len() as u64,
        mean_rank: rank_sum / receivers.max(1) as f64,
        rank_max: clusters.iter().map(|cluster| cluster.rank).max().unwrap_or(0),
        uncovered_fraction: index.uncovered / index.lit.max(1.0),
        left_out_fraction: index.left_out / index.lit.max(1.0),
        receivers_without_light: index.receivers_without_light,
        bytes: bytes_light + bytes(&manifest.geometry) + bytes(&manifest.textures),
        bytes_light,
    }
}

/// What people want to know of the bake: import warnings, totals, and where it is worst.
fn report(context: &Context, manifest: &Manifest, s1_bounds: &[f32]) -> Result<Value, TaskError> {
    let import: Value = serde_json::from_slice(&context.bytes("warnings")?)
        .map_err(|error| TaskError::bad_input_from("the import's warnings cannot be read", error))?;
    let worst = |value: fn(&ClusterRef) -> f32| {
        let mut order: Vec<&ClusterRef> = manifest.clusters.iter().collect();
        order.sort_by(|a, b| value(b).total_cmp(&value(a)).then(a.digest.cmp(&b.digest)));
        let entry =
            |c: &&ClusterRef| json!({ "digest": c.digest, "bounds_m": c.bounds_m, "value": value(c) });
        order.iter().take(WORST).filter(|c| value(c) > 0.0).map(entry).collect::<Vec<_>>()
    };
    Ok(json!({
        "import": import,
        "totals": manifest.totals,
        "texel_m": manifest.texel_m,
        "probe_spacing_m": manifest.probe_spacing_m,
        "s1_criterion_at_most": {
            "mean": s1_bounds.iter().map(|bound| f64::from(*bound)).sum::<f64>() / s1_bounds.len().max(1) as f64,
            "max": s1_bounds.iter().fold(0.0_f32, |max, bound| max.max(*bound)),
        },
        "uncovered_bound_met": manifest.totals.uncovered_fraction <= f64::from(manifest.settings.uncovered_max),
        "clusters_above_rank_error": manifest
            .clusters
            .iter()
            .filter(|cluster| cluster.truncation_error > manifest.settings.rank_error)
            .count(),
        "worst_clusters": {
            "truncation_error": worst(|cluster| cluster.truncation_error),
            "quantisation_error": worst(|cluster| cluster.quantisation_error),
            "uncovered_fraction": worst(|cluster| cluster.uncovered_fraction),
        },
    }))
}
