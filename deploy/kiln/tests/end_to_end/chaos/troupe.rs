//! The processes of a farm, each behind a door, each started again when it was killed.

use std::path::Path;

use super::super::parts::s3;
use super::super::processes::{Running, kiln};
use super::database::Database;
use super::proxy::Proxy;
use super::{LEASE_SECS, Patience};

/// Lines of each process that are shown when the test fails.
const LINES_SHOWN: usize = 25;

/// A process that should be under way.
pub struct Member {
    pub name: String,
    running: Option<Running>,
    /// Port that it listens on, if it is a server.
    port: u16,
    /// Lines that it wrote in its earlier lives.
    said: Vec<String>,
}

/// All parts of the farm.
pub struct Troupe {
    pub database: Database,
    /// Between workers and people on one side, servers on the other: a load balancer.
    pub front_door: Proxy,
    pub database_door: Proxy,
    pub bytes_door: Proxy,
    pub servers: Vec<Member>,
    pub workers: Vec<Member>,
    folder: tempfile::TempDir,
    prefix: String,
}

impl Troupe {
    /// Starts everything; `prefix` is where the farm's chunks are in the bucket.
    pub fn start(servers: usize, workers: usize, prefix: &str) -> Self {
        let database = Database::start();
        let doors = [Proxy::to(&[]), Proxy::to(&[database.port()]), Proxy::to(&[s3::server().port()])];
        let [front_door, database_door, bytes_door] = doors;
        let member = |name: String| Member { name, running: None, port: 0, said: Vec::new() };
        let named = |what: &str, count| (0..count).map(|n| member(format!("{what}-{n}"))).collect::<Vec<_>>();
        let (servers, workers) = (named("server", servers), named("worker", workers));
        let folder = tempfile::tempdir().unwrap();
        let prefix = prefix.to_owned();
        let mut troupe =
            Self { database, front_door, database_door, bytes_door, servers, workers, folder, prefix };
        (0..troupe.servers.len()).for_each(|index| troupe.start_server(index));
        (0..troupe.workers.len()).for_each(|index| troupe.start_worker(index));
        troupe
    }

    /// Where people find the farm.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.front_door.port)
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn doors(&self) -> [&Proxy; 3] {
        [&self.front_door, &self.database_door, &self.bytes_door]
    }

    /// Arguments and variables by which a program finds database and bytes; around the doors if it is not to suffer.
    pub fn settings(&self, is_behind_doors: bool) -> Vec<(String, String)> {
        let (database, bytes) = if is_behind_doors {
            (self.database_door.port, self.bytes_door.port)
        } else {
            (self.database.port(), s3::server().port())
        };
        let mut settings = s3::S3::settings_at(bytes);
        settings.push(("KILN_DATABASE".to_owned(), self.database.url_at(database)));
        settings.push(("KILN_CHUNKS".to_owned(), format!("s3://{}/{}", s3::BUCKET, self.prefix)));
        settings
    }

    /// Starts a server until it serves: when its database is away, it ends, and whoever keeps it starts it again.
    fn start_server(&mut self, index: usize) {
        let patience = Patience::new();
        loop {
            let name = self.servers[index].name.clone();
            let mut command = kiln(&self.folder.path().join(&name));
            command.args(["server", "--listen", "127.0.0.1:0"]).envs(self.settings(true));
            let running = Running::start(command);
            let port = running.stdout_line_if_any(|line| line.rsplit_once(':')?.1.parse().ok());
            let member = &mut self.servers[index];
            if let Some(port) = port {
                (member.running, member.port) = (Some(running), port);
                self.front_door.add_target(port);
                return;
            }
            member.said.extend(running.finish().stderr);
            patience.again(&format!("serving {name}, which said {:?}", member.said.last()));
        }
    }

    fn start_worker(&mut self, index: usize) {
        let member = &mut self.workers[index];
        let mut command = kiln(&self.folder.path().join(&member.name));
        let url = format!("http://127.0.0.1:{}", self.front_door.port);
        let lease_secs = LEASE_SECS.to_string();
        command.args(["worker", "--server", &url, "--name", &member.name, "--threads", "1"]);
        command.args(["--lease-secs", &lease_secs]);
        member.running = Some(Running::start(command));
    }

    /// Kills a server, whatever it is at, and starts another one.
    pub fn replace_server(&mut self, index: usize) {
        self.front_door.remove_target(self.servers[index].port);
        self.servers[index].kill();
        self.start_server(index);
    }

    /// Kills a worker, whatever it is at, and starts it again.
    pub fn replace_worker(&mut self, index: usize) {
        self.workers[index].kill();
        self.start_worker(index);
    }

    /// Nobody ends by himself, whatever happens around him.
    pub fn assert_alive(&mut self) {
        for member in self.servers.iter_mut().chain(&mut self.workers) {
            let ended = member.running.as_mut().and_then(Running::has_ended);
            assert!(ended.is_none(), "{} ended by itself: {ended:?}", member.name);
        }
    }

    /// Stops everything as its owner would.
    pub fn stop(&mut self) {
        for member in self.workers.iter_mut().chain(&mut self.servers) {
            let running = member.running.take().expect("it is under way");
            running.signal("TERM");
            let finished = running.finish();
            member.said.extend(finished.stderr);
            assert_eq!(finished.exit, Some(0), "{} did not stop well", member.name);
        }
    }

    /// The last words of each process.
    pub fn show(&mut self) {
        for member in self.servers.iter_mut().chain(&mut self.workers) {
            member.said.extend(member.running.iter().flat_map(Running::stderr_so_far));
            let start = member.said.len().saturating_sub(LINES_SHOWN);
            eprintln!("-- {}:\n{}", member.name, member.said[start..].join("\n"));
        }
    }
}

impl Member {
    /// Sends a signal by name.
    pub fn signal(&self, name: &str) {
        self.running.as_ref().expect("it is under way").signal(name);
    }

    fn kill(&mut self) {
        let running = self.running.take().expect("it is under way");
        running.signal("KILL");
        let finished = running.finish();
        assert_eq!(finished.exit, None, "{} had ended before it was killed", self.name);
        self.said.extend(finished.stderr);
    }
}
