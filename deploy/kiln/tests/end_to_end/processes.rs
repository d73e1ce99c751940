//! Running `kiln` and waiting for it, with limits; whatever a test starts ends with it.

use std::ffi::OsStr;
use std::io::{BufRead as _, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Longest that a test waits for one thing.
pub const LIMIT: Duration = Duration::from_secs(300);

/// A command with a state folder of its own and nothing of the caller's settings.
pub fn kiln(state: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kiln"));
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("KILN_")) {
        command.env_remove(name);
    }
    command.env("KILN_STATE", state).stdin(Stdio::null());
    command
}

/// Runs to the end and asserts the exit code; shows what it wrote if that is another.
pub fn run<A: AsRef<OsStr>>(mut command: Command, arguments: &[A], exit: i32) -> Finished {
    let output = command.args(arguments).output().unwrap();
    let finished = Finished(output);
    assert_eq!(finished.0.status.code(), Some(exit), "{command:?} wrote:\n{}", finished.stderr());
    finished
}

/// A command that has ended.
pub struct Finished(pub Output);

impl Finished {
    pub fn stdout(&self) -> String {
        String::from_utf8(self.0.stdout.clone()).unwrap()
    }

    pub fn stderr(&self) -> String {
        String::from_utf8_lossy(&self.0.stderr).into_owned()
    }

    /// Standard output as one JSON value.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout()).unwrap_or_else(|error| panic!("{error}: {}", self.stdout()))
    }
}

/// A process under way; killed when it is dropped.
pub struct Running {
    child: Child,
    stdout: Receiver<String>,
    stderr: Receiver<String>,
}

impl Running {
    pub fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let stdout = lines(child.stdout.take().unwrap());
        let stderr = lines(child.stderr.take().unwrap());
        Self { child, stdout, stderr }
    }

    /// The first line on standard output from here on that `pick` takes.
    pub fn stdout_line<T>(&self, pick: impl Fn(&str) -> Option<T>) -> T {
        wait_for_line(&self.stdout, pick)
    }

    /// The first line on standard output from here on that `pick` takes; none if the process ends first.
    pub fn stdout_line_if_any<T>(&self, pick: impl Fn(&str) -> Option<T>) -> Option<T> {
        let deadline = Instant::now() + LIMIT;
        loop {
            match self.stdout.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(line) => match pick(&line) {
                    Some(found) => return Some(found),
                    None => continue,
                },
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) => {
                    panic!("neither the line nor the end came within {LIMIT:?}")
                }
            }
        }
    }

    /// Lines of standard error since somebody last looked.
    pub fn stderr_so_far(&self) -> Vec<String> {
        self.stderr.try_iter().collect()
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// How the process ended, if it has.
    pub fn has_ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().unwrap()
    }

    /// The first line on standard error from here on that `pick` takes.
    pub fn stderr_line<T>(&self, pick: impl Fn(&str) -> Option<T>) -> T {
        wait_for_line(&self.stderr, pick)
    }

    /// Sends a signal by name, e.g. `INT`.
    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let status = Command::new("kill").args(["-s", name, &id]).status().unwrap();
        assert!(status.success(), "kill -s {name} {id} failed");
    }

    /// Waits for the end; the exit code, `None` if a signal ended it.
    pub fn wait(self) -> Option<i32> {
        self.finish().exit
    }

    /// Waits for the end, and gives what nobody has looked at yet.
    pub fn finish(mut self) -> Ended {
        let deadline = Instant::now() + LIMIT;
        let mut stderr = Vec::new();
        // Its lines end when the process does.
        while let Ok(line) = self.stderr.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            stderr.push(line);
        }
        assert!(Instant::now() < deadline, "the process did not end within {LIMIT:?}; it wrote {stderr:#?}");
        let exit = self.child.wait().unwrap().code();
        Ended { exit, stdout: self.stdout.iter().collect(), stderr }
    }
}

/// Remains of a process.
pub struct Ended {
    /// Exit code; `None` if a signal ended it.
    pub exit: Option<i32>,
    pub stdout: Vec<String>,
    pub stderr: Vec<String>,
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn lines(stream: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(stream).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    receiver
}

fn wait_for_line<T>(lines: &Receiver<String>, pick: impl Fn(&str) -> Option<T>) -> T {
    let deadline = Instant::now() + LIMIT;
    let mut seen = Vec::new();
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        match lines.recv_timeout(left) {
            Ok(line) => match pick(&line) {
                Some(found) => return found,
                None => seen.push(line),
            },
            Err(error) => panic!("the line did not come ({error}); these did: {seen:#?}"),
        }
    }
}

/// `kiln server` on a free port, over `state`.
pub struct Server {
    pub url: String,
    process: Running,
}

impl Server {
    pub fn start(state: &Path) -> Self {
        Self::start_with(kiln(state), &[])
    }

    /// The same with more arguments, and with what else `command` has.
    pub fn start_with(mut command: Command, arguments: &[&str]) -> Self {
        command.args(["server", "--listen", "127.0.0.1:0"]).args(arguments);
        let process = Running::start(command);
        let url = process.stdout_line(|line| line.strip_prefix("listening on ").map(str::to_owned));
        Self { url, process }
    }

    /// Sends a signal by name.
    pub fn signal(&self, name: &str) {
        self.process.signal(name);
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.process.child.id()
    }

    /// Stops it as its owner would; the exit code.
    pub fn stop(self) -> Option<i32> {
        self.process.signal("TERM");
        self.process.wait()
    }

    /// `kiln worker` for this server, with a cache of its own and the shortest lease.
    pub fn worker(&self, folder: &Path, name: &str, threads: usize) -> Running {
        let mut command = kiln(&folder.join(name));
        command.args(["worker", "--server", &self.url, "--name", name, "--lease-secs", "5"]);
        command.args(["--threads", &threads.to_string()]);
        Running::start(command)
    }
}
