//! The nodes that move, and which of them each node moves with.

use std::collections::BTreeSet;
use std::ops::Range;

use gltf::json::{Index, Node, Root};
use serde_json::Value;

use super::super::document::node_place;
use super::super::error::shown;
use super::tree::{Placed, places_of, subtree};
use super::{MoverError, MoverNodes};

/// Most nodes that move: pictures have at most as many objects.
const MOVERS_MAX: usize = 256;
/// Most names in a hint.
const NAMES_SHOWN: usize = 6;
/// Properties whose animation moves a node.
const MOVING: [&str; 3] = ["translation", "rotation", "scale"];

/// Nodes that move, as places in the list of all.
pub(super) struct Choice {
    /// Their top nodes.
    pub(super) movers: Vec<usize>,
    /// For each node the mover that it moves with: the nearest above it.
    pub(super) owners: Vec<Option<usize>>,
}

/// Chooses the nodes that are to move.
pub(super) fn choose(
    root: &Root,
    json: &Value,
    nodes: &[Placed],
    wanted: &MoverNodes,
) -> Result<Choice, MoverError> {
    let stated = |at: usize| &root.nodes[nodes[at].node];
    let named = named(root, nodes, &wanted.names)?;
    let mut movers = named.clone();
    if wanted.animated {
        let animated = animated(json);
        // A mesh with a skin stands where its joints do, wherever its own node is.
        let moves = |at: &usize| animated.contains(&nodes[*at].node) && stated(*at).skin.is_none();
        movers.extend((0..nodes.len()).filter(moves).filter(|at| !named.contains(at)));
    }
    let has_mesh = own_meshes(&owners(nodes, &movers), movers.len(), |at| stated(at).mesh.is_some());
    if let Some(empty) = (0..named.len()).find(|index| !has_mesh[*index]) {
        return Err(MoverError::NoMesh { place: place(root, nodes, named[empty]) });
    }
    // Joints and cameras that are animated go with what is above them.
    let movers: Vec<usize> =
        movers.into_iter().zip(has_mesh).filter_map(|(top, is_seen)| is_seen.then_some(top)).collect();
    if movers.is_empty() {
        return Err(MoverError::NothingAnimated);
    }
    if movers.len() > MOVERS_MAX {
        return Err(MoverError::TooMany { count: movers.len(), limit: MOVERS_MAX });
    }
    let owners = owners(nodes, &movers);
    if !(0..nodes.len()).any(|at| owners[at].is_none() && stated(at).mesh.is_some()) {
        return Err(MoverError::NothingLeft);
    }
    let places = places_of(root, nodes);
    let below: Vec<Range<usize>> = movers.iter().map(|top| subtree(nodes, *top)).collect();
    for (at, owner) in owners.iter().enumerate() {
        let Some(owner) = owner else { continue };
        check_skin(root, nodes, (at, &below[*owner]), &places)?;
    }
    Ok(Choice { movers, owners })
}

/// The node of each name.
fn named(root: &Root, nodes: &[Placed], names: &[String]) -> Result<Vec<usize>, MoverError> {
    let mut found: Vec<usize> = Vec::new();
    for (index, name) in names.iter().enumerate() {
        if names[..index].contains(name) {
            return Err(MoverError::Twice { name: name.clone() });
        }
        let is_it = |at: &usize| root.nodes[nodes[*at].node].name.as_ref() == Some(name);
        let all: Vec<usize> = (0..nodes.len()).filter(is_it).collect();
        match all[..] {
            [] => {
                return Err(MoverError::Unknown { name: name.clone(), hint: near(root, nodes, name) });
            }
            [one] => found.push(one),
            [..] => return Err(MoverError::Ambiguous { name: name.clone(), count: all.len() }),
        }
    }
    for (outer, inner) in found.iter().flat_map(|outer| found.iter().map(move |inner| (*outer, *inner))) {
        if outer != inner && subtree(nodes, outer).contains(&inner) {
            let [inner, outer] = [inner, outer].map(|at| place(root, nodes, at));
            return Err(MoverError::Inside { inner, outer });
        }
    }
    Ok(found)
}

/// Names that there are, those most like a name first.
fn near(root: &Root, nodes: &[Placed], name: &str) -> String {
    let wanted = name.to_lowercase();
    let unlike = |of: &str| {
        let of = of.to_lowercase();
        let holds = of.contains(&wanted) || wanted.contains(&of);
        let alike = of.chars().zip(wanted.chars()).take_while(|(a, b)| a == b).count();
        (of != wanted, !holds, usize::MAX - alike)
    };
    let stated = nodes.iter().filter_map(|placed| root.nodes[placed.node].name.as_deref());
    let unique: BTreeSet<&str> = stated.filter(|name| !name.is_empty()).collect();
    let mut names: Vec<&str> = unique.into_iter().collect();
    // The sort keeps the order of names that are as much alike.
    names.sort_by_key(|of| unlike(of));
    let more = if names.len() > NAMES_SHOWN { ", …" } else { "" };
    let listed: Vec<String> =
        names.iter().take(NAMES_SHOWN).map(|name| format!("{:?}", shown(name))).collect();
    match listed.is_empty() {
        true => " (its nodes have no names)".to_owned(),
        false => format!(" (there are {}{more})", listed.join(", ")),
    }
}

/// Numbers of the nodes that an animation moves, turns or scales.
fn animated(json: &Value) -> BTreeSet<usize> {
    let animations = json["animations"].as_array().into_iter().flatten();
    let channels = animations.flat_map(|animation| animation["channels"].as_array().into_iter().flatten());
    channels.filter_map(|channel| moved_by(&channel["target"])).collect()
}

/// The node that a channel moves.
fn moved_by(target: &Value) -> Option<usize> {
    let pointer = target["extensions"]["KHR_animation_pointer"]["pointer"].as_str();
    if let Some((node, property)) = pointer.and_then(|way| way.strip_prefix("/nodes/")?.split_once('/')) {
        return MOVING.contains(&property).then(|| node.parse().ok())?;
    }
    MOVING.contains(&target["path"].as_str()?).then(|| usize::try_from(target["node"].as_u64()?).ok())?
}

/// For each node the nearest mover that it is or is below.
fn owners(nodes: &[Placed], movers: &[usize]) -> Vec<Option<usize>> {
    let mut tops = vec![None; nodes.len()];
    movers.iter().enumerate().for_each(|(index, top)| tops[*top] = Some(index));
    let mut owners: Vec<Option<usize>> = Vec::with_capacity(nodes.len());
    for (placed, top) in nodes.iter().zip(tops) {
        owners.push(top.or_else(|| owners[placed.parent?]));
    }
    owners
}

/// Whether each mover has a mesh that is not another one's.
fn own_meshes(owners: &[Option<usize>], count: usize, is_mesh: impl Fn(usize) -> bool) -> Vec<bool> {
    let mut has_mesh = vec![false; count];
    for (at, owner) in owners.iter().enumerate() {
        if let Some(owner) = owner.filter(|_| is_mesh(at)) {
            has_mesh[owner] = true;
        }
    }
    has_mesh
}

/// Errs on a mesh whose joints are not below the mover that it moves with.
fn check_skin(
    root: &Root,
    nodes: &[Placed],
    (at, below): (usize, &Range<usize>),
    places: &[Option<usize>],
) -> Result<(), MoverError> {
    let Node { mesh: Some(_), skin: Some(skin), .. } = &root.nodes[nodes[at].node] else { return Ok(()) };
    // Joints that are not there are an error of the import.
    let joints = root.get(*skin).map_or(&[][..], |skin| &skin.joints);
    let is_outside = |joint: &usize| !places[*joint].is_some_and(|at| below.contains(&at));
    let joints = joints.iter().map(Index::value).filter(|joint| *joint < places.len());
    match joints.into_iter().find(is_outside) {
        None => Ok(()),
        Some(joint) => {
            let [place, joint] = [nodes[at].node, joint].map(|node| node_place(root, node));
            Err(MoverError::SkinOutside { place, joint })
        }
    }
}

fn place(root: &Root, nodes: &[Placed], at: usize) -> String {
    node_place(root, nodes[at].node)
}
