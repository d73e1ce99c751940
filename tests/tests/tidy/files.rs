//! The length of files, and what ARCHITECTURE.md must name.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::{CRATES, files_below, text_of};

/// Past this a file must say why, in a line that begins with [`REASON`].
const RUST_LINES_MAX: usize = 500;
const WGSL_LINES_MAX: usize = 250;
const REASON: &str = "// Long file: ";

fn too_long(path: &Path, lines_max: usize) -> Option<String> {
    let text = text_of(path);
    let lines = text.lines().count();
    let has_reason = text.lines().any(|line| line.starts_with(REASON) && line.len() > REASON.len() + 10);
    (lines > lines_max && !has_reason).then(|| format!("{} has {lines} lines", path.display()))
}

#[test]
fn files_are_short_or_say_why_not() {
    let rust = CRATES.iter().flat_map(|folder| files_below(folder, "rs"));
    let mut long: Vec<String> = rust.filter_map(|path| too_long(&path, RUST_LINES_MAX)).collect();
    long.extend(files_below("client", "wgsl").iter().filter_map(|path| too_long(path, WGSL_LINES_MAX)));
    assert!(long.is_empty(), "split these, or begin a line with '{REASON}' and the reason: {long:#?}");
}

#[test]
fn architecture_names_every_crate_and_module_folder() {
    let text = text_of(Path::new("ARCHITECTURE.md"));
    let mut folders: BTreeSet<PathBuf> = CRATES.iter().map(PathBuf::from).collect();
    for crate_folder in CRATES {
        let source = Path::new(crate_folder).join("src");
        for file in files_below(&source.display().to_string(), "rs") {
            let above = file.ancestors().skip(1).take_while(|folder| *folder != source);
            // Tests beside their code are no room of their own.
            folders.extend(above.filter(|folder| !folder.ends_with("tests")).map(Path::to_owned));
        }
    }
    assert!(folders.len() > 2 * CRATES.len(), "next to no module folders: the walk is broken");
    let missing: Vec<PathBuf> = folders.into_iter().filter(|folder| !names(&text, folder)).collect();
    assert!(missing.is_empty(), "ARCHITECTURE.md's code map has no row or no word for these: {missing:#?}");
}

/// Whether a row of the code map begins with the folder's path, or the row of a folder above it has its name.
fn names(text: &str, folder: &Path) -> bool {
    let name = folder.file_name().expect("a folder has a name").to_string_lossy();
    let row_of = |folder: &Path| {
        let path = folder.display();
        let starts = [format!("| `{path}`"), format!("| `{path}/`")];
        text.lines().find(|line| starts.iter().any(|start| line.starts_with(start)))
    };
    let is_word = |word: &str| word.eq_ignore_ascii_case(&name);
    let above = || folder.ancestors().skip(1).take_while(|above| !above.ends_with("src")).find_map(row_of);
    row_of(folder).is_some()
        || above().is_some_and(|row| row.split(|c: char| !c.is_alphanumeric()).any(is_word))
}

#[test]
fn folder_is_named_by_its_own_row_or_by_a_word_in_a_row_above_it() {
    let map = "| `worker/src/prt` | `prepare`, `factor` |\n| `tests/` (`lightkiln-tests`) | the scenes |";
    let is_named = |folder: &str| names(map, Path::new(folder));
    assert!(is_named("worker/src/prt") && is_named("worker/src/prt/prepare") && is_named("tests"));
    assert!(!is_named("worker/src/prt/assemble"), "its row says nothing of it");
    assert!(!is_named("tests/src/scenes"), "a module folder needs a row of its own");
    assert!(!is_named("worker/src/rays"));
}
