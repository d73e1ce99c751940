//! No room that kinds of bake share names a kind: a new kind is its folders and its rows in the tables.

use std::collections::BTreeSet;

use lightkiln_proto::kinds::Kinds;

use super::words::{code_of, is_test};
use super::{CRATES, files_below, text_of};

/// Rooms of kinds, and the tables beside them.
const ROOMS_OF_KINDS: [&str; 3] = ["proto/src/kinds", "worker/src/kinds", "client/src/kinds"];

/// Rooms of what kinds have in common whose own word is the name of one.
const ROOMS_BESIDE: [&str; 2] = ["proto/src/voxels", "proto/src/transfer"];

/// Words of a line of code: runs of letters, digits and underscores, also within texts.
fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty())
}

/// Names that are words of everyday, too: they count where they stand in a path of kinds or begin a text.
const EVERYDAY: [&str; 3] = ["grid", "transfer", "voxels"];

/// Lines of a file's code with a word that names a kind, in any case: `prt`, `"prt.plan"`, `Prt`.
fn names_of_kinds(text: &str, kinds: &BTreeSet<String>) -> Vec<String> {
    let by_word = |line: &str| {
        let mut words = words(line).map(str::to_lowercase);
        words.any(|word| kinds.contains(&word) && !EVERYDAY.contains(&word.as_str()))
    };
    let by_place = |line: &str| {
        let places = |name: &str| [format!("kinds::{name}"), format!("\"{name}\""), format!("\"{name}.")];
        let everyday = EVERYDAY.iter().filter(|name| kinds.contains(**name));
        everyday.flat_map(|name| places(name)).any(|place| line.contains(&place))
    };
    let named = |line: &&str| by_word(line) || by_place(line);
    code_of(text).filter(named).map(str::to_owned).collect()
}

/// Doc comments of fields and variants, which command lines print as help.
fn help_of(text: &str) -> String {
    let lines = text.lines().filter(|line| line.starts_with(' '));
    lines.filter_map(|line| line.trim_start().strip_prefix("///")).map(|line| format!("{line}\n")).collect()
}

fn all_kinds() -> BTreeSet<String> {
    let names: BTreeSet<String> = Kinds::new().iter().map(|kind| kind.name().to_owned()).collect();
    assert!(names.len() > 1, "next to no kinds: the table is broken");
    names
}

#[test]
fn shared_rooms_name_no_kind() {
    let kinds = all_kinds();
    let mut found = Vec::new();
    let mut checked = 0;
    for folder in CRATES.iter().filter(|folder| **folder != "tests") {
        for path in files_below(&format!("{folder}/src"), "rs") {
            let rooms = ROOMS_OF_KINDS.iter().chain(&ROOMS_BESIDE);
            if is_test(&path) || rooms.into_iter().any(|room| path.starts_with(room)) {
                continue;
            }
            checked += 1;
            let text = text_of(&path);
            let mut lines = names_of_kinds(&text, &kinds);
            if folder.starts_with("deploy") {
                lines.extend(names_of_kinds(&help_of(&text), &kinds));
            }
            found.extend(lines.into_iter().map(|line| format!("{}: {}", path.display(), line.trim())));
        }
    }
    assert!(checked > 100, "next to no files: the walk is broken");
    assert!(found.is_empty(), "shared rooms that name a kind: {found:#?}");
}

#[test]
fn every_kind_has_its_folder_in_each_room() {
    for kind in all_kinds() {
        for room in ROOMS_OF_KINDS {
            let folder = super::root().join(room).join(&kind);
            assert!(folder.is_dir(), "kind '{kind}' has no folder in {room}");
        }
    }
}

#[test]
fn a_name_in_a_path_a_text_or_a_type_is_found_and_one_in_a_comment_or_a_longer_word_is_not() {
    let kinds = ["prt".to_owned(), "sh".to_owned()].into();
    let found = |text: &str| names_of_kinds(text, &kinds).len();
    assert_eq!(found("use kinds::prt::Settings;\nlet a = \"prt.plan\";\nlet b = Prt;\nfn f(sh: u32) {}"), 4);
    assert_eq!(help_of("/// prt\n    /// By prt.\n    pub a: u8,"), " By prt.\n");
    assert_eq!(found("// prt\nlet shade = \"wash\"; let prts = 1;"), 0);
    let kinds = ["grid".to_owned()].into();
    let found = |text: &str| names_of_kinds(text, &kinds).len();
    assert_eq!(found("use kinds::grid::Settings;\nlet a = \"grid\";\nlet b = \"grid.plan\";"), 3);
    assert_eq!(found("let grid = Grid::over(bounds);"), 0);
}
