//! Processor time of a server, of its database's processes, of this program, and of all others.

use std::fs::read_to_string;
use std::time::{Duration, Instant};

/// Ticks a second in `/proc`.
const TICKS_PER_SEC: f64 = 100.0;

/// Processes whose time is measured.
pub struct Meter {
    server: u32,
    /// The process from which all others of the database come.
    database: Option<u32>,
}

/// A moment's sums.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    at: Instant,
    server: Duration,
    database: Duration,
    own: Duration,
    all: Duration,
    /// Times that a session of the database waited for its server.
    trips: u64,
}

/// Sums between two moments.
#[derive(Clone, Copy, Debug)]
pub struct Spent {
    pub server: Duration,
    pub database: Duration,
    pub own: Duration,
    pub trips: u64,
    /// Share of the machine's processors that other programs had.
    pub elsewhere: f64,
    /// Share that was in use.
    pub busy: f64,
}

impl Meter {
    /// Of a server, and of the PostgreSQL that listens on that port.
    pub fn new(server: u32, port: Option<u16>) -> Self {
        Self {
            server,
            database: port.map(|port| postgres_at(port).expect("a PostgreSQL server on that port")),
        }
    }

    pub fn read(&self) -> Reading {
        let family: Vec<u32> = self.database.map(children).unwrap_or_default();
        let sessions = family.iter().filter(|process| command_line(**process).contains(": kiln "));
        // Sessions that ended are their parent's.
        let parent = self.database.map_or(Duration::ZERO, |process| cpu(process, 4));
        Reading {
            at: Instant::now(),
            server: cpu(self.server, 2),
            database: parent + family.iter().map(|process| cpu(*process, 2)).sum::<Duration>(),
            own: cpu(std::process::id(), 2),
            all: all(),
            trips: sessions.map(|process| waits(*process)).sum(),
        }
    }

    pub fn since(&self, before: &Reading) -> Spent {
        let now = self.read();
        let [server, database, own, all] = [
            now.server - before.server,
            now.database.saturating_sub(before.database),
            now.own - before.own,
            now.all - before.all,
        ];
        let time = (now.at - before.at).as_secs_f64() * processors() as f64;
        let elsewhere = all.saturating_sub(server + database + own).as_secs_f64() / time;
        let trips = now.trips.saturating_sub(before.trips);
        Spent { server, database, own, trips, elsewhere, busy: all.as_secs_f64() / time }
    }
}

/// Processors of this machine.
pub fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Time of a process: its own, or, of four fields, that of its children that have ended, too.
fn cpu(process: u32, fields: usize) -> Duration {
    let stat = read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks: f64 = after_name.skip(11).take(fields).filter_map(|field| field.parse::<f64>().ok()).sum();
    Duration::from_secs_f64(ticks / TICKS_PER_SEC)
}

/// Time of all processors but idle, and waiting for disks.
fn all() -> Duration {
    let stat = read_to_string("/proc/stat").unwrap();
    let first = stat.lines().next().unwrap();
    let ticks: Vec<f64> = first.split_whitespace().filter_map(|field| field.parse().ok()).take(8).collect();
    Duration::from_secs_f64((ticks.iter().sum::<f64>() - ticks[3] - ticks[4]) / TICKS_PER_SEC)
}

fn waits(process: u32) -> u64 {
    let status = read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let count = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    count.and_then(|count| count.trim().parse().ok()).unwrap_or(0)
}

fn command_line(process: u32) -> String {
    let bytes = std::fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
    String::from_utf8_lossy(&bytes).replace('\0', " ")
}

fn all_processes() -> Vec<u32> {
    let entries = std::fs::read_dir("/proc").unwrap();
    entries.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok()).collect()
}

fn children(parent: u32) -> Vec<u32> {
    let parent_of = |process: u32| {
        let stat = read_to_string(format!("/proc/{process}/stat")).ok()?;
        stat.rsplit(')').next()?.split_whitespace().nth(1)?.parse::<u32>().ok()
    };
    all_processes().into_iter().filter(|process| parent_of(*process) == Some(parent)).collect()
}

/// The oldest process of PostgreSQL on a port: the others have titles instead of arguments.
fn postgres_at(port: u16) -> Option<u32> {
    let argument = format!(" -p {port} ");
    let is_it = |process: &u32| {
        let line = command_line(*process);
        line.split(' ').next().is_some_and(|program| program.ends_with("/postgres"))
            && line.contains(&argument)
    };
    all_processes().into_iter().filter(is_it).min()
}
