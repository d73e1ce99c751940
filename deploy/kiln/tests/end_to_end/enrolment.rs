//! A worker that gets a token of its own for a code.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use super::farm::arguments;
use super::processes::{Running, Server, kiln, run};

fn code(state: &Path, name: &str) -> String {
    run(kiln(state), &["token", "enrol", name], 0).stdout().trim().to_owned()
}

/// A worker that keeps its token below `folder`.
fn worker(folder: &Path, url: &str, more: &[&str]) -> Running {
    let mut command = kiln(folder);
    command.args(["worker", "--server", url, "--threads", "2", "--lease-secs", "5"]).args(more);
    Running::start(command)
}

#[test]
fn worker_exchanges_its_code_once_and_works_with_its_own_token_from_then_on() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("server");
    let created = run(kiln(&state), &["token", "create", "ci", "--scope", "submit"], 0);
    let submit = created.stdout().trim().to_owned();
    let code = code(&state, "oven");
    let server = Server::start(&state);
    let place = folder.path().join("oven");
    let first = worker(&place, &server.url, &["--enrol", &code]);
    first.stderr_line(|line| line.contains("enrolled as oven").then_some(()));
    let file = place.join("worker-token");
    assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
    let token = std::fs::read_to_string(&file).unwrap();
    assert!(!token.contains(&code), "a code is not kept");
    first.signal("TERM");
    assert_eq!(first.wait(), Some(0));
    // The next start needs no code, and one that was used up does no harm.
    let _worker = worker(&place, &server.url, &["--enrol", &code]);
    let mut bake = kiln(folder.path());
    bake.env("KILN_TOKEN", &submit);
    let out = folder.path().join("out").display().to_string();
    run(bake, &arguments("bake", &["--server", &server.url, "--out", &out]), 0);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), token);
    // The same code gives nothing to anybody else, who keeps nothing of it.
    let thief = folder.path().join("thief");
    let refused = run(kiln(&thief), &["worker", "--server", &server.url, "--enrol", &code], 2);
    assert!(refused.stderr().contains("used before"), "{}", refused.stderr());
    assert!(!thief.join("worker-token").exists());
    let listed = run(kiln(&state), &["token", "list", "--json"], 0).json();
    let oven = listed.as_array().unwrap().iter().find(|bearer| bearer["name"] == "oven").unwrap();
    assert_eq!(oven["scopes"], serde_json::json!(["worker"]));
    assert!(!listed.to_string().contains(&code));
}

#[test]
fn code_waits_for_a_server_that_is_away_and_is_made_for_a_new_name_only() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("server");
    let code = code(&state, "oven");
    let port = super::parts::keeper::free_port();
    let url = format!("http://127.0.0.1:{port}");
    let waiting = worker(&folder.path().join("oven"), &url, &["--enrol", &code]);
    waiting.stderr_line(|line| line.contains("could not be enrolled").then_some(()));
    let mut command = kiln(&state);
    command.args(["server", "--listen", &format!("127.0.0.1:{port}")]);
    let _server = Running::start(command);
    waiting.stderr_line(|line| line.contains("enrolled as oven").then_some(()));
    let refused = run(kiln(&state), &["token", "enrol", "oven"], 2);
    assert!(refused.stderr().contains("another name"), "{}", refused.stderr());
    run(kiln(&state), &["token", "create", "x", "--scope", "enrol"], 2);
}
