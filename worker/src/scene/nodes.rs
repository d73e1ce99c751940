//! The node hierarchy: a walk in file order that gives each mesh, camera and light its place in the world.

use std::collections::BTreeMap;
use std::rc::Rc;

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use gltf::json::{Index, Node};
use serde::Deserialize;

use super::Opening;
use super::context::Context;
use super::document::{self, node_place, primitive_place};
use super::error::{ImportError, Result, shown};
use super::lights_cameras::{read_camera, read_light};
use super::limits::{self, within};
use super::materials::MaterialTable;
use super::model::{LitBy, MeshInstance, Scene};
use super::placement::place_in_world;
use super::pose;
use super::primitives::PrimitiveReader;

/// Distance of a squared quaternion length from 1 from which on it deserves a warning.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// Code of the warning that one scene of several is baked.
pub(super) const OTHER_SCENES: &str = "other-scenes-ignored";

/// Flattens the scene into instances, lights and cameras of `scene`; gives the count of degenerate triangles.
///
/// Errors on nodes that do not form trees, are too deep or too many, and on whatever their meshes hold.
pub(super) fn flatten(
    context: &mut Context<'_>,
    materials: &mut MaterialTable,
    scene: &mut Scene,
) -> Result<u64> {
    within(limits::NODES, context.root.nodes.len() as u64, context.limits.nodes)?;
    let mut walk = Walk {
        is_reached: vec![false; context.root.nodes.len()],
        primitives: PrimitiveReader::default(),
        paths: BTreeMap::new(),
        parents: None,
        degenerate_count: 0,
    };
    let mut pending = Vec::new();
    let top: Rc<str> = "".into();
    for &index in scene_roots(context)?.iter().rev() {
        pending.push(Pending {
            index,
            parent_path: top.clone(),
            world_from_parent: DAffine3::IDENTITY,
            depth: 1,
            lit_by: None,
        });
    }
    // A list of its own instead of recursion: depth then costs no stack.
    while let Some(next) = pending.pop() {
        walk.visit(context, materials, scene, next, &mut pending)?;
    }
    Ok(walk.degenerate_count)
}

/// The root nodes of the default scene, else of the first, else all nodes without a parent.
pub(super) fn scene_roots(context: &mut Context<'_>) -> Result<Vec<Index<Node>>> {
    let root = context.root;
    if root.scenes.len() > 1 {
        context.warnings.add(OTHER_SCENES, || {
            format!("the file has {} scenes, and the default one is baked", root.scenes.len())
        });
    }
    if let Some(index) = root.scene {
        return Ok(document::get(root, index, "scene", || "the file".to_owned())?.nodes.clone());
    }
    if let Some(first) = root.scenes.first() {
        return Ok(first.nodes.clone());
    }
    let mut has_parent = vec![false; root.nodes.len()];
    for child in root.nodes.iter().filter_map(|node| node.children.as_ref()).flatten() {
        if let Some(flag) = has_parent.get_mut(child.value()) {
            *flag = true;
        }
    }
    let roots: Vec<_> =
        (0..root.nodes.len()).filter(|&i| !has_parent[i]).map(|i| Index::new(i as u32)).collect();
    if roots.is_empty() && !root.nodes.is_empty() {
        return Err(ImportError::NodeReachedTwice { place: node_place(root, 0) });
    }
    Ok(roots)
}

/// A node that is still to be visited.
struct Pending {
    index: Index<Node>,
    parent_path: Rc<str>,
    world_from_parent: DAffine3,
    depth: u64,
    /// As its parent says.
    lit_by: Option<LitBy>,
}

struct Walk {
    is_reached: Vec<bool>,
    primitives: PrimitiveReader,
    /// For each instance path in use, the last number given to a repetition of it.
    paths: BTreeMap<String, u64>,
    /// Parent of each node, found for the first skin.
    parents: Option<Vec<Option<usize>>>,
    degenerate_count: u64,
}

impl Walk {
    fn visit(
        &mut self,
        context: &mut Context<'_>,
        materials: &mut MaterialTable,
        scene: &mut Scene,
        here: Pending,
        pending: &mut Vec<Pending>,
    ) -> Result<()> {
        let root = context.root;
        let node_index = here.index.value();
        let node = document::get(root, here.index, "node", || "the scene".to_owned())?;
        within(limits::NODE_LEVELS, here.depth, context.limits.node_depth)?;
        if std::mem::replace(&mut self.is_reached[node_index], true) {
            return Err(ImportError::NodeReachedTwice { place: node_place(root, node_index) });
        }
        warn_of_transform(context, node_index);
        let world_from_object = here.world_from_parent * local_transform(node);
        if !DMat4::from(world_from_object).as_mat4().is_finite() {
            return Err(ImportError::NonFiniteTransform { place: node_place(root, node_index) });
        }
        let path: Rc<str> =
            format!("{}{}/", here.parent_path, path_part(node.name.as_deref(), "node")).into();
        context.budgets.path_bytes.spend(path.len() as u64)?;
        let lit_by = lit_by(context, node_index).or(here.lit_by);
        if let Some(mesh) = node.mesh {
            document::get(root, mesh, "mesh", || node_place(root, node_index))?;
            let first = scene.instances.len();
            self.add_mesh(context, materials, scene, node_index, mesh.value(), &path, world_from_object)?;
            let own = scene.instances.iter_mut().skip(first);
            own.for_each(|instance| instance.lit_by = lit_by);
        }
        scene.cameras.extend(read_camera(context, node_index, world_from_object)?);
        scene.lights.extend(read_light(context, node_index, world_from_object)?);
        for &index in node.children.iter().flatten().rev() {
            let (parent_path, depth) = (path.clone(), here.depth + 1);
            let world_from_parent = world_from_object;
            pending.push(Pending { index, parent_path, world_from_parent, depth, lit_by });
        }
        Ok(())
    }

    #[expect(clippy::too_many_arguments, reason = "one call site; the parts belong to no common thing")]
    fn add_mesh(
        &mut self,
        context: &mut Context<'_>,
        materials: &mut MaterialTable,
        scene: &mut Scene,
        node_index: usize,
        mesh_index: usize,
        node_path: &str,
        world_from_object: DAffine3,
    ) -> Result<()> {
        let root = context.root;
        let mesh = &root.meshes[mesh_index];
        let node = &root.nodes[node_index];
        let weights = node.weights.as_deref().or(mesh.weights.as_deref()).unwrap_or_default();
        let joints = match node.skin {
            Some(skin) => {
                if context.opening == Opening::Still {
                    context.warnings.add("skin-at-rest", || {
                        let place = node_place(root, node_index);
                        format!("{place} is baked in the pose in which its joints stand")
                    });
                }
                let parents = self.parents.get_or_insert_with(|| pose::parents(root));
                Some(pose::joint_matrices(context, parents, node_index, skin)?)
            }
            None => None,
        };
        for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
            context.budgets.instances.spend(1)?;
            let read = self.primitives.read(context, mesh_index, primitive_index, weights)?;
            let Some(mut local) = read else { continue };
            let place = || {
                let primitive = primitive_place(root, mesh_index, primitive_index);
                format!("{primitive} under {}", node_place(root, node_index))
            };
            let bent = joints.as_ref().filter(|_| !local.influences.is_empty());
            let world_from_object = if let Some(matrices) = bent {
                let influences = std::mem::take(&mut local.influences);
                pose::bend(&mut local, &influences, matrices, &place)?;
                // Joints alone say where a skinned mesh is.
                DAffine3::IDENTITY
            } else {
                world_from_object
            };
            let placed =
                place_in_world(local, world_from_object, context.opening, &mut context.warnings, &place)?;
            self.degenerate_count += placed.degenerate_count;
            let mesh_part = placed.mesh;
            if mesh_part.triangles.is_empty() {
                continue;
            }
            let material_index = materials.index_of(root, primitive.material, &place)?;
            materials.warn_of_missing_uvs(context, material_index, &mesh_part, &place);
            let path = format!("{node_path}{}/{primitive_index}", path_part(mesh.name.as_deref(), "mesh"));
            context.budgets.path_bytes.spend(path.len() as u64)?;
            scene.instances.push(MeshInstance {
                path: self.unique(path),
                material_index,
                positions_m: mesh_part.positions,
                normals: mesh_part.normals.unwrap_or_default(),
                uv0: mesh_part.uv0,
                uv1: mesh_part.uv1,
                colours: mesh_part.colours,
                triangles: mesh_part.triangles,
                world_from_object: DMat4::from(world_from_object).as_mat4(),
                lit_by: None,
            });
        }
        Ok(())
    }

    /// `path`, or `path#2`, `path#3`, … for the next one with the same names.
    fn unique(&mut self, path: String) -> String {
        let Some(last) = self.paths.get(&path) else {
            self.paths.insert(path.clone(), 1);
            return path;
        };
        let mut number = last + 1;
        let mut candidate = format!("{path}#{number}");
        while self.paths.contains_key(&candidate) {
            number += 1;
            candidate = format!("{path}#{number}");
        }
        self.paths.insert(path, number);
        self.paths.insert(candidate.clone(), 1);
        candidate
    }
}

/// One part of an instance path; long names are cut so that deep trees stay small.
fn path_part(name: Option<&str>, unnamed: &str) -> String {
    shown(name.filter(|name| !name.is_empty()).unwrap_or(unnamed))
}

/// Where a node's extras say that the indirect light of its meshes, and of those of nodes below it, comes from. Warns of other words.
fn lit_by(context: &mut Context<'_>, node_index: usize) -> Option<LitBy> {
    #[derive(Deserialize)]
    struct Wanted {
        kiln_lit: Option<serde_json::Value>,
    }
    let root = context.root;
    let extras = root.nodes[node_index].extras.as_ref()?;
    // Extras are anything that people put there.
    let wanted = serde_json::from_str::<Wanted>(extras.get()).ok()?.kiln_lit?;
    match wanted.as_str() {
        Some("probes") => Some(LitBy::Probes),
        Some("texels") => Some(LitBy::Texels),
        Some("walks") => Some(LitBy::Walks),
        _ => {
            context.warnings.add("lit-by-something-else", || {
                let place = node_place(root, node_index);
                format!(
                    "{place} has \"kiln_lit\": {}; \"probes\", \"texels\" and \"walks\" are known",
                    shown(&wanted.to_string())
                )
            });
            None
        }
    }
}

/// Warns of a node whose transform is not quite as glTF has them.
fn warn_of_transform(context: &mut Context<'_>, node_index: usize) {
    let root = context.root;
    let node = &root.nodes[node_index];
    if let Some(m) = node.matrix {
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            context.warnings.add("matrix-not-affine", || {
                format!("{} has a projective matrix; its last row is ignored", node_place(root, node_index))
            });
        }
        return;
    }
    let rotation = DQuat::from_array(node.rotation.unwrap_or_default().0.map(f64::from));
    if (rotation.length_squared() - 1.0).abs() > ROTATION_TOLERANCE {
        context.warnings.add("rotation-not-unit", || {
            format!("{} has a quaternion of other length than 1", node_place(root, node_index))
        });
    }
}

/// The node's own transform: its matrix, or translation × rotation × scale.
pub(super) fn local_transform(node: &Node) -> DAffine3 {
    if let Some(columns) = node.matrix {
        let m = columns.map(f64::from);
        let column = |i: usize| DVec3::new(m[i], m[i + 1], m[i + 2]);
        return DAffine3 {
            matrix3: DMat3::from_cols(column(0), column(4), column(8)),
            translation: column(12),
        };
    }
    let rotation = node.rotation.unwrap_or_default().0.map(f64::from);
    let rotation = DQuat::from_array(rotation);
    let unit = if rotation.length_squared() > 0.0 { rotation / rotation.length() } else { DQuat::IDENTITY };
    let scale = DVec3::from(node.scale.unwrap_or([1.0; 3]).map(f64::from));
    let translation = DVec3::from(node.translation.unwrap_or([0.0; 3]).map(f64::from));
    let rotated = DMat3::from_quat(unit);
    DAffine3 { matrix3: rotated * DMat3::from_diagonal(scale), translation }
}
