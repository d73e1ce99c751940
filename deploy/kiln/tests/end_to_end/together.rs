//! Several `kiln bake` on one state folder at once.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::Path;

use serde_json::Value;

use super::processes::{Running, Server, kiln, run};
use super::{SMALL, bundle, cornell};

/// A bake in the state folder `folder/state`, to `folder/NAME`, that takes a while.
fn start(folder: &Path, name: &str, rays: u32) -> Running {
    let mut command = kiln(&folder.join("state"));
    command.arg("bake").arg(cornell()).args(SMALL).args(["--set", &format!("transport_rays={rays}")]);
    command.arg("--out").arg(folder.join(name)).args(["--threads", "1", "--json"]);
    Running::start(command)
}

/// Waits until its tasks of transport run.
fn wait_for_transport(bake: &Running) {
    bake.stderr_line(|line| line.contains("transport").then_some(()));
}

/// The object that it prints at its end, which must be a good one.
fn json(bake: Running) -> Value {
    let ended = bake.finish();
    assert_eq!(ended.exit, Some(0), "{:#?}", ended.stderr);
    serde_json::from_str(&ended.stdout.concat()).unwrap()
}

/// A server over the bakes' own folder.
fn serve(state: &Path) -> Server {
    Server::start_with(kiln(state), &["--state", state.to_str().unwrap()])
}

/// The workers that handed in each task of a bake.
fn workers_by_task(server: &Server, state: &Path, bake: &Value) -> BTreeMap<String, BTreeSet<String>> {
    let id = bake["bake"].as_str().unwrap();
    let logs = run(kiln(state), &["logs", id, "--json", "--server", &server.url], 0).stdout();
    let mut workers: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for line in logs.lines() {
        let event: Value = serde_json::from_str(line).unwrap();
        let event = &event["event"];
        if event["type"] == "task_done" {
            let text = |name: &str| event[name].as_str().unwrap().to_owned();
            workers.entry(text("key")).or_default().insert(text("worker"));
        }
    }
    workers
}

#[test]
fn second_bake_shares_the_tasks_of_one_that_runs_and_none_is_done_twice() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = start(folder.path(), "first", 1024);
    wait_for_transport(&first);
    let second = start(folder.path(), "second", 1024);
    second.stderr_line(|line| line.contains("tasks").then_some(()));
    assert!(first.has_ended().is_none(), "both run at once");
    let (first, second) = (json(first), json(second));
    assert!(second["tasks_reused"].as_u64().unwrap() >= 5, "the plan was done before: {second}");
    assert_eq!(bundle(&folder.path().join("first")), bundle(&folder.path().join("second")));

    let state = folder.path().join("state");
    let server = serve(&state);
    let mut all = workers_by_task(&server, &state, &first);
    for (key, workers) in workers_by_task(&server, &state, &second) {
        all.entry(key).or_default().extend(workers);
    }
    assert!(all.values().all(|workers| workers.len() == 1), "a task is done by one: {all:#?}");
    let workers: BTreeSet<&String> = all.values().flatten().collect();
    assert_eq!(workers.into_iter().collect::<Vec<_>>(), ["bake-0", "bake-1"], "each did some");
}

#[test]
fn bake_of_a_killed_process_is_cancelled_and_one_that_runs_beside_it_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let killed = start(folder.path(), "killed", 2048);
    wait_for_transport(&killed);
    let living = start(folder.path(), "living", 768);
    wait_for_transport(&living);
    killed.signal("KILL");
    assert_eq!(killed.wait(), None);
    let third = json(start(folder.path(), "third", 32));
    let living = json(living);
    let state = folder.path().join("state");
    let server = serve(&state);
    let listed = run(kiln(&state), &["list", "--json", "--server", &server.url], 0).json();
    let state_of = |id: &Value| {
        let bakes = listed["bakes"].as_array().unwrap();
        bakes.iter().find(|bake| bake["id"] == *id).unwrap()["state"].as_str().unwrap().to_owned()
    };
    assert_eq!((state_of(&third["bake"]), state_of(&living["bake"])), ("done".into(), "done".into()));
    let states = listed["bakes"].as_array().unwrap().iter().map(|bake| bake["state"].as_str().unwrap());
    assert_eq!(states.filter(|state| *state == "cancelled").count(), 1, "{listed}");
}

#[test]
fn bake_waits_with_a_word_where_the_folder_cannot_be_shared_and_goes_on_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    std::fs::create_dir(&state).unwrap();
    // As a program from before seats holds it.
    let lock = File::create(state.join("lock")).unwrap();
    lock.lock().unwrap();
    let waits =
        |bake: &Running| bake.stderr_line(|line| line.starts_with("waiting:").then(|| line.to_owned()));
    let interrupted = start(folder.path(), "interrupted", 32);
    let word = waits(&interrupted);
    assert!(word.contains("another kiln") && word.contains("--state"), "{word}");
    interrupted.signal("INT");
    assert_eq!(interrupted.wait(), Some(130));
    let patient = start(folder.path(), "patient", 32);
    waits(&patient);
    drop(lock);
    json(patient);
}

#[test]
fn state_of_a_server_is_refused_with_the_way_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("state");
    let server = serve(&state);
    let ended = start(folder.path(), "out", 32).finish();
    let words = ended.stderr.join("\n");
    assert_eq!(ended.exit, Some(2), "{words}");
    assert!(words.contains(&format!("process {}", server.id())) && words.contains("--server URL"), "{words}");
}
