//! Every `kiln …` that a page or a file shows is one that the program takes.

use clap::{CommandFactory as _, Parser as _};

use super::{documents, names_in, text_of, texts};
use crate::command_line::CommandLine;

/// Panics unless the program takes these arguments.
pub(super) fn assert_taken(place: &str, arguments: &[String]) {
    let line = ["kiln".to_owned()].into_iter().chain(arguments.iter().cloned());
    if let Err(error) = CommandLine::try_parse_from(line) {
        let is_help = matches!(
            error.kind(),
            clap::error::ErrorKind::DisplayHelp | clap::error::ErrorKind::DisplayVersion
        );
        assert!(is_help, "{place}: kiln {}:\n{error}", arguments.join(" "));
    }
}

/// The arguments of each call of `kiln` in a line of shell, also within containers that run it.
pub(super) fn calls(line: &str) -> Vec<Vec<String>> {
    let inner = line.replace("$(", " ; ").replace(')', " ; ").replace([';', '|'], " ; ");
    let words = shlex::split(&inner).unwrap_or_else(|| panic!("no line of shell: {line}"));
    words
        .split(|word| matches!(word.as_str(), ";" | "&&" | "||" | ">" | ">>" | "&"))
        .filter_map(|words| {
            let is_kiln = |word: &String| word == "kiln" || word.ends_with("/kiln");
            let in_service =
                words.iter().any(|word| word == "compose") && words.iter().any(|word| word == "run");
            let begin = match in_service {
                true => words.iter().position(|word| word == "server"),
                false => words.iter().position(is_kiln).filter(|at| leads_in(&words[..*at])),
            };
            Some(words[begin? + 1..].to_vec())
        })
        .collect()
}

/// Whether a command may stand after these words: variables, or another user's name.
fn leads_in(words: &[String]) -> bool {
    words.iter().all(|word| {
        word.contains('=') || matches!(word.as_str(), "sudo" | "-u" | "lightkiln" | "env" | "exec")
    })
}

/// The calls within the fences of a page, with lines that end with a backslash joined.
fn calls_of_page(path: &str) -> Vec<Vec<String>> {
    let text = text_of(path).replace("\\\n", " ");
    let mut in_fence = false;
    let mut found = Vec::new();
    for line in text.lines() {
        match line.strip_prefix("```") {
            Some(kind) => in_fence = kind == "sh",
            None if in_fence => found.extend(calls(line)),
            None => (),
        }
    }
    found
}

#[test]
fn pages_show_only_commands_that_there_are() {
    for (page, at_least) in [("deploy/README.md", 12), ("deploy/ci/README.md", 1), ("README.md", 6)] {
        let calls = calls_of_page(page);
        assert!(calls.len() >= at_least, "{page} has {} commands: the walk is broken", calls.len());
        for call in calls {
            assert_taken(page, &call);
        }
    }
}

#[test]
fn words_between_backticks_that_begin_with_the_programs_name_are_commands() {
    let mut checked = 0;
    for page in ["deploy/README.md", "deploy/ci/README.md", "README.md", "CHANGELOG.md"] {
        for code in text_of(page).split('`').skip(1).step_by(2) {
            let mut words = code.split_whitespace();
            if words.next() != Some("kiln") {
                continue;
            }
            let Some(name) = words.next() else { continue };
            let name = name.trim_end_matches(['…', ',']);
            let known = CommandLine::command();
            let is_known = name.starts_with('-') || matches!(name, "help" | "COMMAND");
            assert!(is_known || known.find_subcommand(name).is_some(), "{page}: `{code}`");
            checked += 1;
        }
    }
    assert!(checked > 20, "{checked} commands between backticks: the walk is broken");
}

#[test]
fn units_start_what_there_is() {
    for name in names_in("deploy/systemd", ".service") {
        let path = format!("deploy/systemd/{name}");
        let text = text_of(&path);
        let starts: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("ExecStart=")).collect();
        assert_eq!(starts.len(), 1, "{path}");
        let calls = calls(starts[0]);
        assert_eq!(calls.len(), 1, "{path}");
        assert_taken(&path, &calls[0]);
    }
}

#[test]
fn containers_run_what_there_is() {
    let mut found = Vec::new();
    let compose = documents("deploy/compose.yaml");
    for (name, service) in compose[0]["services"].as_object().unwrap() {
        if service["image"].as_str().is_some_and(|image| image.starts_with("lightkiln")) {
            found.push((format!("deploy/compose.yaml: {name}"), service["command"].clone()));
        }
    }
    for name in names_in("deploy/kubernetes", ".yaml") {
        let path = format!("deploy/kubernetes/{name}");
        for document in documents(&path) {
            let containers = &document["spec"]["template"]["spec"]["containers"];
            let containers = containers.as_array().into_iter().flatten();
            found.extend(containers.map(|container| (path.clone(), container["args"].clone())));
        }
    }
    assert_eq!(found.len(), 5, "server and worker twice, and a job: {found:#?}");
    for (place, arguments) in found {
        let arguments: Vec<String> = texts(&arguments).into_iter().map(str::to_owned).collect();
        assert!(!arguments.is_empty(), "{place}");
        assert_taken(&place, &arguments);
    }
}

#[test]
fn templates_for_ci_run_what_there_is() {
    for (place, script) in super::ci::scripts() {
        let calls: Vec<_> = script.lines().flat_map(calls).collect();
        assert_eq!(calls.len(), 1, "{place}: {script}");
        assert_taken(place, &calls[0]);
    }
}

#[test]
fn calls_are_found_behind_variables_users_and_containers() {
    let found = |line: &str| calls(line).into_iter().map(|call| call.join(" ")).collect::<Vec<_>>();
    assert_eq!(found("KILN_TOKEN=a kiln list --json | tail -1"), ["list --json"]);
    assert_eq!(found("B=$(kiln submit 's c.glb') && kiln watch \"$B\""), ["submit s c.glb", "watch $B"]);
    assert_eq!(found("sudo -u lightkiln kiln token list"), ["token list"]);
    assert_eq!(found("docker compose run --rm server token list"), ["token list"]);
    assert_eq!(found("/usr/local/bin/kiln worker"), ["worker"]);
    assert!(found("install kiln /usr/bin").is_empty() && found("cargo build").is_empty());
}

#[test]
#[should_panic(expected = "--no-such-flag")]
fn flag_that_does_not_exist_is_found() {
    assert_taken("a page", &["server", "--no-such-flag"].map(str::to_owned));
}

#[test]
#[should_panic(expected = "SCENE")]
fn argument_that_is_missing_is_found() {
    assert_taken("a page", &["submit"].map(str::to_owned));
}
