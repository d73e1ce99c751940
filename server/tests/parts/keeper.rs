//! A server program that ends with the test process, however that ends.
//!
//! A shell keeps it: it waits on a pipe from the test process, and when that is closed it ends the program and removes
//! the folder. Nothing is left behind by a test that was killed.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Each line on the pipe ends the program by that signal and starts it again; the end of the pipe ends it.
///
/// Runs `$1`, a script that starts the program in the background and sets `server`, and `stop` to the signal that ends
/// it; `$2` is the folder. Only the program holds the output afterwards, so that it ends when the program does. A
/// program that does not heed the signal is killed; that much later, not sooner, as others may get its number.
const KEEP: &str = r#"
trap '' INT TERM
folder=$2
trap 'rm -rf "$folder"' EXIT
eval "$1"
exec >/dev/null 2>&1
end() {
    kill -s "$stop" "$server"
    { sleep 10; kill -9 "$server"; } &
    killer=$!
    wait "$server"
    kill -9 "$killer"
}
while read -r _; do
    end
    eval "$1"
done
end
"#;

/// User and group ids of `nobody` on Debian: a program that refuses root runs as it.
const NOBODY: u32 = 65_534;
/// Longest that a program may take to be ready.
const LIMIT: Duration = Duration::from_secs(120);
/// Times that a program is started before the test gives up: its port may be taken by the time it looks.
const TRIES: u32 = 5;

/// A program under way.
pub struct Keeper {
    /// Its standard input is the pipe that keeps the program alive.
    child: Mutex<Child>,
}

impl Keeper {
    /// Starts a program and waits until it prints a line with `ready` in it, which is returned.
    ///
    /// `script` is shell code with `$folder`, made anew for each try. As root, it runs as `nobody` if it `refuses_root`.
    pub fn start(script: impl Fn() -> String, ready: &str, refuses_root: bool) -> (Self, String) {
        let mut said = Vec::new();
        for _ in 0..TRIES {
            match Self::try_start(&script(), ready, refuses_root) {
                Ok(started) => return started,
                Err(lines) => said.push(lines),
            }
        }
        panic!("the program was started {TRIES} times and never said '{ready}': {said:#?}");
    }

    /// Ends the program by its signal and starts it again, in the same folder; nobody waits until it is ready.
    pub fn restart(&self) {
        let mut child = self.child.lock().unwrap();
        child.stdin.as_mut().unwrap().write_all(b"again\n").unwrap();
    }

    /// An error holds its words instead.
    fn try_start(script: &str, ready: &str, refuses_root: bool) -> Result<(Self, String), Vec<String>> {
        let folder = tempfile::tempdir().unwrap().keep();
        let mut command = Command::new("sh");
        command.args(["-c", KEEP, "sh", script]).arg(&folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        command.current_dir(&folder);
        if refuses_root && is_root() {
            std::os::unix::fs::chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
            command.uid(NOBODY).gid(NOBODY);
        }
        let mut child = command.spawn().unwrap();
        let output = lines(child.stdout.take().unwrap());
        let keeper = Self { child: Mutex::new(child) };
        let deadline = Instant::now() + LIMIT;
        let mut said = Vec::new();
        // Ends with the time, or with the program.
        while let Ok(line) = output.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            if line.contains(ready) {
                return Ok((keeper, line));
            }
            said.push(line);
        }
        Err(said)
    }
}

/// Reads to the end, whether or not anyone listens: else the program would wait for room in the pipe.
fn lines(output: ChildStdout) -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            let _ = sender.send(line);
        }
    });
    receiver
}

fn is_root() -> bool {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata("/proc/self").unwrap().uid() == 0
}

/// A port that is free now.
pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}
