//! The nodes of the scene that is baked, each where it stands at rest.

use std::ops::Range;

use glam::{DAffine3, DMat3, DMat4, DQuat};
use gltf::json::{Index, Node, Root};

use super::super::context::Context;
use super::super::document::{self, node_place};
use super::super::error::{ImportError, Result};
use super::super::limits::{self, within};
use super::super::nodes::{local_transform, scene_roots};

/// A node of the scene.
pub(super) struct Placed {
    /// Its number in the file.
    pub(super) node: usize,
    /// Its parent in the list.
    pub(super) parent: Option<usize>,
    /// Its place at rest.
    pub(super) world_from_node: DAffine3,
    /// The turns from its root down to it, without scales.
    pub(super) turn: DQuat,
}

/// All nodes of the scene, parents before their children, in the order of the file.
///
/// Errors on nodes that do not form trees, are too deep or too many, and on transforms that are not finite.
pub(super) fn placed(context: &mut Context<'_>) -> Result<Vec<Placed>> {
    let root = context.root;
    within(limits::NODES, root.nodes.len() as u64, context.limits.nodes)?;
    let mut is_reached = vec![false; root.nodes.len()];
    let mut list: Vec<Placed> = Vec::new();
    let tops = scene_roots(context)?;
    let mut pending: Vec<(Index<Node>, Option<usize>, u64)> =
        tops.iter().rev().map(|top| (*top, None, 1)).collect();
    while let Some((index, parent, depth)) = pending.pop() {
        let node = document::get(root, index, "node", || "the scene".to_owned())?;
        let index = index.value();
        within(limits::NODE_LEVELS, depth, context.limits.node_depth)?;
        if std::mem::replace(&mut is_reached[index], true) {
            return Err(ImportError::NodeReachedTwice { place: node_place(root, index) });
        }
        let above = parent.map(|parent| &list[parent]);
        let (world, turn) = above.map_or_else(Default::default, |above| (above.world_from_node, above.turn));
        let world_from_node = world * local_transform(node);
        if !DMat4::from(world_from_node).as_mat4().is_finite() {
            return Err(ImportError::NonFiniteTransform { place: node_place(root, index) });
        }
        let turn = (turn * local_turn(node)).normalize();
        let here = list.len();
        list.push(Placed { node: index, parent, world_from_node, turn });
        pending.extend(node.children.iter().flatten().rev().map(|child| (*child, Some(here), depth + 1)));
    }
    Ok(list)
}

/// A node and all below it: the list has them in a row.
pub(super) fn subtree(nodes: &[Placed], top: usize) -> Range<usize> {
    let is_beside = |at: &usize| nodes[*at].parent.is_none_or(|parent| parent < top);
    top..(top + 1..nodes.len()).find(is_beside).unwrap_or(nodes.len())
}

/// Place in the list of each node of the file; none of those that the scene does not name.
pub(super) fn places_of(root: &Root, nodes: &[Placed]) -> Vec<Option<usize>> {
    let mut places = vec![None; root.nodes.len()];
    nodes.iter().enumerate().for_each(|(at, placed)| places[placed.node] = Some(at));
    places
}

/// Whether a light is at a node.
pub(super) fn has_light(root: &Root, node: usize) -> bool {
    let extensions = root.nodes[node].extensions.as_ref();
    extensions.is_some_and(|extensions| extensions.khr_lights_punctual.is_some())
}

/// The turn of a node's own transform.
fn local_turn(node: &Node) -> DQuat {
    if node.matrix.is_some() {
        return turn_of(local_transform(node).matrix3).unwrap_or(DQuat::IDENTITY);
    }
    let [x, y, z, w] = node.rotation.unwrap_or_default().0.map(f64::from);
    let turn = DQuat::from_xyzw(x, y, z, w);
    if turn.length_squared() > 0.0 { turn.normalize() } else { DQuat::IDENTITY }
}

/// The turn of a matrix: its first column's direction, and the second one's square to that. `None` where these are none.
fn turn_of(matrix: DMat3) -> Option<DQuat> {
    let proper = if matrix.determinant() < 0.0 { -matrix } else { matrix };
    let x = proper.x_axis.try_normalize()?;
    let y = (proper.y_axis - x * x.dot(proper.y_axis)).try_normalize()?;
    Some(DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize())
}
