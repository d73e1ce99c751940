//! Scenes as they are, turned in space: what is right of one is right of the other.

use glam::Quat;
use serde_json::{Value, json};

/// Bytes of a binary glTF's header, and of the header of a part of it.
const HEADER: usize = 12;
const PART: usize = 8;

/// A binary glTF turned about the origin: all that stands in its scene is put into one node more.
///
/// # Panics
/// If it is not one of ours.
pub fn turned(scene: &[u8], turn: Quat) -> Vec<u8> {
    let size = |at: usize| u32::from_le_bytes(scene[at..at + 4].try_into().expect("four bytes")) as usize;
    let (begin, end) = (HEADER + PART, HEADER + PART + size(HEADER));
    let mut document: Value = serde_json::from_slice(&scene[begin..end]).expect("a document");
    let nodes = document["nodes"].as_array_mut().expect("nodes");
    let root = nodes.len();
    nodes.push(json!({ "name": "turned", "rotation": turn.to_array() }));
    let whole = document["scenes"][0]["nodes"].take();
    document["nodes"][root]["children"] = whole;
    document["scenes"][0]["nodes"] = json!([root]);
    let mut text = serde_json::to_vec(&document).expect("a document");
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = (HEADER + PART + text.len() + scene.len() - end) as u32;
    let mut glb = scene[..8].to_vec();
    glb.extend(length.to_le_bytes());
    glb.extend((text.len() as u32).to_le_bytes());
    glb.extend(&scene[HEADER + 4..begin]);
    glb.extend(text);
    glb.extend(&scene[end..]);
    glb
}
