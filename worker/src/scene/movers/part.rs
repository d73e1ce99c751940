//! A part of a scene: which nodes it has, with which of their things, and its JSON.

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DMat4, DVec3};
use gltf::json::Root;
use serde_json::{Map, Value, json};

use super::super::context::Context;
use super::super::error::Result;
use super::super::limits::Budget;
use super::tree::{Placed, has_light, places_of, subtree};
use super::write::{LIGHTS, Writer, number, picked};

/// Transforms of a node in the file.
const TRANSFORMS: [&str; 4] = ["matrix", "translation", "rotation", "scale"];

/// A part of a scene.
pub(super) struct Part<'a> {
    nodes: &'a [Placed],
    /// Top node of an object, and its transform there; none of the rest of a scene.
    top: Option<(usize, DMat3)>,
    /// For each node whether its mesh is in it.
    has_mesh: Vec<bool>,
    /// For each node whether it is in it.
    is_needed: Vec<bool>,
}

impl<'a> Part<'a> {
    /// The meshes below a node that are the object's own, in the frame of the node.
    pub(super) fn object(
        root: &Root,
        nodes: &'a [Placed],
        top: usize,
        object_from_node: DMat3,
        is_own: impl Fn(usize) -> bool,
    ) -> Self {
        let below = subtree(nodes, top);
        let mut part = Self::of_meshes(root, nodes, |at| below.contains(&at) && is_own(at));
        part.top = Some((top, object_from_node));
        part.need_parents();
        part
    }

    /// The scene's own meshes, and all its cameras and lights.
    pub(super) fn rest(root: &Root, nodes: &'a [Placed], is_own: impl Fn(usize) -> bool) -> Self {
        let mut part = Self::of_meshes(root, nodes, is_own);
        for (placed, is_needed) in nodes.iter().zip(&mut part.is_needed) {
            *is_needed |= root.nodes[placed.node].camera.is_some() || has_light(root, placed.node);
        }
        part.need_parents();
        part
    }

    /// Meshes of nodes, with the nodes that are joints of theirs.
    fn of_meshes(root: &Root, nodes: &'a [Placed], is_own: impl Fn(usize) -> bool) -> Self {
        let places = places_of(root, nodes);
        let stated = |at: usize| &root.nodes[nodes[at].node];
        let has_mesh: Vec<bool> =
            (0..nodes.len()).map(|at| stated(at).mesh.is_some() && is_own(at)).collect();
        let mut is_needed = has_mesh.clone();
        for at in (0..nodes.len()).filter(|at| has_mesh[*at]) {
            let skin = stated(at).skin.and_then(|skin| root.get(skin));
            for joint in skin.iter().flat_map(|skin| &skin.joints) {
                if let Some(joint) = places.get(joint.value()).copied().flatten() {
                    is_needed[joint] = true;
                }
            }
        }
        Self { nodes, top: None, has_mesh, is_needed }
    }

    /// Needs the nodes too that those stand under which are needed, up to the top.
    fn need_parents(&mut self) {
        for at in (0..self.nodes.len()).rev() {
            let is_top = self.top.is_some_and(|(top, _)| top == at);
            if let Some(parent) = self.nodes[at].parent.filter(|_| self.is_needed[at] && !is_top) {
                self.is_needed[parent] = true;
            }
        }
    }

    /// Writes it as a GLB.
    pub(super) fn write(&self, context: &Context<'_>, json: &Value, budget: &mut Budget) -> Result<Vec<u8>> {
        let mut writer = Writer::new(context, json, self.top.is_some());
        let kept: Vec<usize> = (0..self.nodes.len()).filter(|at| self.is_needed[*at]).collect();
        let numbers: BTreeMap<usize, usize> =
            kept.iter().enumerate().map(|(new, at)| (self.nodes[*at].node, new)).collect();
        let (mut written, mut tops) = (Vec::with_capacity(kept.len()), Vec::new());
        let mut children: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (new, &at) in kept.iter().enumerate() {
            let parent = self.nodes[at].parent.and_then(|parent| numbers.get(&self.nodes[parent].node));
            match parent {
                Some(parent) => children.entry(*parent).or_default().push(new),
                None => tops.push(new),
            }
            written.push(self.node(&mut writer, at, &numbers, budget)?);
        }
        for (parent, children) in children {
            written[parent].insert("children".to_owned(), json!(children));
        }
        writer.finish(json!(tops), json!(written), budget)
    }

    /// The JSON of a node without its children.
    fn node(
        &self,
        writer: &mut Writer<'_>,
        at: usize,
        numbers: &BTreeMap<usize, usize>,
        budget: &mut Budget,
    ) -> Result<Map<String, Value>> {
        let old = self.nodes[at].node;
        let stated = writer.stated("nodes", old)?;
        let mut node = match &stated["extras"] {
            // What the import reads of them alone.
            extras if self.top.is_some() => {
                let read = picked(extras, &["kiln_lit"]);
                let extras = (!read.is_empty()).then(|| ("extras".to_owned(), json!(read)));
                extras.into_iter().collect()
            }
            _ => picked(stated, &["extras"]),
        };
        match self.top {
            Some((top, object_from_node)) if top == at => {
                let matrix = DAffine3 { matrix3: object_from_node, translation: DVec3::ZERO };
                if object_from_node != DMat3::IDENTITY {
                    node.insert("matrix".to_owned(), json!(DMat4::from(matrix).to_cols_array()));
                }
            }
            _ => node.extend(picked(stated, &TRANSFORMS)),
        }
        if self.has_mesh[at] {
            node.extend(picked(stated, &["weights"]));
            if let Some(mesh) = number(&stated["mesh"]) {
                node.insert("mesh".to_owned(), json!(writer.mesh(mesh, budget)?));
            }
            if let Some(skin) = number(&stated["skin"]) {
                node.insert("skin".to_owned(), json!(writer.skin(skin, numbers, budget)?));
            }
        }
        if self.top.is_none() {
            node.extend(picked(stated, &["name"]));
            if let Some(camera) = number(&stated["camera"]) {
                node.insert("camera".to_owned(), json!(writer.camera(camera)?));
            }
            if let Some(light) = number(&stated["extensions"][LIGHTS]["light"]) {
                node.insert("extensions".to_owned(), json!({LIGHTS: {"light": writer.light(light)?}}));
            }
        }
        Ok(node)
    }
}
