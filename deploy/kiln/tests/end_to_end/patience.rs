//! Commands that outlast a server's restart, and say so.

use std::path::Path;

use super::farm::arguments;
use super::parts::keeper::free_port;
use super::processes::{Running, kiln, run};

/// `kiln server` on a port, once it listens.
fn serve(state: &Path, port: u16) -> Running {
    let mut command = kiln(state);
    command.args(["server", "--listen", &format!("127.0.0.1:{port}")]);
    let server = Running::start(command);
    server.stdout_line(|line| line.starts_with("listening on ").then_some(()));
    server
}

#[test]
fn commands_wait_for_a_server_that_is_killed_and_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let (state, port) = (folder.path().join("server"), free_port());
    let url = format!("http://127.0.0.1:{port}");
    // Before its first start: a farm's scripts need not wait for each other.
    let mut submit = kiln(folder.path());
    submit.args(arguments("submit", &["--server", &url, "--wait"]));
    let submit = Running::start(submit);
    let waits =
        |line: &str| (line.contains("waiting for http://") && line.contains("--patience")).then_some(());
    submit.stderr_line(waits);
    let server = serve(&state, port);
    let bake = submit.stdout_line(|line| Some(line.to_owned()));
    let mut watch = kiln(folder.path());
    watch.args(["watch", &bake, "--server", &url]);
    let watch = Running::start(watch);
    server.signal("KILL");
    server.wait();
    watch.stderr_line(waits);
    let _server = serve(&state, port);
    watch.stderr_line(|line| line.contains("answers again").then_some(()));
    let mut worker = kiln(&folder.path().join("worker"));
    worker.args(["worker", "--server", &url, "--threads", "2", "--lease-secs", "5"]);
    let _worker = Running::start(worker);
    assert_eq!((submit.wait(), watch.wait()), (Some(0), Some(0)));
}

#[test]
fn patience_ends_when_the_flag_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let url = format!("http://127.0.0.1:{}", free_port());
    for command in ["watch", "fetch"] {
        let out = folder.path().join("out").display().to_string();
        let mut arguments = vec![command, "0123456789", "--server", &url, "--patience", "3s"];
        arguments.extend(if command == "fetch" { vec!["--out", &out] } else { vec![] });
        let told = run(kiln(folder.path()), &arguments, 3).stderr();
        assert!(told.contains("waiting for") && told.contains("try: "), "{told}");
    }
    let told = run(kiln(folder.path()), &["watch", "0123", "--server", &url, "--patience", "0"], 3).stderr();
    assert!(!told.contains("waiting for"), "{told}");
    let told =
        run(kiln(folder.path()), &["watch", "0123", "--server", &url, "--patience", "soon"], 2).stderr();
    assert!(told.contains("10m"), "{told}");
}
