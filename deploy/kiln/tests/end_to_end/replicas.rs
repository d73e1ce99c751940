//! Two servers that keep nothing themselves, on one PostgreSQL database and one S3 bucket.

use std::path::Path;

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::EventKind;

use super::bundle;
use super::farm::{arguments, embedded_bundle, wait_for_stage};
use super::parts::{postgres, s3};
use super::processes::{Server, kiln, run};

fn server(folder: &Path, database: &str) -> Server {
    let mut command = kiln(folder);
    command.envs(s3::server().settings()).env("KILN_DATABASE", database);
    Server::start_with(command, &["--chunks", &format!("s3://{}/chunks", s3::BUCKET)])
}

#[test]
fn server_killed_in_the_middle_is_replaced_by_another_and_the_chunks_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    let database = postgres::server().url(None);
    let servers = folder.path().join("servers");
    let [a, b] = [server(&servers, &database), server(&servers, &database)];
    let client = ApiClient::new(&b.url, None).unwrap();
    let submitted = run(kiln(folder.path()), &arguments("submit", &["--server", &a.url]), 0);
    let bake = submitted.stdout().trim().to_owned();
    let _workers = [a.worker(folder.path(), "at a", 1), b.worker(folder.path(), "at b", 1)];
    wait_for_stage(&client, &bake, "prt.transport");
    a.signal("KILL");
    let state = client.bake(&bake).unwrap().state;
    assert!(!state.is_final(), "it was killed too late: {state:?}");
    run(kiln(folder.path()), &["watch", &bake, "--server", &b.url], 0);
    let out = folder.path().join("out").display().to_string();
    run(kiln(folder.path()), &["fetch", &bake, "--server", &b.url, "--out", &out], 0);
    assert_eq!(bundle(Path::new(&out)), expected);
    let page = client.events(&bake, 0, 0).unwrap();
    let mut done = Vec::new();
    for (index, event) in page.events.into_iter().enumerate() {
        assert_eq!(event.seq, index as u64 + 1, "sequence without gaps");
        if let EventKind::TaskDone { key, .. } = event.event {
            assert!(!done.contains(&key), "{key} was committed twice");
            done.push(key);
        }
    }
    assert_eq!(done.len() as u64, page.bake.tasks_run);
    assert!(
        !servers.join("farm.sqlite").exists() && !servers.join("server").exists(),
        "servers keep nothing"
    );
}

#[test]
fn wrong_places_are_refused_with_the_next_step() {
    let folder = tempfile::tempdir().unwrap();
    for (flag, value, told) in [
        ("--database", "mysql://u:secret@host/farm", "postgres://"),
        ("--chunks", "gs://bucket", "s3://BUCKET"),
    ] {
        let arguments = ["server", "--listen", "127.0.0.1:0", flag, value];
        let finished = run(kiln(folder.path()), &arguments, 2);
        assert!(finished.stderr().contains(told), "{}", finished.stderr());
    }
}
