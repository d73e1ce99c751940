//! The processes of a farm, each behind a door, each started again when it was killed.

use std::path::Path;
use std::process::Command;

use super::super::parts::s3;
use super::super::processes::{Running, kiln};
use super::LEASE_SECS;
use super::clocks::{self, Clock};
use super::database::Database;
use super::proxy::Proxy;

/// Lines of each process that are shown when the test fails.
const LINES_SHOWN: usize = 25;

/// A process that should be under way.
pub struct Member {
    pub name: String,
    running: Option<Running>,
    clock: Clock,
    /// Port that it listens on, if it is a server.
    port: u16,
    /// Lines that it wrote in its earlier lives.
    said: Vec<String>,
}

/// All parts of the farm.
pub struct Troupe {
    pub database: Database,
    /// Between workers and people on one side, servers on the other: a load balancer.
    front_door: Proxy,
    /// Before the database's server and the store of bytes, where the farm has them.
    inner_doors: Option<[Proxy; 2]>,
    pub servers: Vec<Member>,
    pub workers: Vec<Member>,
    folder: tempfile::TempDir,
    /// Place of the farm's chunks in the bucket.
    prefix: String,
}

impl Troupe {
    /// Starts a farm of two servers on PostgreSQL and S3, whose chunks are at `prefix`.
    pub fn on_postgres(workers: usize, prefix: &str) -> Self {
        let database = Database::postgres();
        let (port, _) = database.server().expect("PostgreSQL is one");
        let doors = [Proxy::to(&[port]), Proxy::to(&[s3::server().port()])];
        Self::start(tempfile::tempdir().unwrap(), database, Some(doors), [2, workers], prefix)
    }

    /// Starts a farm of one server, which keeps all in its folder.
    pub fn on_sqlite(workers: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let database = Database::sqlite(folder.path().join("farm.sqlite"));
        Self::start(folder, database, None, [1, workers], "")
    }

    fn start(
        folder: tempfile::TempDir,
        database: Database,
        inner_doors: Option<[Proxy; 2]>,
        [servers, workers]: [usize; 2],
        prefix: &str,
    ) -> Self {
        let member =
            |name: String| Member { name, running: None, clock: Clock::new(), port: 0, said: Vec::new() };
        let named = |what: &str, count| (0..count).map(|n| member(format!("{what}-{n}"))).collect::<Vec<_>>();
        let (servers, workers) = (named("server", servers), named("worker", workers));
        let (front_door, prefix) = (Proxy::to(&[]), prefix.to_owned());
        let mut troupe = Self { database, front_door, inner_doors, servers, workers, folder, prefix };
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

    /// The front door, then those of the database and of the bytes.
    pub fn doors(&self) -> Vec<&Proxy> {
        std::iter::once(&self.front_door).chain(self.inner_doors.iter().flatten()).collect()
    }

    /// Every clock of the farm, by whose it is.
    pub fn clocks(&self) -> Vec<(&str, &Clock)> {
        let of_database = self.database.server().map(|(_, clock)| ("the database", clock));
        let members =
            self.servers.iter().chain(&self.workers).map(|member| (member.name.as_str(), &member.clock));
        // The one that counts is turned as often as all others.
        let counts = of_database.unwrap_or((self.servers[0].name.as_str(), &self.servers[0].clock));
        let others: Vec<_> = members.collect();
        std::iter::repeat_n(counts, others.len()).chain(others).collect()
    }

    /// Arguments and variables by which a program finds database and bytes; around the doors if it is not to suffer.
    pub fn settings(&self, is_behind_doors: bool) -> Vec<(String, String)> {
        let Some([database_door, bytes_door]) = &self.inner_doors else {
            let chunks = self.folder.path().join("chunks").display().to_string();
            let place = ("KILN_DATABASE".to_owned(), self.database.url_at(0));
            return vec![place, ("KILN_CHUNKS".to_owned(), chunks)];
        };
        let (database, bytes) = if is_behind_doors {
            (database_door.port, bytes_door.port)
        } else {
            (self.database.server().expect("it has a door").0, s3::server().port())
        };
        let mut settings = s3::S3::settings_at(bytes);
        settings.push(("KILN_DATABASE".to_owned(), self.database.url_at(database)));
        settings.push(("KILN_CHUNKS".to_owned(), format!("s3://{}/{}", s3::BUCKET, self.prefix)));
        settings
    }

    /// Starts a server, which serves as soon as its database does.
    fn start_server(&mut self, index: usize) {
        let member = &self.servers[index];
        let mut command = kiln(&self.folder.path().join(&member.name));
        command.args(["server", "--listen", "127.0.0.1:0"]).envs(self.settings(true));
        let running = Running::start(among(command, &member.clock));
        let port = running.stdout_line_if_any(|line| line.rsplit_once(':')?.1.parse().ok());
        let member = &mut self.servers[index];
        let Some(port) = port else {
            panic!("{} did not start, and said {:?}", member.name, running.finish().stderr);
        };
        (member.running, member.port) = (Some(running), port);
        self.front_door.add_target(port);
    }

    fn start_worker(&mut self, index: usize) {
        let member = &mut self.workers[index];
        let mut command = among(kiln(&self.folder.path().join(&member.name)), &member.clock);
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

/// The command, going by a clock.
fn among(mut command: Command, clock: &Clock) -> Command {
    command.envs(clock.variables());
    command
}

impl Member {
    /// Sends a signal by name.
    pub fn signal(&self, name: &str) {
        self.running.as_ref().expect("it is under way").signal(name);
    }

    fn kill(&mut self) {
        let running = self.running.take().expect("it is under way");
        let process = running.id();
        running.signal("KILL");
        let finished = running.finish();
        assert_eq!(finished.exit, None, "{} had ended before it was killed", self.name);
        clocks::clear_after(process);
        self.said.extend(finished.stderr);
    }
}
