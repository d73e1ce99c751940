//! Meshes that move, at rest: skins under their joints' nodes as the file has them.

use glam::{DAffine3, DMat3, DMat4, DVec3};
use gltf::json::accessor::Type;
use gltf::json::mesh::Semantic;
use gltf::json::{Index, Node, Root};

use super::accessor::{Reader, Wanted};
use super::context::Context;
use super::document::{self, node_place};
use super::error::{ImportError, Result, place_of};
use super::nodes::local_transform;
use super::placement::normal_matrix;
use super::primitives::LocalMesh;

/// Joints that pull at a vertex, four in each set.
#[derive(Debug)]
pub(super) struct Influences {
    pub(super) joints: Vec<[u32; 4]>,
    pub(super) weights: Vec<[f32; 4]>,
}

/// Sets of joints that are read of a primitive.
pub(super) const SETS: [(Semantic, Semantic); 2] =
    [(Semantic::Joints(0), Semantic::Weights(0)), (Semantic::Joints(1), Semantic::Weights(1))];

/// Parent of each node; the first one where a file names several.
pub(super) fn parents(root: &Root) -> Vec<Option<usize>> {
    let mut parents = vec![None; root.nodes.len()];
    for (parent, node) in root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            if let Some(slot) = parents.get_mut(child.value()) {
                slot.get_or_insert(parent);
            }
        }
    }
    parents
}

/// Of each joint of a node's skin the world transform of what is bound to it: `W_j · B_j` with the joint's node W and
/// its inverse bind matrix B (glTF 2.0 §3.7.3.3).
///
/// Errors on joints, nodes and matrices that are not there.
pub(super) fn joint_matrices(
    context: &mut Context<'_>,
    parents: &[Option<usize>],
    node_index: usize,
    skin: Index<gltf::json::Skin>,
) -> Result<Vec<DAffine3>> {
    let root = context.root;
    let stated = document::get(root, skin, "skin", || node_place(root, node_index))?;
    let place = || place_of("skin", skin.value(), stated.name.as_deref());
    let bound = match stated.inverse_bind_matrices {
        Some(index) => {
            let in_matrices = || format!("inverse bind matrices of {}", place());
            let count = stated.joints.len();
            let wanted = Wanted {
                place: &in_matrices,
                types: &[Type::Mat4],
                min_count: count,
                is_always_normalized: false,
            };
            let budget = &mut context.budgets.sparse_elements;
            Some(Reader::open(root, context.buffers, budget, index, &wanted)?)
        }
        None => None,
    };
    let mut matrices = Vec::with_capacity(stated.joints.len());
    for (slot, &joint) in stated.joints.iter().enumerate() {
        document::get(root, joint, "node", place)?;
        let bind = bound.as_ref().map_or(DAffine3::IDENTITY, |bound| {
            let columns: [f32; 16] = bound.floats(slot, 0.0);
            DAffine3::from_mat4(DMat4::from_cols_array(&columns.map(f64::from)))
        });
        let matrix = world_from_node(context, parents, joint)? * bind;
        if !DMat4::from(matrix).as_mat4().is_finite() {
            return Err(ImportError::NonFiniteTransform { place: format!("joint {slot} of {}", place()) });
        }
        matrices.push(matrix);
    }
    Ok(matrices)
}

/// A node's place in the world, by its parents.
fn world_from_node(context: &Context<'_>, parents: &[Option<usize>], node: Index<Node>) -> Result<DAffine3> {
    let root = context.root;
    let mut world = local_transform(&root.nodes[node.value()]);
    let mut here = node.value();
    for _ in 0..context.limits.node_depth {
        let Some(parent) = parents[here] else { return Ok(world) };
        world = local_transform(&root.nodes[parent]) * world;
        here = parent;
    }
    Err(ImportError::NodeReachedTwice { place: node_place(root, node.value()) })
}

/// Puts a skinned mesh into the world: each vertex by the weighted mean of its joints' matrices.
///
/// Errors on vertices that name joints which the skin does not have.
pub(super) fn bend(
    mesh: &mut LocalMesh,
    sets: &[Influences],
    matrices: &[DAffine3],
    place: &dyn Fn() -> String,
) -> Result<()> {
    let mut is_mirrored = false;
    for vertex in 0..mesh.positions.len() {
        let world = vertex_matrix(sets, matrices, vertex).map_err(|joint| {
            let problem = format!("vertex {vertex} names joint {joint}, but the skin has {}", matrices.len());
            ImportError::Accessor { place: place(), problem }
        })?;
        let position = &mut mesh.positions[vertex];
        *position = world.transform_point3(position.as_dvec3()).as_vec3();
        is_mirrored |= world.matrix3.determinant() < 0.0;
        if let Some(normals) = &mut mesh.normals {
            let normal = &mut normals[vertex];
            let bent = normal_matrix(world.matrix3) * normal.as_dvec3();
            *normal = bent.try_normalize().map_or(*normal, |unit| unit.as_vec3());
        }
    }
    if is_mirrored {
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }
    Ok(())
}

/// `Σ w_j M_j / Σ w_j`, or which joint is not there; the first joint's matrix where no weight is above 0.
fn vertex_matrix(sets: &[Influences], matrices: &[DAffine3], vertex: usize) -> Result<DAffine3, u32> {
    let mut sum = DMat3::ZERO;
    let mut offset = DVec3::ZERO;
    let mut total = 0.0;
    for set in sets {
        for (joint, weight) in set.joints[vertex].into_iter().zip(set.weights[vertex]) {
            let weight = f64::from(weight);
            if weight > 0.0 {
                let matrix = matrices.get(joint as usize).ok_or(joint)?;
                sum += matrix.matrix3 * weight;
                offset += matrix.translation * weight;
                total += weight;
            }
        }
    }
    if total > 0.0 {
        return Ok(DAffine3 { matrix3: sum * (1.0 / total), translation: offset / total });
    }
    matrices.first().copied().ok_or(0)
}
