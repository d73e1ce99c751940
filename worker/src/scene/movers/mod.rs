//! Nodes that move, taken out of a scene: the scene without them, and each as a scene of its own, in its own frame.
//!
//! Every part is written anew as a GLB that holds the meshes, materials and images that its nodes name, uncompressed and in the order in which
//! they are named. So the bytes of an object hang on its shape and materials alone: not on the scene around it, on its place there, or on
//! the names of its nodes.

mod choice;
mod error;
mod frame;
mod part;
mod tree;
mod write;

use gltf::json::Root;
use lightkiln_proto::scene::Stance;
use serde_json::Value;

use super::context::Context;
use super::document::{self, ANIMATIONS, node_place};
use super::error::ImportError;
use super::limits::{self, Budget};
use super::model::Warning;
use super::nodes::OTHER_SCENES;
use super::warnings::Warnings;
use super::{Bundle, Limits, Opening, opened};

pub use error::MoverError;

use choice::{Choice, choose};
use frame::Frame;
use part::Part;
use tree::{Placed, has_light, placed, subtree};

/// Nodes that are to move.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MoverNodes {
    /// Names, each of one node, which moves with all below it.
    pub names: Vec<String>,
    /// All nodes too that an animation moves, turns or scales. One below another is an object of its own.
    pub animated: bool,
}

/// A scene without what moves in it, and what does.
#[derive(Clone, Debug)]
pub struct Split {
    /// The scene without them, a GLB.
    pub rest: Vec<u8>,
    /// Those that move: as they were named, then in the order of the file.
    pub objects: Vec<SplitObject>,
    /// What was not honoured.
    pub warnings: Vec<Warning>,
}

/// A node that moves, with what is below it.
#[derive(Clone, Debug)]
pub struct SplitObject {
    /// Name of the node, or its number.
    pub name: String,
    /// Its scene, a GLB, in the frame of the node: its scale is in the meshes, its place and turn are not.
    pub scene: Vec<u8>,
    /// Where the scene has it at rest.
    pub stance: Stance,
}

/// Takes nodes out of the scene of a bundle. Lights and cameras below them stay where they are, in the scene.
///
/// The result is a pure function of its arguments. Errors on names that are no single node's, on nodes without meshes, on a scene of which
/// nothing is left, and on whatever [`super::import`] would refuse.
pub fn split(bundle: &Bundle, wanted: &MoverNodes, limits: &Limits) -> Result<Split, MoverError> {
    let json = document::values(bundle.root_bytes())?;
    opened(bundle, limits, Opening::Still, |context| Ok(split_in(context, &json, wanted)))?
}

fn split_in(context: &mut Context<'_>, json: &Value, wanted: &MoverNodes) -> Result<Split, MoverError> {
    let nodes = placed(context)?;
    let root = context.root;
    let Choice { movers, owners } = choose(root, json, &nodes, wanted)?;
    let mut budget = Budget::new(limits::UPLOAD_BYTES, context.limits.bundle_bytes);
    let mut warnings = Warnings::default();
    let mut objects = Vec::new();
    for (index, &top) in movers.iter().enumerate() {
        let frame = Frame::of(&nodes[top])
            .ok_or_else(|| ImportError::NonFiniteTransform { place: node_place(root, nodes[top].node) })?;
        let is_own = |at: usize| owners[at] == Some(index);
        let part = Part::object(root, &nodes, top, frame.object_from_node, is_own);
        warn_of_lights(root, &nodes, (top, is_own), &mut warnings);
        let scene = part.write(context, json, &mut budget)?;
        objects.push(SplitObject { name: name_of(root, nodes[top].node), scene, stance: frame.stance });
    }
    let rest = Part::rest(root, &nodes, |at| owners[at].is_none()).write(context, json, &mut budget)?;
    let found = std::mem::take(&mut context.warnings).finish().into_iter();
    let lost = found.filter(|warning| is_lost(&warning.code, wanted));
    Ok(Split { rest, objects, warnings: lost.chain(warnings.finish()).collect() })
}

/// Whether no import of the parts warns of what this warning is about: they have one scene, and no animations.
fn is_lost(code: &str, wanted: &MoverNodes) -> bool {
    code == OTHER_SCENES || (code == ANIMATIONS && !wanted.animated)
}

/// The node's name, or its number.
fn name_of(root: &Root, node: usize) -> String {
    let stated = root.nodes[node].name.clone().filter(|name| !name.is_empty());
    stated.unwrap_or_else(|| format!("node {node}"))
}

/// Warns of lights below a node that moves.
fn warn_of_lights(
    root: &Root,
    nodes: &[Placed],
    (top, is_own): (usize, impl Fn(usize) -> bool),
    warnings: &mut Warnings,
) {
    let lights = subtree(nodes, top).filter(|at| is_own(*at) && has_light(root, nodes[*at].node)).count();
    warnings.add_many("light-stays-behind", lights as u64, || {
        format!(
            "{} has a light below it, which stays in the scene where it is: it does not move with the object",
            node_place(root, nodes[top].node)
        )
    });
}
