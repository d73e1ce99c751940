//! House rules that a compiler does not check: arrows between crates and between rooms, names in ARCHITECTURE.md, the
//! length of files.

mod crates;
mod faults;
mod files;
mod kinds;
mod rooms;
mod words;

use std::path::{Path, PathBuf};

/// The repository's root.
fn root() -> PathBuf {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest.parent().expect("tests/ lies in the repository").to_owned()
}

/// Crate folders of the workspace.
const CRATES: [&str; 7] = ["proto", "proto/http", "server", "worker", "client", "deploy/kiln", "tests"];

/// Files below `folder` whose name ends with `.ending`, ascending, as paths from the root; panics if there are none.
fn files_below(folder: &str, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        let entries =
            std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        for entry in entries {
            let path = entry.expect("a folder can be read to its end").path();
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|found| found == ending) {
                found.push(path.strip_prefix(root()).expect("it lies below the root").to_owned());
            }
        }
    }
    assert!(!found.is_empty(), "no .{ending} files below {folder}: the walk is broken");
    found.sort();
    found
}

fn text_of(path: &Path) -> String {
    let path = root().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
