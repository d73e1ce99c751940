//! Workers that are lost, and tasks that take more memory than there is.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::{Bake, BakeState, Blame, EventKind};

use super::chaos::all_events;
use super::farm::{arguments, embedded_bundle};
use super::processes::{LIMIT, Running, Server, kiln, run};
use super::{bundle, cornell};

/// Losses of a bake, more than workers may fail at one of its tasks. `KILN_LOSSES` says another number: waits grow with each.
const LOSSES: u64 = 5;
/// Starts of a worker for each: it may be killed between two tasks.
const STARTS_OF_A_LOSS: u64 = 12;

fn losses() -> u64 {
    std::env::var("KILN_LOSSES").map_or(LOSSES, |told| told.parse().expect("KILN_LOSSES is a number"))
}

fn submit(folder: &Path, server: &Server) -> String {
    run(kiln(folder), &arguments("submit", &["--server", &server.url]), 0).stdout().trim().to_owned()
}

/// A worker with the name that it gives itself, and leases that outlast the test.
fn worker(folder: &Path, server: &Server, more: &[&str]) -> Running {
    let mut command = kiln(&folder.join("oven"));
    command.args(["worker", "--server", &server.url, "--threads", "1", "--lease-secs", "3600"]).args(more);
    Running::start(command)
}

/// Whether the worker that goes on has noted all of the bake's tasks in hand, of which there are some: one that is killed before, with the
/// answer to its claim on the way, leaves nothing that its next start could tell of, and the lease is left to its end.
fn has_noted(folder: &Path, client: &ApiClient, bake: &str) -> bool {
    let mut in_hand = BTreeMap::new();
    for event in all_events(client, bake) {
        match event.event {
            EventKind::TaskStarted { key, label, .. } => drop(in_hand.insert(key, label)),
            EventKind::TaskDone { key, .. }
            | EventKind::TaskFailed { key, .. }
            | EventKind::LeaseExpired { key, .. }
            | EventKind::TaskReleased { key, .. } => drop(in_hand.remove(&key)),
            _ => {}
        }
    }
    let notes = std::fs::read(folder.join("oven/worker-seats/0.held")).unwrap_or_default();
    let notes: serde_json::Value = serde_json::from_slice(&notes).unwrap_or_default();
    let noted: Vec<&str> = notes["leases"]
        .as_object()
        .into_iter()
        .flat_map(|leases| leases.values())
        .filter(|held| held["end"].is_null())
        .filter_map(|held| held["label"].as_str())
        .collect();
    !in_hand.is_empty() && in_hand.values().all(|label| noted.contains(&label.as_str()))
}

/// Leases that workers told of after their end: a loss each, but those that were not begun.
fn told(client: &ApiClient, bake: &str) -> usize {
    let is_told = |event: &EventKind| matches!(event, EventKind::TaskFailed { blame: Blame::Lost, .. });
    all_events(client, bake).iter().filter(|event| is_told(&event.event)).count()
}

/// Waits until the bake is as `done` says.
fn wait_for(client: &ApiClient, bake: &str, mut done: impl FnMut(&Bake) -> bool) -> Bake {
    let deadline = Instant::now() + LIMIT;
    loop {
        let shown = client.bake(bake).unwrap();
        if done(&shown) {
            return shown;
        }
        assert!(Instant::now() < deadline, "it did not come to that within {LIMIT:?}: {shown:?}");
        std::thread::park_timeout(Duration::from_millis(10));
    }
}

#[test]
fn worker_that_is_killed_again_and_again_fails_no_bake_and_its_next_start_gives_its_task_on() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    let server = Server::start(&folder.path().join("server"));
    let client = ApiClient::new(&server.url, None).unwrap();
    let bake = submit(folder.path(), &server);
    let (losses, mut starts) = (losses(), 0);
    while client.bake(&bake).unwrap().attempts_lost < losses {
        starts += 1;
        assert!(starts <= losses * STARTS_OF_A_LOSS, "{:?}", client.bake(&bake).unwrap());
        let is_held = |bake: &Bake| bake.stages.iter().any(|stage| stage.leased > 0);
        let before = client.bake(&bake).unwrap();
        let (lost_before, told_before) = (before.attempts_lost, told(&client, &bake));
        let killed = worker(folder.path(), &server, &[]);
        // The lease that the one before left is told of first, and is none of this one's.
        let left = is_held(&before);
        // It shall take no other task between the look at it and its end, and do next to nothing between two looks.
        let shown = wait_for(&client, &bake, |bake| {
            killed.signal("STOP");
            let is_told = !left || told(&client, &bake.id) > told_before;
            let is_caught = is_told && has_noted(folder.path(), &client, &bake.id);
            if !is_caught {
                killed.signal("CONT");
            }
            is_caught || bake.state.is_final()
        });
        assert!(
            !shown.state.is_final(),
            "the bake ended before enough workers were lost, after {starts}: {shown:?}"
        );
        assert!(shown.attempts_lost <= lost_before + 1);
        killed.signal("KILL");
        assert_eq!(killed.wait(), None);
    }
    let _last = worker(folder.path(), &server, &[]);
    let done = wait_for(&client, &bake, |bake| bake.state.is_final());
    assert_eq!((done.state, done.attempts_failed, done.alarms), (BakeState::Done, 0, 0), "{done:?}");
    let names: Vec<String> =
        client.workers().unwrap().workers.into_iter().map(|worker| worker.name).collect();
    assert_eq!(names.len(), 1, "each start has the name of the one before: {names:?}");
    let told = run(kiln(folder.path()), &["show", &bake, "--server", &server.url], 0).stdout();
    assert!(told.contains(&format!("0 failed, {} lost with their workers", done.attempts_lost)), "{told}");
    let out = folder.path().join("out").display().to_string();
    run(kiln(folder.path()), &["fetch", &bake, "--server", &server.url, "--out", &out], 0);
    assert_eq!(bundle(Path::new(&out)), expected);
}

/// Memory that a process has of its own, in MiB.
fn memory_mib(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? >> 10)
}

#[test]
fn task_that_always_exhausts_memory_ends_its_bake_with_that_word() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let client = ApiClient::new(&server.url, None).unwrap();
    let idle = worker(folder.path(), &server, &[]);
    idle.stderr_line(|line| line.contains("takes tasks from").then_some(()));
    let deadline = Instant::now() + LIMIT;
    while client.workers().unwrap().workers.is_empty() {
        assert!(Instant::now() < deadline, "no worker came");
        std::thread::park_timeout(Duration::from_millis(10));
    }
    let taken = memory_mib(idle.id()).expect("the system tells what a process has");
    idle.signal("TERM");
    assert_eq!(idle.wait(), Some(0));
    let limit = (taken + 4).to_string();
    // Its tasks are long enough for a look at the memory, and take more of it than that.
    let scene = cornell().display().to_string();
    let submitted =
        run(kiln(folder.path()), &["submit", &scene, "--preset", "medium", "--server", &server.url], 0);
    let bake = submitted.stdout().trim().to_owned();
    // Whoever runs workers starts one again that has ended.
    let mut process = worker(folder.path(), &server, &["--memory-limit-mib", &limit]);
    let ended = wait_for(&client, &bake, |bake| {
        if process.has_ended().is_some() {
            process = worker(folder.path(), &server, &["--memory-limit-mib", &limit]);
        }
        bake.state.is_final()
    });
    let failure = ended.failure.clone().unwrap_or_default();
    assert_eq!(ended.state, BakeState::Failed, "{ended:?}");
    assert!(failure.contains("failed on 1 worker") && failure.contains("out of memory"), "{failure}");
    assert!(failure.contains(&format!("of {limit} MiB of this worker")), "{failure}");
    assert!(ended.attempts_failed > 0 && ended.attempts_lost == 0, "{ended:?}");
    let events = client.events(&bake, 0, 0).unwrap().events;
    assert!(!events.iter().any(|event| matches!(event.event, EventKind::LeaseExpired { .. })), "{events:?}");
}
