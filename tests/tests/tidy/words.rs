//! Words that must not stand in some places: each is an invariant of ARCHITECTURE.md.

use std::path::Path;

use super::{files_below, text_of};

/// Panics when a file of `folder` that is not `excepted` has one of `words` in its code.
fn assert_absent(folder: &str, words: &[&str], excepted: impl Fn(&Path) -> bool) {
    let mut checked = 0;
    for path in files_below(folder, "rs").iter().filter(|path| !excepted(path)) {
        checked += 1;
        let text = text_of(path);
        for (index, line) in code_of(&text).enumerate() {
            let found = words.iter().find(|word| line.contains(**word));
            assert!(found.is_none(), "{}:{}: {:?} must not stand here", path.display(), index + 1, found);
        }
    }
    assert!(checked > 0, "every file of {folder} is excepted: the check is broken");
}

/// The lines before the tests, without comments.
pub fn code_of(text: &str) -> impl Iterator<Item = &str> {
    let lines = text.lines().take_while(|line| !line.starts_with("#[cfg(test)]"));
    lines.map(|line| line.split("//").next().unwrap_or(line))
}

pub fn is_test(path: &Path) -> bool {
    let folders = ["tests", "fixture"];
    path.components().any(|part| folders.iter().any(|folder| part.as_os_str() == *folder))
        || path.ends_with("tests.rs")
}

#[test]
fn contract_touches_no_files_clocks_or_threads() {
    let words = ["std::fs", "std::net", "std::env", "std::process", "std::thread", "Instant", "SystemTime"];
    assert_absent("proto/src", &words, is_test);
}

#[test]
fn bake_maths_knows_no_network_clock_or_randomness() {
    let words = [
        "lightkiln_http",
        "ureq",
        "std::net",
        "Instant",
        "SystemTime",
        "std::thread",
        "RandomState",
        "std::env",
    ];
    let is_runtime = |path: &Path| path.starts_with("worker/src/runtime") || is_test(path);
    assert_absent("worker/src", &words, is_runtime);
}

#[test]
fn server_does_not_read_what_a_plan_means() {
    let words = ["kinds::prt", "kinds::sh", "SceneTask", "Manifest", "receiver", "probe_", "chunk::decode"];
    assert_absent("server/src", &words, is_test);
}

#[test]
fn every_insert_of_the_server_names_its_columns() {
    let mut checked = 0;
    for path in files_below("server/src", "rs") {
        let text = text_of(&path);
        for statement in text.split("INSERT ").skip(1) {
            let (_, into) = statement.split_once("INTO ").expect("an INSERT says where it inserts");
            let columns = into.trim_start_matches(|c: char| c.is_ascii_lowercase() || c == '_').trim_start();
            assert!(columns.starts_with('('), "{}: INSERT {statement:.60}…", path.display());
            checked += 1;
        }
    }
    assert!(checked > 20, "{checked} INSERTs found: the walk is broken");
}

#[test]
fn words_in_tests_and_comments_are_not_code() {
    let text = "let a = 1; // Instant\n/// Instant\n#[cfg(test)]\nInstant";
    assert!(code_of(text).all(|line| !line.contains("Instant")));
    assert_eq!(code_of(text).count(), 2);
}

/// A test that ends early where something is missing would pass by its absence: it is marked `#[ignore]`, with what it
/// needs, and `tests/run` asks for it where that is there.
#[test]
fn no_test_says_by_itself_that_it_is_ignored() {
    let mut ignored = 0;
    for path in files_below("", "rs") {
        let text = text_of(&path);
        for (index, line) in text.lines().enumerate() {
            let says =
                line.contains("println!(\"") && ["ignored", "skipped"].iter().any(|word| line.contains(word));
            assert!(!says, "{}:{}: mark it #[ignore = \"needs …\"]", path.display(), index + 1);
            ignored += usize::from(line.trim_start().starts_with("#[ignore = \"needs "));
        }
    }
    assert!(ignored > 10, "{ignored} tests are marked: the check is broken");
}
