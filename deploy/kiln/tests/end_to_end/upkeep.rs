//! Upkeep of a farm: checks of its bytes, and commands that change its bakes.

use std::path::{Path, PathBuf};

use super::bundle;
use super::farm::arguments;
use super::processes::{Server, kiln, run};

/// Files of stored chunks, by name.
pub fn chunk_files(state: &Path) -> Vec<PathBuf> {
    let shards = std::fs::read_dir(state.join("chunks")).unwrap().map(|entry| entry.unwrap().path());
    let files = shards.flat_map(|shard| std::fs::read_dir(shard).unwrap());
    let mut files: Vec<PathBuf> = files.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn damaged_and_missing_chunks_are_found_repaired_and_baked_again() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let bake = |name: &str| {
        let out = folder.path().join(name);
        let words = out.display().to_string();
        let summary = run(kiln(&state), &arguments("bake", &["--out", &words, "--json"]), 0).json();
        (bundle(&out), summary["tasks_run"].as_u64().unwrap())
    };
    let (first, tasks) = bake("first");
    let place = state.display().to_string();
    let fsck = |more: &[&str], exit: i32| {
        run(kiln(&state), &[&["fsck", "--state", &place, "--grace-hours", "0"], more].concat(), exit)
    };
    assert!(fsck(&[], 0).stdout().contains("chunks"));
    let files = chunk_files(&state);
    assert!(files.len() > 10, "{} chunks", files.len());
    std::fs::remove_file(&files[1]).unwrap();
    let whole = std::fs::read(&files[5]).unwrap();
    std::fs::write(&files[5], vec![b'x'; whole.len()]).unwrap();
    std::fs::write(files[5].with_extension("00000000000000aa"), b"nobody's").unwrap();
    let found = fsck(&["--json"], 5).json();
    for kind in ["missing", "corrupt", "orphaned"] {
        assert_eq!(found[kind].as_array().unwrap().len(), 1, "{found}");
    }
    let told = fsck(&["--quick"], 5);
    assert!(told.stderr().contains("kiln fsck --repair"), "{}", told.stderr());
    assert!(!told.stdout().contains("corrupt"), "nothing was read: {}", told.stdout());
    let repaired =
        run(kiln(&state), &["fsck", "--state", &place, "--grace-hours", "0", "--repair", "--json"], 0);
    assert_eq!(repaired.json()["repaired"], true);
    assert_eq!(repaired.json()["incomplete"].as_array().unwrap().len(), 1, "the first bake");
    assert!(fsck(&[], 0).stdout().contains("a new bake of its scene makes them"));
    let (second, again) = bake("second");
    assert_eq!(second, first);
    assert!((1..tasks).contains(&again), "{again} of {tasks} tasks ran again");
    assert_eq!(fsck(&["--json"], 0).json()["incomplete"], serde_json::json!([]));
}

#[test]
fn bakes_are_paused_resumed_hurried_cancelled_and_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path());
    let call = |command: &[&str], exit: i32| {
        run(kiln(folder.path()), &[command, &["--server", &server.url]].concat(), exit)
    };
    let needs = ["--server", &server.url, "--needs-label", "gpu", "--needs-threads", "9", "--priority", "2"];
    let id = run(kiln(folder.path()), &arguments("submit", &needs), 0).stdout().trim().to_owned();
    let shown = call(&["show", &id, "--json"], 0).json();
    assert_eq!(shown["needs"], serde_json::json!({ "memory_mib": 0, "threads": 9, "labels": ["gpu"] }));
    call(&["pause", &id], 0);
    assert!(call(&["list"], 0).stdout().contains("paused"));
    call(&["priority", &id, "-3"], 0);
    assert_eq!(call(&["show", &id, "--json"], 0).json()["priority"], -3);
    call(&["resume", &id], 0);
    assert!(call(&["list"], 0).stdout().contains("running"));
    assert!(call(&["blocklist", &id], 0).stderr().contains("no worker failed"));
    assert_eq!(call(&["blocklist", &id, "--clear", "--json"], 0).json()["workers"], serde_json::json!([]));
    let refused = call(&["delete", &id], 2);
    assert!(refused.stderr().contains("cannot be deleted"), "{}", refused.stderr());
    call(&["cancel", &id], 0);
    call(&["pause", &id], 2);
    let log = call(&["logs", &id, "--follow"], 0).stdout();
    for told in
        ["submitted", "planned   7 tasks", "state     paused", "state     running", "state     cancelled"]
    {
        assert!(log.contains(told), "{told} is not in\n{log}");
    }
    let events = call(&["logs", &id, "--json"], 0).stdout();
    let last: serde_json::Value = serde_json::from_str(events.lines().last().unwrap()).unwrap();
    assert_eq!(last["event"], serde_json::json!({ "type": "state", "state": "cancelled" }));
    let table = call(&["top"], 0).stdout();
    assert!(table.contains(&id) && table.contains("cancelled") && table.contains("WORKER"), "{table}");
    call(&["delete", &id], 0);
    assert!(call(&["list"], 0).stderr().contains("no bakes here"));
}
