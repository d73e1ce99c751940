//! Tasks `voxels.region` and `voxels.top`: the chunk of a cube's finest levels, and that of the scene's coarser ones.

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::manifest::ChunkRef;
use lightkiln_proto::voxels::{VoxelPart, VoxelTotals, encode_voxels};
use rayon::prelude::*;

use super::elements::Elements;
use super::plan::VoxelParams;
use super::sides::{SurfaceTables, Surfaces};
use super::touches::{Place, Scope, Touch, Triangle};
use crate::emitters::emissive_triangles;
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::reads::{Before, Name, RECORD_ARTEFACT, Record, Stage, before, branches};
use crate::task::{Cancelled, Context, Progress, TaskError, TaskOutput, params};

/// Name of the chunk among a task's outputs.
const CHUNK: &str = "elements";
/// Name of its counts.
const TOTALS: &str = "totals";
/// Triangles whose touches are held at a time. More → more threads are kept busy, more memory.
const TRIANGLES_AT_ONCE: usize = 1 << 12;
/// Voxels that their bounds span at most, but for one triangle: large ones are held by fewer.
const SPANNED_AT_ONCE: f64 = 5e5;

/// Runs `voxels.region` or `voxels.top`, by its parameters: inputs are those of `prt.transport` without cells; outputs `elements`, `totals`,
/// `record`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let params: VoxelParams = params(task)?;
    let stage = Stage::of(context)?;
    let why = match before(context, &stage, "as before: no surface in it has changed")? {
        Before::Kept(kept) => return Ok(kept),
        Before::Changed(why) => why,
    };
    let (world, tree) = (World::of(context)?, PatchTree::of(context)?);
    let tables = tables(context, &world, &tree)?;
    let surfaces = Surfaces { world: &world, tree: &tree, tables: &tables };
    let found = Voxelised::of(&surfaces, (&world, &tree, &stage), &params, context.progress)?;
    let chunk = encode_voxels(&found.part)
        .map_err(|error| TaskError::bad_input_from("the voxels cannot be stored", error))?;
    let mut totals = VoxelTotals { regions: u64::from(params.region.is_some()), ..VoxelTotals::default() };
    totals.add(&found.part);
    let mut output = TaskOutput { note: why, ..TaskOutput::default() };
    output.artefacts.push((CHUNK.to_owned(), chunk));
    output.artefacts.push((TOTALS.to_owned(), serde_json::json!(totals).to_string().into_bytes()));
    if let Some(record) = Record::of(&stage, &tree, &found.reads, &[], &[]) {
        output.artefacts.push((RECORD_ARTEFACT.to_owned(), record.encoded()?));
    }
    output.counters.insert("elements".into(), totals.elements.iter().sum::<u64>() as f64);
    Ok(output)
}

/// Tables of the world and the patches among a task's inputs, made once per worker.
fn tables(context: &Context, world: &World, tree: &PatchTree) -> Result<Arc<SurfaceTables>, TaskError> {
    let all: Vec<&str> = context.inputs.iter().map(|artefact| artefact.name.as_str()).collect();
    context.memory.get_or_insert(context.digest_of_all(&all)?, || {
        let tables = SurfaceTables::new(world, tree, &emissive_triangles(&world.geometry));
        let bytes = tables.bytes();
        Ok((tables, bytes))
    })
}

/// Elements, and what was read for them.
pub struct Voxelised {
    pub part: VoxelPart,
    /// Ascending.
    pub reads: Vec<Name>,
}

impl Voxelised {
    /// Of a task over a world.
    pub fn of(
        surfaces: &Surfaces,
        (world, tree, stage): (&World, &PatchTree, &Stage),
        params: &VoxelParams,
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let voxel_m = params.voxel_m(world);
        let scopes = params.scopes(voxel_m, world.geometry.bounds_m());
        let (low_m, high_m) = bounds_m(&scopes);
        let is_near = |[low, high]: [Vec3; 2]| low.cmple(high_m).all() && high.cmpge(low_m).all();
        let triangles = surfaces.triangles(is_near);
        let (mut elements, mut leaves) = (Elements::new(voxel_m), Vec::new());
        let mut reads: Vec<Name> = Vec::new();
        progress.begin(0.0, 0.95, triangles.len() as u64);
        for some in at_once(&triangles, &scopes) {
            for (touches, of_leaves, names) in touches(surfaces, stage, &scopes, some, progress)? {
                touches.iter().for_each(|(place, touch)| elements.add(*place, touch));
                leaves.extend(of_leaves);
                reads.extend(names);
            }
            progress.advance(some.len() as u64);
            leaves.sort_unstable();
            leaves.dedup();
            reads.sort_unstable();
            reads.dedup();
        }
        // All triangles in its cubes were looked for.
        let noting = surfaces.noting(stage);
        noting.reads.trail.mark_box(low_m, high_m);
        reads.extend(noting.reads.into_names());
        reads.extend(branches(tree, &leaves));
        reads.sort_unstable();
        reads.dedup();
        let part = VoxelPart {
            voxel_m: voxel_m as f32,
            glows: surfaces.glows().to_vec(),
            bricks: elements.into_bricks(),
        };
        Ok(Self { part: without_idle_glows(part), reads })
    }
}

/// Runs of triangles whose touches fit into memory together, however large they are.
fn at_once<'a>(triangles: &'a [Triangle], scopes: &[Scope]) -> Vec<&'a [Triangle]> {
    let spanned = |triangle: &Triangle| scopes.iter().map(|scope| scope.spanned(triangle)).sum::<f64>();
    let (mut runs, mut first, mut sum) = (Vec::new(), 0, 0.0);
    for (index, triangle) in triangles.iter().enumerate() {
        let more = spanned(triangle);
        if index > first && (index - first == TRIANGLES_AT_ONCE || sum + more > SPANNED_AT_ONCE) {
            runs.push(&triangles[first..index]);
            (first, sum) = (index, 0.0);
        }
        sum += more;
    }
    if first < triangles.len() {
        runs.push(&triangles[first..]);
    }
    runs
}

/// Touches of some triangles, leaves of the patches that they name, and names of what was read.
type Found = (Vec<(Place, Touch)>, Vec<u32>, Vec<Name>);

/// Triangles that note what they read together: noting it for each by itself costs more than all else.
const TRIANGLES_NOTED: usize = 64;

fn touches(
    surfaces: &Surfaces,
    stage: &Stage,
    scopes: &[Scope],
    triangles: &[Triangle],
    progress: &Progress,
) -> Result<Vec<Found>, Cancelled> {
    let of_some = |some: &[Triangle]| {
        progress.check()?;
        let noting = surfaces.noting(stage);
        let mut found = Vec::new();
        progress.casting(|| {
            for triangle in some {
                scopes.iter().for_each(|scope| found.extend(scope.touches(triangle, &noting)));
            }
        });
        Ok((found, noting.leaves.into_inner(), noting.reads.into_names()))
    };
    triangles.par_chunks(TRIANGLES_NOTED).map(of_some).collect()
}

/// Bounds of some cubes in metres.
fn bounds_m(scopes: &[Scope]) -> (Vec3, Vec3) {
    scopes.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), scope| {
        let [from, to] = scope.bounds_m();
        (low.min(from), high.max(to))
    })
}

/// The part with those glows alone that its elements name.
fn without_idle_glows(mut part: VoxelPart) -> VoxelPart {
    let mut used: Vec<u16> =
        part.bricks.iter().flat_map(|brick| &brick.elements).map(|element| element.glow).collect();
    used.sort_unstable();
    used.dedup();
    used.retain(|glow| *glow > 0);
    for element in part.bricks.iter_mut().flat_map(|brick| &mut brick.elements) {
        if let Ok(place) = used.binary_search(&element.glow) {
            element.glow = place as u16 + 1;
        }
    }
    part.glows = used.iter().map(|glow| part.glows[usize::from(*glow) - 1]).collect();
    part
}

/// Sums over the voxels of a bake whose tasks are among a task's inputs; `None` without any.
pub fn totals(context: &Context) -> Result<Option<VoxelTotals>, TaskError> {
    let mut all: Option<VoxelTotals> = None;
    for artefact in context.inputs.iter().filter(|artefact| is_of_voxels(&artefact.name, TOTALS)) {
        let bytes = context.source.get(artefact.digest)?;
        let part: VoxelTotals = serde_json::from_slice(&bytes)
            .map_err(|error| TaskError::bad_input_from("the counts of voxels cannot be read", error))?;
        all.get_or_insert_default().join(&part);
    }
    Ok(all)
}

/// Chunks of voxels among a task's inputs, that of the coarser levels first.
pub fn chunks(context: &Context) -> Vec<ChunkRef> {
    let named = context.inputs.iter().filter(|artefact| is_of_voxels(&artefact.name, CHUNK));
    named.map(|artefact| ChunkRef { digest: artefact.digest, bytes: artefact.bytes }).collect()
}

fn is_of_voxels(name: &str, output: &str) -> bool {
    name.strip_prefix("voxels/")
        .and_then(|rest| rest.strip_suffix(output))
        .is_some_and(|rest| rest.ends_with('/'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::IVec3;

    #[test]
    fn few_large_triangles_are_held_at_a_time_and_none_is_left_out() {
        let scope = Scope { voxel_m: 0.01, first: 2, last: 10, root_doublings: 14, root: IVec3::ZERO };
        let triangle = |index: u32, size_m: f32| Triangle {
            index,
            corners: [Vec3::ZERO, size_m * Vec3::X, size_m * Vec3::new(0.0, 1.0, 0.2)].map(|at| at + 1.0),
            is_double_sided: false,
            glow: 0,
            lowest_level: 0,
        };
        for (size_m, most) in [(0.02, TRIANGLES_AT_ONCE), (35.0, 10)] {
            let triangles: Vec<Triangle> = (0..10_000).map(|index| triangle(index, size_m)).collect();
            let runs = at_once(&triangles, &[scope]);
            assert!(runs.iter().all(|run| (1..=most).contains(&run.len())), "{size_m} m: {}", runs[0].len());
            let order: Vec<u32> = runs.iter().flat_map(|run| run.iter()).map(|t| t.index).collect();
            assert_eq!(order, (0..10_000).collect::<Vec<_>>());
        }
        assert!(at_once(&[], &[scope]).is_empty());
    }
}
