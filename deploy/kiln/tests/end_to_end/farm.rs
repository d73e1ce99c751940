//! A server and workers as processes of their own.

use std::path::Path;

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::EventKind;

use super::processes::{LIMIT, Server, kiln, run};
use super::upkeep::chunk_files;
use super::{SMALL, bundle, cornell};

pub fn arguments(command: &str, more: &[&str]) -> Vec<String> {
    let mut arguments = vec![command.to_owned(), cornell().display().to_string()];
    arguments.extend(SMALL.map(str::to_owned));
    arguments.extend(more.iter().map(|argument| (*argument).to_owned()));
    arguments
}

pub fn embedded_bundle(folder: &Path) -> std::collections::BTreeMap<String, String> {
    let out = folder.join("embedded");
    run(kiln(&folder.join("state")), &arguments("bake", &["--out", &out.display().to_string()]), 0);
    bundle(&out)
}

#[test]
fn farm_gives_the_embedded_bakes_chunks_with_one_two_and_four_threads() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    for threads in [1, 2, 4] {
        let place = folder.path().join(threads.to_string());
        let server = Server::start(&place.join("server"));
        let _workers = ["a", "b"].map(|name| server.worker(&place, name, threads));
        let out = place.join("out").display().to_string();
        run(kiln(&place), &arguments("bake", &["--server", &server.url, "--out", &out]), 0);
        assert_eq!(bundle(Path::new(&out)), expected, "with {threads} threads");
    }
}

/// The bundle of a bake of the farm once it has ended.
fn fetched(folder: &Path, server: &Server, bake: &str) -> std::collections::BTreeMap<String, String> {
    run(kiln(folder), &["watch", bake, "--server", &server.url], 0);
    let out = folder.join("out").display().to_string();
    run(kiln(folder), &["fetch", bake, "--server", &server.url, "--out", &out], 0);
    bundle(Path::new(&out))
}

/// Waits until a task of `kind` is held by a worker or done.
pub fn wait_for_stage(client: &ApiClient, bake: &str, kind: &str) {
    let deadline = std::time::Instant::now() + LIMIT;
    let mut seen = 0;
    loop {
        let page = client.events(bake, seen, 1).unwrap();
        seen = page.events.last().map_or(seen, |event| event.seq);
        let under_way = |stage: &lightkiln_proto::api::StageCount| stage.leased + stage.done > 0;
        if page.bake.stages.iter().any(|stage| stage.kind == kind && under_way(stage)) {
            return;
        }
        assert!(
            std::time::Instant::now() < deadline,
            "no {kind} task within {LIMIT:?}: {:?}",
            page.bake.stages
        );
    }
}

#[test]
fn worker_killed_in_the_middle_is_replaced_and_the_chunks_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    let server = Server::start(&folder.path().join("server"));
    let client = ApiClient::new(&server.url, None).unwrap();
    let submitted = run(kiln(folder.path()), &arguments("submit", &["--server", &server.url]), 0);
    let bake = submitted.stdout().trim().to_owned();
    let first = server.worker(folder.path(), "first", 2);
    wait_for_stage(&client, &bake, "prt.transport");
    first.signal("KILL");
    assert_eq!(first.wait(), None);
    let stages = client.bake(&bake).unwrap().stages;
    assert!(stages.iter().any(|stage| stage.done < stage.total), "it was killed too late: {stages:?}");
    let _second = server.worker(folder.path(), "second", 2);
    assert_eq!(fetched(folder.path(), &server, &bake), expected);
}

#[test]
fn terminated_worker_gives_its_task_back_and_exits_cleanly() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let client = ApiClient::new(&server.url, None).unwrap();
    let submitted = run(kiln(folder.path()), &arguments("submit", &["--server", &server.url]), 0);
    let bake = submitted.stdout().trim().to_owned();
    let worker = server.worker(folder.path(), "leaving", 1);
    wait_for_stage(&client, &bake, "scene.place");
    worker.signal("TERM");
    assert_eq!(worker.wait(), Some(0));
    let page = client.events(&bake, 0, 0).unwrap();
    assert!(page.bake.stages.iter().all(|stage| stage.leased == 0), "{:?}", page.bake.stages);
    let blamed =
        |kind: &EventKind| matches!(kind, EventKind::LeaseExpired { .. } | EventKind::TaskFailed { .. });
    assert!(!page.events.iter().any(|event| blamed(&event.event)), "{:?}", page.events);
}

/// All that the farm has made is gone from its disk, while half of the tasks that read it have not begun. Missing bytes
/// are met one by one.
#[test]
fn bytes_lost_under_a_live_bake_are_made_again_while_their_readers_wait() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    let state = folder.path().join("server");
    let server = Server::start(&state);
    let client = ApiClient::new(&server.url, None).unwrap();
    let submitted = run(kiln(folder.path()), &arguments("submit", &["--server", &server.url]), 0);
    let bake = submitted.stdout().trim().to_owned();
    let first = server.worker(folder.path(), "first", 2);
    wait_for_stage(&client, &bake, "prt.transport");
    first.signal("TERM");
    assert_eq!(first.wait(), Some(0));
    let shown = client.bake(&bake).unwrap();
    assert!(!shown.state.is_final(), "it was stopped too late: {:?}", shown.stages);
    let scene = shown.scene.to_string();
    let mut removed = 0;
    for file in chunk_files(&state.join("server")) {
        if !file.file_name().unwrap().to_string_lossy().starts_with(&scene[2..]) {
            std::fs::remove_file(file).unwrap();
            removed += 1;
        }
    }
    assert!(removed > 3, "{removed} chunks");
    let _second = server.worker(folder.path(), "second", 2);
    assert_eq!(fetched(folder.path(), &server, &bake), expected);
    let (mut lost, mut seen) = (0, 0);
    loop {
        let page = client.events(&bake, seen, 0).unwrap();
        let Some(last) = page.events.last() else { break };
        seen = last.seq;
        for event in page.events {
            match event.event {
                EventKind::ResultLost { .. } => lost += 1,
                EventKind::TaskStarted { label, attempt, .. } => assert_eq!(attempt, 1, "{label}"),
                _ => (),
            }
        }
    }
    assert!(lost > 2, "{lost} results were lost");
}
