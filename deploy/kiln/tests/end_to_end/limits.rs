//! Limits of a bake, from the command line to the workers.

use std::collections::BTreeMap;

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::{BakeState, EventKind};
use lightkiln_proto::ids::Digest;

use super::chaos::all_events;
use super::farm::arguments;
use super::processes::{Server, kiln, run};

/// Most workers that held tasks of a bake at a time, as its events tell.
fn most_holders(client: &ApiClient, bake: &str) -> usize {
    let (mut held, mut most): (BTreeMap<Digest, String>, usize) = (BTreeMap::new(), 0);
    for event in all_events(client, bake) {
        match event.event {
            EventKind::TaskStarted { key, worker, .. } => drop(held.insert(key, worker)),
            EventKind::TaskDone { key, .. }
            | EventKind::TaskFailed { key, .. }
            | EventKind::LeaseExpired { key, .. }
            | EventKind::TaskReleased { key, .. } => drop(held.remove(&key)),
            _ => (),
        }
        let mut workers: Vec<&String> = held.values().collect();
        workers.sort();
        workers.dedup();
        most = most.max(workers.len());
    }
    assert!(most > 0, "somebody did the bake");
    most
}

#[test]
fn bake_has_no_more_workers_at_a_time_than_its_submission_says() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let client = ApiClient::new(&server.url, None).unwrap();
    let submit = ["--server", &server.url, "--max-workers", "2"];
    let submitted = run(kiln(folder.path()), &arguments("submit", &submit), 0);
    let bake = submitted.stdout().trim().to_owned();
    let _workers = ["a", "b", "c", "d"].map(|name| server.worker(folder.path(), name, 1));
    run(kiln(folder.path()), &["watch", &bake, "--server", &server.url], 0);
    let shown = client.bake(&bake).unwrap();
    assert_eq!((shown.state, shown.limits.max_workers), (BakeState::Done, Some(2)));
    assert!(most_holders(&client, &bake) <= 2);
    // Other settings: nothing of the first one is used again beyond the scene.
    let out = folder.path().join("out").display().to_string();
    let more = ["--server", &server.url, "--max-workers", "1", "--set", "rank_max=9", "--out", &out];
    run(kiln(folder.path()), &arguments("bake", &more), 0);
    let bakes = client.bakes(&Default::default(), None, 10).unwrap().bakes;
    let other = bakes.iter().find(|other| other.id != bake).unwrap();
    assert_eq!((other.state, other.limits.max_workers), (BakeState::Done, Some(1)));
    assert_eq!(most_holders(&client, &other.id), 1);
}
