//! The built `kiln` from outside: processes, HTTP, signals, exit codes, files.

#![allow(clippy::unwrap_used, reason = "a test may end at any error")]

mod chaos;
mod ci;
mod colours;
mod commands;
mod crowd;
mod deployment;
mod description;
mod early_light;
mod edits;
mod embedded;
mod enrolment;
mod evaluation;
mod export;
mod farm;
mod full_disk;
mod limits;
mod losses;
mod manners;
mod movers;
#[path = "../../../../server/tests/parts/mod.rs"]
mod parts;
mod patience;
mod probes;
mod processes;
mod replicas;
mod tls;
mod together;
mod tokens;
mod traces;
mod under_way;
mod upkeep;
mod uploads;
#[cfg(feature = "view")]
mod window;
mod words;
mod wrong_input;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A scene that bakes in a second or two with [`SMALL`].
fn cornell() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenes/cornell.glb")
}

/// The scene's bytes, and of its JSON the length and what it says.
fn cornell_and_json() -> (Vec<u8>, usize, serde_json::Value) {
    let glb = std::fs::read(cornell()).unwrap();
    let json_bytes = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let json = serde_json::from_slice(&glb[20..20 + json_bytes]).unwrap();
    (glb, json_bytes, json)
}

/// The scene as a file of its own, its JSON changed.
fn cornell_with(path: &Path, change: impl FnOnce(&mut serde_json::Value)) -> PathBuf {
    let (glb, json_bytes, mut json) = cornell_and_json();
    change(&mut json);
    let mut json = serde_json::to_vec(&json).unwrap();
    json.resize(json.len().next_multiple_of(4), b' ');
    let rest = &glb[20 + json_bytes..];
    let total = (20 + json.len() + rest.len()) as u32;
    let head = [&glb[..8], &total.to_le_bytes(), &(json.len() as u32).to_le_bytes(), &glb[16..20]].concat();
    std::fs::write(path, [&head[..], &json, rest].concat()).unwrap();
    path.to_owned()
}

/// Settings of a small bake that still has several tasks of each kind.
const SMALL: [&str; 8] = [
    "--preset",
    "draft",
    "--set",
    "receivers_target=3000",
    "--set",
    "cluster_receivers=256",
    "--set",
    "transport_rays=32",
];

/// Every file of a bundle but its report, by path, with the blake3 digest of its bytes.
fn bundle(folder: &Path) -> BTreeMap<String, String> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        for entry in std::fs::read_dir(&inner).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if !path.ends_with("report.json") {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                let digest = lightkiln_proto::ids::Digest::of(&std::fs::read(&path).unwrap());
                files.insert(name, digest.to_string());
            }
        }
    }
    assert!(files.len() > 3, "a bundle has a manifest and several chunks: {files:?}");
    files
}
