//! Task `transfer.volume`: a level of an object's volume.

use std::collections::BTreeMap;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::transfer::{
    GLOWS_MAX, Lattice, PartGlow, TransferLevel, TransferPart, encode_transfer, node_codes,
};
use rayon::prelude::*;

use super::VolumeParams;
use super::nodes::{Node, Sight};
use super::parts::Parts;
use crate::emitters::emissive_triangles;
use crate::lightmap::World;
use crate::patches::PatchTree;
use crate::task::{Cancelled, Context, TaskError, TaskOutput, params};

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
    let parts = Parts::of(&world, &tree, settings.parts_of(level), (high_m - low_m).max_element());
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
        radius_m: 0.5 * (high_m - low_m).length(),
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
    found.parts = parts.parts;
    let dark = found.parts.len();
    if nodes.iter().any(|node| node.sums[dark][3] > 0.0) {
        found.parts.push(TransferPart::default());
    }
    let emitter_of: BTreeMap<u32, usize> =
        emissive.iter().zip(0..).map(|(of, at)| (of.triangle, at)).collect();
    for (number, part) in found.parts.iter_mut().enumerate() {
        let own: Vec<[f32; 4]> = nodes.iter().map(|node| node.sums[number]).collect();
        let (codes, steps) = node_codes(&own);
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
    by_emitter.into_iter().map(|(emitter, share)| PartGlow { emitter, share }).take(GLOWS_MAX).collect()
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
