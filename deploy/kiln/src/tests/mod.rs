//! The files of `deploy/`, and every command that they and the pages tell people to type.

mod ci;
mod commands;
mod compose;
mod container;
mod kubernetes;
mod managers;
mod memory;
mod schemas;
mod systemd;

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

/// The repository's root.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A file's text, by its path from the root.
fn text_of(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The documents of a YAML file.
fn documents(path: &str) -> Vec<Value> {
    let text = text_of(path);
    let documents: Vec<Value> =
        serde_saphyr::from_multiple(&text).unwrap_or_else(|error| panic!("{path}: {error}"));
    assert!(!documents.is_empty(), "{path} is empty");
    documents
}

/// Names of the files in a folder, by ending; there are some.
fn names_in(folder: &str, ending: &str) -> Vec<String> {
    let entries = fs::read_dir(root().join(folder)).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name.ends_with(ending)).collect();
    assert!(!names.is_empty(), "no {ending} in {folder}");
    names.sort();
    names
}

/// A list of texts.
fn texts(list: &Value) -> Vec<&str> {
    let list = list.as_array().unwrap_or_else(|| panic!("no list: {list}"));
    list.iter().map(|text| text.as_str().unwrap_or_else(|| panic!("no text: {text}"))).collect()
}

/// Whether an image says which version it is, by numbers, and names no host.
fn is_pinned(image: &str) -> bool {
    let (name, tag) = image.rsplit_once(':').unwrap_or((image, "latest"));
    let host = name.split('/').next().unwrap_or_default();
    let has_host = name.contains('/') && host.contains(['.', ':']);
    let numbers =
        tag.trim_start_matches('v').split(['.', '-']).take_while(|part| part.parse::<u32>().is_ok());
    !has_host && numbers.count() >= 2
}

#[test]
fn image_is_pinned_by_two_numbers_at_least() {
    for (image, expected) in [
        ("postgres:17.6", true),
        ("versity/versitygw:v1.7.0", true),
        ("rust:1.95.0-trixie", true),
        ("debian:13.2-slim", true),
        ("postgres:17", false),
        ("postgres:latest", false),
        ("postgres", false),
        ("debian:trixie-slim", false),
        ("registry.example/postgres:17.6", false),
    ] {
        assert_eq!(is_pinned(image), expected, "{image}");
    }
}
