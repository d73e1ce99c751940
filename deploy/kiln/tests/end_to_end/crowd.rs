//! Thousands of connections that say nothing, at a server whose process may open few files.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use super::processes::{LIMIT, Server, kiln, run};

/// Files that the server may open, and connections at its door.
const FILES: u32 = 256;
const CROWD: usize = 600;

/// `kiln` that may open few files.
fn kiln_with_few_files(state: &Path) -> Command {
    let program = kiln(state);
    let mut command = Command::new("sh");
    command.args(["-c", &format!("ulimit -n {FILES} && exec \"$0\" \"$@\"")]).arg(program.get_program());
    for (name, value) in program.get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    command
}

/// Status line of the answer to a GET, which must come within a while.
pub fn get(server: &str, path: &str) -> String {
    let address = server.strip_prefix("http://").unwrap();
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: farm\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap_or_else(|error| panic!("{path}: {error}"));
    answer
}

/// Processes that stand still until this is dropped.
struct Stopped(Vec<String>);

impl Stopped {
    /// PostgreSQL on a port: its first process, and those that this one started.
    fn postgres(port: u16) -> Self {
        let mut processes = Vec::new();
        for entry in std::fs::read_dir("/proc").unwrap().map(|entry| entry.unwrap()) {
            let id = entry.file_name().into_string().unwrap();
            let read = |name: &str| std::fs::read_to_string(entry.path().join(name)).unwrap_or_default();
            let stat = read("stat");
            // The name in brackets may hold anything; behind it come the state and the parent.
            let parent =
                stat.rsplit_once(')').and_then(|(_, rest)| rest.split_whitespace().nth(1).map(str::to_owned));
            processes.push((id, parent, read("cmdline").replace('\0', " ")));
        }
        let is_first = |words: &str| words.contains("/postgres ") && words.contains(&format!(" -p {port} "));
        let first = processes.iter().find(|(_, _, words)| is_first(words)).expect("PostgreSQL runs");
        let mut ids = vec![first.0.clone()];
        ids.extend(
            processes
                .iter()
                .filter(|(_, parent, _)| parent.as_ref() == Some(&first.0))
                .map(|(id, ..)| id.clone()),
        );
        let stopped = Self(ids);
        stopped.signal("STOP");
        stopped
    }

    fn signal(&self, name: &str) {
        let _ = Command::new("kill").args(["-s", name]).args(&self.0).status();
    }
}

impl Drop for Stopped {
    fn drop(&mut self) {
        self.signal("CONT");
    }
}

#[test]
fn crowd_of_half_open_connections_does_not_stop_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start_with(kiln_with_few_files(&folder.path().join("server")), &[]);
    let address = server.url.strip_prefix("http://").unwrap();
    let mut crowd = Vec::new();
    for index in 0..CROWD {
        let mut stream = TcpStream::connect(address).unwrap();
        if index % 2 == 0 {
            // The server may have sent it away by now.
            let _ = stream.write_all(b"POST /v1/bakes HTTP/1.1\r\nHost: f");
        }
        crowd.push(stream);
    }
    for path in ["/healthz", "/readyz", "/v1/bakes"] {
        let answer = get(&server.url, path);
        assert!(answer.starts_with("HTTP/1.1 200"), "{path}: {answer}");
    }
    run(kiln(folder.path()), &["list", "--server", &server.url], 0);
    assert_eq!(server.stop(), Some(0), "it ends in peace, crowd or not");
}

#[test]
fn server_starts_before_its_database_and_works_once_that_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let port = super::parts::keeper::free_port();
    let away = format!("postgres://kiln:secret@127.0.0.1:{port}/farm");
    let mut command = kiln(folder.path());
    command.args(["server", "--listen", "127.0.0.1:0", "--database", &away]);
    let server = super::processes::Running::start(command);
    let url = server.stdout_line(|line| line.strip_prefix("listening on ").map(str::to_owned));
    assert!(get(&url, "/healthz").starts_with("HTTP/1.1 200"), "it is alive");
    for path in ["/readyz", "/v1/bakes"] {
        let answer = get(&url, path);
        assert!(answer.starts_with("HTTP/1.1 503") && answer.contains("waits for its database"), "{answer}");
    }
    let told = server.stderr_line(|line| line.contains("waits for its database").then(|| line.to_owned()));
    assert!(!told.contains("secret"), "{told}");
    server.signal("TERM");
    assert_eq!(server.wait(), Some(0), "it may be stopped meanwhile");
}

#[test]
fn server_does_not_wait_for_a_database_that_will_not_come_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let database = super::parts::postgres::Postgres::start();
    let nowhere = database.url(None).replace("/postgres", "/nowhere");
    let told =
        run(kiln(folder.path()), &["server", "--listen", "127.0.0.1:0", "--database", &nowhere], 1).stderr();
    assert!(told.contains("nowhere") && told.contains("try: --database"), "{told}");
}

#[test]
fn readiness_is_told_within_seconds_while_the_database_is_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let database = super::parts::postgres::Postgres::start();
    let mut command = kiln(folder.path());
    command.env("KILN_DATABASE", database.url(None));
    let server = Server::start_with(command, &[]);
    wait_until_ready(&server);
    let stopped = Stopped::postgres(database.port());
    let began = Instant::now();
    let answer = get(&server.url, "/readyz");
    assert!(answer.starts_with("HTTP/1.1 503"), "{answer}");
    // A second and what a busy machine adds; it took 45.
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
    assert!(get(&server.url, "/healthz").starts_with("HTTP/1.1 200"));
    drop(stopped);
    wait_until_ready(&server);
}

/// Waits for a server whose database answers: on a busy machine not always within the second that readiness takes for an answer.
fn wait_until_ready(server: &Server) {
    let deadline = Instant::now() + LIMIT;
    while !get(&server.url, "/readyz").starts_with("HTTP/1.1 200") {
        assert!(Instant::now() < deadline, "it is not ready while its database goes on");
        std::thread::park_timeout(Duration::from_millis(100));
    }
}
