//! The part of manifests and reports that every kind of bake has: materials, draws, framing, and a lightmap's pages.
//!
//! It reads the scene, and its charts where there are some; no ray is cast.

pub mod materials;
mod pages;

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{MANIFEST_OUTPUT, REPORT_OUTPUT};
use lightkiln_proto::manifest::{
    Block, ChunkRef, ClusterRow, DIRECTORY, FORMAT, Framing, GEOMETRY, Lightmap, Manifest, Stored, TEXTURES,
    VERSION,
};
use serde::Serialize;
use serde_json::{Value, json};

use crate::lightmap::Charts;
use crate::lightmap::place::blocks;
use crate::scene::model::Scene;
use crate::task::{Context, TaskError, TaskOutput};

/// The part of a manifest that only its kind knows.
pub struct KindPart<'a, S, B> {
    /// Name of the kind.
    pub kind: &'static str,
    /// Scene bundle.
    pub scene: Digest,
    /// All settings.
    pub settings: &'a S,
    /// Body.
    pub body: &'a B,
    /// Clusters, where it has some; their chunks are of role [`CLUSTERS`](lightkiln_proto::manifest::CLUSTERS).
    pub clusters: Vec<ClusterRow>,
    /// The kind's own chunks by role.
    pub chunks: Vec<(&'static str, Vec<ChunkRef>)>,
}

/// Outputs of an assemble task, whose inputs are the outputs of `scene.import`, `.draw` and `.frame`, of `.unwrap` for a lightmap,
/// and the kind's own: the manifest, the pages of its directory, and the report, to whose `report` of the kind, an object, the shared
/// part is added.
pub fn assembled<S: Serialize, B: Serialize>(
    context: &Context,
    part: KindPart<'_, S, B>,
    mut report: Value,
) -> Result<TaskOutput, TaskError> {
    let (scene, _): (Scene, _) = context.decoded(crate::scene::ARTEFACT_MAGIC, crate::scene::ARTEFACT)?;
    let stored = stored(context, &scene, part)?;
    report["import"] = json_of(context, crate::scene::WARNINGS)?;
    if let Some(charts) = Charts::if_any(context)? {
        report["texel_m"] = json!(charts.texel_m);
    }
    let mut artefacts = vec![
        (MANIFEST_OUTPUT.to_owned(), stored.json),
        (REPORT_OUTPUT.to_owned(), report.to_string().into_bytes()),
    ];
    let page = |(number, page): (usize, Vec<u8>)| (format!("{DIRECTORY}/{number}"), page);
    artefacts.extend(stored.pages.into_iter().enumerate().map(page));
    Ok(TaskOutput { artefacts, ..TaskOutput::default() })
}

/// The manifest and the pages of its directory, of the scene among the inputs; the others are those of [`assembled`].
pub fn stored<S: Serialize, B: Serialize>(
    context: &Context,
    scene: &Scene,
    part: KindPart<'_, S, B>,
) -> Result<Stored, TaskError> {
    let charts = Charts::if_any(context)?;
    let mut chunks: BTreeMap<String, Vec<ChunkRef>> =
        part.chunks.into_iter().map(|(role, refs)| (role.to_owned(), refs)).collect();
    chunks.insert(TEXTURES.to_owned(), chunk_refs(context, "draw/texture/"));
    chunks.insert(GEOMETRY.to_owned(), chunk_refs(context, "draw/geometry/"));
    require_stored(context, &chunks)?;
    let (materials, emitters) = materials::materials(scene);
    let manifest = Manifest {
        format: FORMAT.to_owned(),
        version: VERSION,
        kind: part.kind.to_owned(),
        scene: part.scene,
        settings: as_json(part.settings)?,
        bounds_m: scene.near_bounds_m().map(|corner| corner.to_array()),
        triangles: scene.instances.iter().map(|instance| instance.triangles.len() as u64).sum(),
        lightmap: charts.as_ref().map(|charts| layout(scene, charts)).transpose()?,
        materials,
        emitters,
        lights: scene.lights.clone(),
        cameras: scene.cameras.clone(),
        framing: framing(context)?,
        chunks,
        directory: Vec::new(),
        clusters: part.clusters,
        body: as_json(part.body)?,
    };
    manifest.stored().map_err(|error| TaskError::bad_input_from("the manifest cannot be written", error))
}

/// Errs unless every chunk among the task's inputs is stored: no task reads them, so that bytes which were lost meanwhile
/// would be missed by whoever fetches the bundle. An input that is not there is made again.
fn require_stored(context: &Context, chunks: &BTreeMap<String, Vec<ChunkRef>>) -> Result<(), TaskError> {
    let named: BTreeSet<Digest> = chunks.values().flatten().map(|chunk| chunk.digest).collect();
    let required = context.inputs.iter().filter(|artefact| named.contains(&artefact.digest));
    Ok(context.source.require_all(&required.collect::<Vec<_>>())?)
}

/// The task's inputs whose names begin with `prefix`, as chunks in their order.
pub fn chunk_refs(context: &Context, prefix: &str) -> Vec<ChunkRef> {
    let named = context.inputs.iter().filter(|artefact| artefact.name.starts_with(prefix));
    named.map(|artefact| ChunkRef { digest: artefact.digest, bytes: artefact.bytes }).collect()
}

/// Blocks in the order of their keys, placed in pages.
fn layout(scene: &Scene, charts: &Charts) -> Result<Lightmap, TaskError> {
    let mut blocks = blocks(scene, charts)?;
    blocks.sort_by_key(|block| block.key);
    let sizes: Vec<[u32; 2]> = blocks.iter().map(|block| block.size).collect();
    let pages = pages::pack(&sizes);
    let placed = blocks.into_iter().zip(&pages.places).map(|(block, &(page, origin))| Block {
        key: block.key,
        name: block.name,
        size: block.size,
        page,
        origin,
    });
    Ok(Lightmap { texel_m: charts.texel_m, blocks: placed.collect(), pages: pages.sizes })
}

fn framing(context: &Context) -> Result<Framing, TaskError> {
    serde_json::from_slice(&context.bytes(crate::vantage::FRAMING)?)
        .map_err(|error| TaskError::bad_input_from("the scene's framing cannot be read", error))
}

fn json_of(context: &Context, name: &str) -> Result<Value, TaskError> {
    serde_json::from_slice(&context.bytes(name)?)
        .map_err(|error| TaskError::bad_input_from(format!("'{name}' cannot be read"), error))
}

fn as_json(value: &impl Serialize) -> Result<Value, TaskError> {
    serde_json::to_value(value)
        .map_err(|error| TaskError::bad_input_from("the manifest cannot be written", error))
}
