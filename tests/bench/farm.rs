//! `kiln` processes, and what the system says of them.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Ticks a second in `/proc/PID/stat`; Linux has no other on its common machines.
const TICKS_PER_SEC: f64 = 100.0;

/// A process that ends with the bench.
pub struct Process(Child);

impl Process {
    /// Its number.
    pub fn id(&self) -> u32 {
        self.0.id()
    }

    /// Time that processors spent on it.
    pub fn cpu(&self) -> Duration {
        Usage::of(self.0.id()).unwrap().cpu
    }

    /// Memory that it has, in bytes.
    pub fn memory(&self) -> u64 {
        Usage::of(self.0.id()).unwrap().memory
    }
}

/// Processor time and memory of a process until now.
#[derive(Clone, Copy, Debug, Default)]
pub struct Usage {
    /// Time that processors spent on it.
    pub cpu: Duration,
    /// Memory that it has, in bytes.
    pub memory: u64,
    /// Most memory that it had.
    pub peak_memory: u64,
}

impl Usage {
    /// That of a process; `None` once it has ended.
    pub fn of(process: u32) -> Option<Self> {
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
        // Behind the name, which may hold anything, user and system time are fields 12 and 13.
        let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
        let ticks: f64 = fields.get(11..13)?.iter().filter_map(|field| field.parse::<f64>().ok()).sum();
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
        let bytes = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name))?;
            Some(line.split_whitespace().next()?.parse::<u64>().ok()? << 10)
        };
        let cpu = Duration::from_secs_f64(ticks / TICKS_PER_SEC);
        Some(Self { cpu, memory: bytes("VmRSS:")?, peak_memory: bytes("VmHWM:")? })
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// `kiln` with a state folder of its own and nothing of the caller's settings.
pub fn kiln(state: &Path) -> Command {
    let program = std::env::var_os("KILN_BENCH_PROGRAM").expect("KILN_BENCH_PROGRAM: use tests/bench/run");
    let mut command = Command::new(program);
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("KILN_")) {
        command.env_remove(name);
    }
    command.env("KILN_STATE", state).stdin(Stdio::null()).stderr(Stdio::null());
    command
}

/// A running server.
pub struct Server {
    pub process: Process,
    pub url: String,
}

impl Server {
    /// Starts one without limits on calls; its database is SQLite unless another is named.
    pub fn start(state: &Path, database: Option<&str>) -> Self {
        let mut command = kiln(state);
        command.args(["server", "--listen", "127.0.0.1:0", "--calls-per-sec", "0", "--calls-at-a-time", "0"]);
        if let Some(database) = database {
            command.args(["--database", database]);
        }
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().strip_prefix("listening on ").expect("the server says where it listens");
        Self { process: Process(child), url: url.to_owned() }
    }
}

/// Starts a worker of one thread.
pub fn worker(folder: &Path, url: &str, name: &str) -> Process {
    let mut command = kiln(&folder.join(name));
    command.args(["worker", "--server", url, "--name", name, "--threads", "1"]);
    Process(command.stdout(Stdio::null()).spawn().unwrap())
}
