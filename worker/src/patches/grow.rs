//! The tree of surface patches: receivers that lie near each other, face the same way and see each other.
//!
//! A patch is a set of receivers of one cell of a world-aligned lattice and one of six directions. Cells double from
//! level to level, and a patch's parent holds the patches of its cell of the next level that are one surface: linked by
//! neighbouring texels, or in sight of each other. So no patch has two sides of a wall.
//!
//! We differ from \[Sedlacek2019\] (METHOD.md §2.3): coefficients belong to surfaces, not to probes. A hit then always has a
//! patch, whoever else sees it, near patches are small, far ones large, and each texel's light is summed once for all.

use std::collections::BTreeMap;

use glam::Vec3;
use lightkiln_proto::content::{AreaCode, LINKS, PatchKey, Texel};
use rayon::prelude::*;

use super::seen::seen_areas;
use super::{Patch, PatchTree};
use crate::geometry::lattice::cell_of;
use crate::lightmap::{World, link_height_m};
use crate::task::{Cancelled, Progress, TaskError};

/// Side of the finest cells in texels: a texel's neighbour may lie under a thing that stands on it, and be dark.
const LEAF_TEXELS: f32 = 1.0;
/// Levels at most; 4 bits of a key, the last value being the sky's.
const LEVELS_MAX: u32 = 14;
/// Cells along an axis: 15 bits of a key.
const CELLS_MAX: i32 = 1 << 15;
/// Patches of one cell and direction: 10 bits of a key. Surfaces beyond stay apart, as the patches of the level below that
/// they are; receivers beyond join the last.
const ORDINALS_MAX: usize = 1 << 10;
/// Surfaces of a cell that another one is tried to join.
const TRIED_MAX: usize = 8;

/// Node of an item that is a receiver.
const NO_NODE: u32 = u32::MAX;

/// Cell, level and direction that a patch lies in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    cell: [i32; 3],
    direction: u8,
}

/// A receiver, or a patch of the level below.
struct Item {
    place: Place,
    /// Block key and texel of the first receiver: the order of items.
    identity: (u64, Texel),
    /// Where the item is looked at from.
    point_m: Vec3,
    normal: Vec3,
    /// Doublings of the core's texels that its own are as long as: no patch has texels of different sizes, as areas are
    /// counted in them.
    coarseness: u32,
    /// Node, or [`NO_NODE`] for a receiver.
    node: u32,
    receiver: u32,
}

/// A patch while the tree grows.
struct Node {
    key: PatchKey,
    children: Vec<u32>,
    /// Of leaves.
    receivers: Vec<u32>,
}

/// The tree over all receivers, of a scene or of a thing that is looked at `from_around`. Errors soon after `progress` is cancelled.
pub fn tree(world: &World, from_around: bool, progress: &Progress) -> Result<PatchTree, TaskError> {
    let size_m = world.lightmap.texel_m * LEAF_TEXELS;
    let mut waiting = receiver_items(world, size_m, progress)?;
    let (mut items, mut edges): (Vec<Item>, Vec<[u32; 2]>) = Default::default();
    let mut nodes: Vec<Node> = Vec::new();
    for level in 0..LEVELS_MAX {
        // Receivers of coarse texels are leaves of the level whose cells are as wide.
        let (entering, later) = waiting.into_iter().partition(|item: &Item| item.coarseness == level);
        waiting = later;
        edges.extend(receiver_edges(world, &entering, items.len() as u32));
        items.extend(entering);
        let (parents, parent_of) = level_above(world, level, size_m, &items, &edges, &mut nodes, progress)?;
        let merged = parents.len() < items.len();
        let cells = parents.iter().map(|item| item.place.cell);
        let one_cell = cells.clone().min() == cells.clone().max();
        items = parents;
        if one_cell && level > 0 && !merged && waiting.is_empty() {
            break;
        }
        edges = lifted(&edges, &parent_of);
        for item in &mut items {
            item.place.cell = item.place.cell.map(|c| c.div_euclid(2));
        }
    }
    Ok(flattened(world, &nodes, &items, seen_areas(world, from_around, progress)?))
}

/// Which of ±x, ±y, ±z a normal is nearest to.
fn direction_of(normal: Vec3) -> u8 {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + u8::from(size.z > size.y) };
    axis * 2 + u8::from(normal[usize::from(axis)] < 0.0)
}

fn receiver_items(world: &World, size_m: f32, progress: &Progress) -> Result<Vec<Item>, TaskError> {
    let lightmap = &world.lightmap;
    let coarseness = |texel_m: f32| {
        (0..LEVELS_MAX - 1).find(|&n| size_m * 2.0_f32.powi(n as i32) >= texel_m * LEAF_TEXELS)
    };
    let coarseness: Vec<u32> =
        lightmap.blocks.iter().map(|block| coarseness(block.texel_m).unwrap_or(LEVELS_MAX - 1)).collect();
    let mut items = Vec::with_capacity(lightmap.receivers.len());
    for (index, receiver) in (0..).zip(&lightmap.receivers) {
        progress.check()?;
        // Guests have no surface.
        if lightmap.is_guest(index) {
            continue;
        }
        let coarseness = coarseness[receiver.block as usize];
        let cell = cell_of(receiver.position_m, size_m * 2.0_f32.powi(coarseness as i32));
        if cell.abs().max_element() >= CELLS_MAX / 2 {
            return Err(TaskError::bad_input(format!(
                "'{}' reaches {} m from the world origin, too far for texels of {} m; move the scene to the origin, \
                 leave the object out or raise texel_m",
                world.geometry.scene.instances[lightmap.blocks[receiver.block as usize].instance as usize]
                    .path,
                receiver.position_m.abs().max_element(),
                lightmap.blocks[receiver.block as usize].texel_m
            )));
        }
        items.push(Item {
            place: Place { cell: cell.to_array(), direction: direction_of(receiver.face_normal) },
            identity: (lightmap.blocks[receiver.block as usize].key, receiver.texel),
            point_m: receiver.position_m,
            normal: receiver.face_normal,
            coarseness,
            node: NO_NODE,
            receiver: index,
        });
    }
    Ok(items)
}

/// Pairs of items whose receivers are linked, the first of them being number `first`.
fn receiver_edges(world: &World, items: &[Item], first: u32) -> Vec<[u32; 2]> {
    let mut edges = Vec::new();
    for (index, item) in (first..).zip(items) {
        let receiver = &world.lightmap.receivers[item.receiver as usize];
        let [x, y] = receiver.texel.map(i32::from);
        for (bit, [dx, dy]) in LINKS.into_iter().enumerate() {
            if receiver.links >> bit & 1 == 1
                && let Some(other) = world.receiver_on(receiver.block, x + dx, y + dy)
                && let Ok(other) = items.binary_search_by_key(&other, |item| item.receiver)
            {
                edges.push([index, first + other as u32]);
            }
        }
    }
    edges
}

/// Joins items of one place that are one surface; gives the joined ones, and the joined one of each item.
fn level_above(
    world: &World,
    level: u32,
    leaf_m: f32,
    items: &[Item],
    edges: &[[u32; 2]],
    nodes: &mut Vec<Node>,
    progress: &Progress,
) -> Result<(Vec<Item>, Vec<u32>), Cancelled> {
    let mut by_place: BTreeMap<Place, Vec<u32>> = BTreeMap::new();
    for (index, item) in items.iter().enumerate() {
        by_place.entry(item.place).or_default().push(index as u32);
    }
    let mut edges_of: Vec<Vec<u32>> = vec![Vec::new(); items.len()];
    for &[a, b] in edges {
        if a != b && items[a as usize].place == items[b as usize].place {
            edges_of[a as usize].push(b);
            edges_of[b as usize].push(a);
        }
    }
    let height_m = (leaf_m * (1_u32 << level) as f32 * 0.25).max(link_height_m(world.lightmap.texel_m));
    let places: Vec<(Place, Vec<u32>)> = by_place.into_iter().collect();
    let surfaces = |(_, members): &(Place, Vec<u32>)| {
        progress.check()?;
        Ok(progress.casting(|| surfaces(world, height_m, items, members, &edges_of)))
    };
    let surfaces: Vec<Vec<Vec<u32>>> = places.par_iter().map(surfaces).collect::<Result<_, Cancelled>>()?;
    let mut parents = Vec::new();
    let mut parent_of = vec![0; items.len()];
    for ((place, _), surfaces) in places.iter().zip(surfaces) {
        let mut named = 0;
        for members in surfaces {
            let is_leaf = items[members[0] as usize].node == NO_NODE;
            if !is_leaf && (members.len() == 1 || named == ORDINALS_MAX) {
                for member in members {
                    parent_of[member as usize] = parents.len() as u32;
                    parents.push(Item { place: *place, ..items[member as usize] });
                }
                continue;
            }
            members.iter().for_each(|&member| parent_of[member as usize] = parents.len() as u32);
            if named == ORDINALS_MAX {
                let joined = members.iter().map(|&member| items[member as usize].receiver);
                nodes.last_mut().into_iter().for_each(|node| node.receivers.extend(joined.clone()));
                members.iter().for_each(|&member| parent_of[member as usize] = parents.len() as u32 - 1);
                continue;
            }
            let key = PatchKey::of_cell(level, place.cell, place.direction, named as u32);
            named += 1;
            let (mut children, mut receivers) = (Vec::new(), Vec::new());
            if is_leaf {
                receivers = members.iter().map(|&member| items[member as usize].receiver).collect();
            } else {
                children = members.iter().map(|&member| items[member as usize].node).collect();
            }
            nodes.push(Node { key, children, receivers });
            let node = nodes.len() as u32 - 1;
            parents.push(Item { place: *place, node, ..items[members[0] as usize] });
        }
    }
    Ok((parents, parent_of))
}

/// Items of one place grouped into surfaces, each in the order of identities, and so are the surfaces.
fn surfaces(
    world: &World,
    height_m: f32,
    items: &[Item],
    members: &[u32],
    edges_of: &[Vec<u32>],
) -> Vec<Vec<u32>> {
    let mut members = members.to_vec();
    members.sort_by_key(|&member| items[member as usize].identity);
    let mut found: Vec<Vec<u32>> = Vec::new();
    let mut taken: BTreeMap<u32, bool> = members.iter().map(|&member| (member, false)).collect();
    for &start in &members {
        if taken[&start] {
            continue;
        }
        taken.insert(start, true);
        let (mut linked, mut next) = (vec![start], 0);
        while let Some(&member) = linked.get(next) {
            next += 1;
            for &other in &edges_of[member as usize] {
                if taken.insert(other, true) == Some(false) {
                    linked.push(other);
                }
            }
        }
        let joined = found.iter().enumerate().take(TRIED_MAX).position(|(_, surface)| {
            let [found, own] = [surface[0], start].map(|member| &items[member as usize]);
            found.coarseness == own.coarseness && are_in_sight(world, height_m, found, own)
        });
        match joined {
            Some(surface) => found[surface].append(&mut linked),
            None => found.push(linked),
        }
    }
    found.iter_mut().for_each(|surface| surface.sort_by_key(|&member| items[member as usize].identity));
    found
}

/// No wall stands between two items: raised above their surfaces they see each other.
fn are_in_sight(world: &World, height_m: f32, a: &Item, b: &Item) -> bool {
    let raised = |item: &Item| world.geometry.raised(item.point_m, item.normal, height_m);
    world.is_linked(raised(a), raised(b))
}

/// Edges between items as edges between their parents.
fn lifted(edges: &[[u32; 2]], parent_of: &[u32]) -> Vec<[u32; 2]> {
    let mut lifted: Vec<[u32; 2]> = edges
        .par_iter()
        .map(|&[a, b]| [parent_of[a as usize], parent_of[b as usize]])
        .filter(|[a, b]| a != b)
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    lifted.par_sort_unstable();
    lifted.dedup();
    lifted
}

/// The tree in order: a patch before its parts, its leaves one after the other.
fn flattened(world: &World, nodes: &[Node], roots: &[Item], seen_areas: Vec<AreaCode>) -> PatchTree {
    let mut tree = PatchTree {
        leaf_of_receiver: vec![0; world.lightmap.receivers.len()],
        seen_areas,
        ..PatchTree::default()
    };
    let mut roots: Vec<u32> = roots.iter().map(|item| item.node).collect();
    roots.sort_by_key(|&root| nodes[root as usize].key);
    for root in roots {
        enter(world, nodes, root, &mut tree);
    }
    tree.leaf_starts.push(tree.receivers.len() as u32);
    let key = |patch: &u32| tree.patches[*patch as usize].key;
    let mut by_key: Vec<u32> = (0..tree.patches.len() as u32).collect();
    by_key.sort_by_key(key);
    tree.by_key = by_key;
    tree
}

fn enter(world: &World, nodes: &[Node], index: u32, tree: &mut PatchTree) {
    let node = &nodes[index as usize];
    let own = tree.patches.len();
    let first_leaf = tree.leaf_starts.len() as u32;
    tree.patches.push(Patch {
        key: node.key,
        first_leaf,
        leaf_count: 0,
        end: 0,
        bounds_m: [Vec3::ZERO; 2],
        seen_texels: 0.0,
    });
    if node.children.is_empty() {
        tree.leaf_starts.push(tree.receivers.len() as u32);
        for &receiver in &node.receivers {
            tree.leaf_of_receiver[receiver as usize] = first_leaf;
            tree.receivers.push(receiver);
        }
    }
    for &child in &node.children {
        enter(world, nodes, child, tree);
    }
    let (leaves, end) = (tree.leaf_starts.len() as u32, tree.patches.len() as u32);
    let of_receivers = tree.receivers[tree.leaf_starts[first_leaf as usize] as usize..]
        .iter()
        .map(|&receiver| world.lightmap.receivers[receiver as usize].position_m);
    let bounds_m = of_receivers.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], position_m| {
        [low.min(position_m), high.max(position_m)]
    });
    let of_receivers = &tree.receivers[tree.leaf_starts[first_leaf as usize] as usize..];
    let areas = of_receivers.iter().map(|&receiver| tree.seen_areas[receiver as usize].texels());
    let seen_texels = areas.sum();
    let patch = &mut tree.patches[own];
    (patch.leaf_count, patch.end) = (leaves - first_leaf, end);
    (patch.bounds_m, patch.seen_texels) = (bounds_m, seen_texels);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn direction_is_the_nearest_axis() {
        let all = [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z];
        assert_eq!(all.map(direction_of), [0, 1, 2, 3, 4, 5]);
        assert_eq!(direction_of(Vec3::new(0.5, -0.7, 0.5)), 3);
    }
}
