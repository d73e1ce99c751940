//! Task `transfer.volume`: a level of an object's volume.

use std::collections::BTreeMap;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::transfer::{
    GLOWS_MAX, Lattice, PARTS_MAX, PATCHES_MAX, PartGlow, TransferLevel, TransferPart, encode_transfer,
    node_codes,
};
use rayon::prelude::*;

use super::VolumeParams;
use super::nodes::{Node, Sight, seen_leaves};
use super::parts::Parts;
use crate::emitters::emissive_triangles;
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::task::{Cancelled, Context, TaskError, TaskOutput, params};

/// Share of all that is seen of the object from which on what is dark counts.
const DARK_SHARE: f64 = 0.01;
/// Emitters of a part at most.
const GLOWS_OF_PART: usize = GLOWS_MAX / PARTS_MAX;

/// Name of the chunk among the outputs.
pub const CHUNK: &str = "volume";

/// Runs the task: inputs of [`World::of`] and [`PatchTree::of`]; output `volume`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let VolumeParams { level, settings } = params(task)?;
    let (world, tree) = (World::of(context)?, PatchTree::of(context)?);
    let geometry = &world.geometry;
    let [low_m, high_m] = geometry.bounds_m();
    let box_m = [low_m.to_array(), high_m.to_array()];
    let lattice = Lattice::new(box_m, level, settings.transfer_nodes);
    let (middle_m, radius_m) = (0.5 * (low_m + high_m), 0.5 * (high_m - low_m).length());
    let is_seen = context.progress.casting(|| seen_leaves(&world, &tree, middle_m, radius_m));
    let side_m = (high_m - low_m).max_element();
    let parts = Parts::of((&world, &tree), &is_seen, settings.parts_of(level), side_m);
    let emissive = emissive_triangles(geometry);
    let mut is_emissive = vec![false; geometry.triangles.len()];
    emissive.iter().for_each(|of| is_emissive[of.triangle as usize] = true);
    let sight = Sight {
        world: &world,
        tree: &tree,
        parts: &parts,
        lattice: &lattice,
        level,
        rays: settings.transfer_rays,
        radius_m,
        is_emissive: &is_emissive,
    };
    let mut found =
        TransferLevel { level, box_m, nodes: settings.transfer_nodes, ..TransferLevel::default() };
    context.progress.begin(0.0, 0.95, found.node_count() as u64);
    let node = |index: usize| {
        context.progress.check()?;
        let node = context.progress.casting(|| sight.of(index));
        context.progress.advance(1);
        Ok(node)
    };
    let mut nodes: Vec<Node> =
        (0..found.node_count()).into_par_iter().map(node).collect::<Result<_, Cancelled>>()?;
    let inside = filled(&mut nodes, settings.transfer_nodes as usize);
    let patches: usize = parts.parts.iter().map(|part| part.patches.len()).sum();
    if patches > PATCHES_MAX {
        let problem = format!(
            "the object has {patches} pieces of surface, of {PATCHES_MAX} at most: give it larger texels, --set texel_m=…"
        );
        return Err(TaskError::bad_input(problem));
    }
    found.parts = parts.parts;
    let dark = found.parts.len();
    let filled = |parts: std::ops::Range<usize>| -> f64 {
        let of_node = |node: &Node| node.sums[parts.clone()].iter().map(|sum| f64::from(sum[3])).sum::<f64>();
        nodes.iter().map(of_node).sum()
    };
    // Slivers that no texel stands for hide next to nothing.
    if filled(dark..dark + 1) > DARK_SHARE * filled(0..dark + 1) {
        found.parts.push(TransferPart { middle_m: middle_m.to_array(), ..TransferPart::default() });
    }
    let is_read = lattice.read_nodes(level);
    let emitter_of: BTreeMap<u32, usize> =
        emissive.iter().zip(0..).map(|(of, at)| (of.triangle, at)).collect();
    for (number, part) in found.parts.iter_mut().enumerate() {
        let own: Vec<[f32; 4]> = nodes.iter().map(|node| node.sums[number]).collect();
        let (codes, steps) = node_codes(&own, |node| is_read[node]);
        part.steps = steps;
        found.codes.extend(codes);
        part.glows = glows(&nodes, number, |triangle| emitter_of.get(&triangle).map(|at| &emissive[*at]));
    }
    let chunk = encode_transfer(&found)
        .map_err(|error| TaskError::bad_input_from("the volume cannot be stored", error))?;
    let mut output = TaskOutput { artefacts: vec![(CHUNK.to_owned(), chunk)], ..TaskOutput::default() };
    output.counters.insert("parts".into(), found.parts.len() as f64);
    output.counters.insert("nodes within".into(), inside as f64);
    Ok(output)
}

/// Emission of a part: of the rays that met it, so many met each emissive triangle.
fn glows<'a>(
    nodes: &[Node],
    part: usize,
    emissive: impl Fn(u32) -> Option<&'a crate::emitters::EmissiveTriangle>,
) -> Vec<PartGlow> {
    let all: u64 = nodes.iter().map(|node| node.rays[part]).sum();
    let mut by_triangle: BTreeMap<u32, u64> = BTreeMap::new();
    for node in nodes {
        let own = node.glows.iter().filter(|((of, _), _)| usize::from(*of) == part);
        own.for_each(|((_, triangle), rays)| *by_triangle.entry(*triangle).or_default() += rays);
    }
    let mut by_emitter: BTreeMap<u16, [f32; 3]> = BTreeMap::new();
    for (triangle, rays) in by_triangle {
        let Some(of) = emissive(triangle) else { continue };
        let share = rays as f32 / all.max(1) as f32;
        let sum = by_emitter.entry(of.emitter).or_default();
        *sum = [0, 1, 2].map(|channel| sum[channel] + share * of.mean_glow[channel]);
    }
    let mut found: Vec<PartGlow> =
        by_emitter.into_iter().map(|(emitter, share)| PartGlow { emitter, share }).collect();
    // The strongest, in the emitters' order.
    found.sort_by(|a, b| {
        b.share.iter().sum::<f32>().total_cmp(&a.share.iter().sum()).then(a.emitter.cmp(&b.emitter))
    });
    found.truncate(GLOWS_OF_PART);
    found.sort_by_key(|glow| glow.emitter);
    found
}

/// Gives nodes within the object the mean of their neighbours that have numbers, from outside inwards; tells how many there are.
fn filled(nodes: &mut [Node], side: usize) -> usize {
    let mut waiting: Vec<usize> = (0..nodes.len()).filter(|&index| nodes[index].is_inside).collect();
    let inside = waiting.len();
    while !waiting.is_empty() {
        let mean = |&index: &usize| {
            let neighbours: Vec<usize> = neighbours(index, side).filter(|&at| !nodes[at].is_inside).collect();
            let share = 1.0 / neighbours.len().max(1) as f32;
            let mut sums = vec![[0.0; 4]; nodes[index].sums.len()];
            for &at in &neighbours {
                for (sum, number) in sums.iter_mut().zip(&nodes[at].sums) {
                    *sum = [0, 1, 2, 3].map(|component| sum[component] + share * number[component]);
                }
            }
            (!neighbours.is_empty()).then_some((index, sums))
        };
        let means: Vec<_> = waiting.iter().filter_map(mean).collect();
        if means.is_empty() {
            break;
        }
        for (index, sums) in means {
            nodes[index].sums = sums;
            nodes[index].is_inside = false;
        }
        waiting.retain(|&index| nodes[index].is_inside);
    }
    inside
}

/// The neighbours of a node along the axes.
fn neighbours(index: usize, side: usize) -> impl Iterator<Item = usize> {
    let strides = [1, side, side * side];
    strides.into_iter().flat_map(move |stride| {
        let place = index / stride % side;
        let before = (place > 0).then(|| index - stride);
        let behind = (place + 1 < side).then(|| index + stride);
        before.into_iter().chain(behind)
    })
}
