//! A server program that ends with the test process, however that ends.
//!
//! A shell keeps it: it waits on a pipe from the test process, and when that is closed it ends the program and removes
//! the folder. Nothing is left behind by a test that was killed.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};

/// Runs `$1`, a script that starts the program in the background and sets `server`; `$2` is the folder.
const KEEP: &str = r#"
trap '' INT TERM
folder=$2
eval "$1"
read -r _
kill -9 "$server" 2>/dev/null
wait
rm -rf "$folder"
"#;

/// User and group ids of `nobody` on Debian: a program that refuses root runs as it.
const NOBODY: u32 = 65_534;

/// A program under way.
pub struct Keeper {
    /// Its standard input is the pipe that keeps the program alive.
    _child: Child,
}

impl Keeper {
    /// Starts a program and waits until it prints a line with `ready` in it.
    ///
    /// `script` is shell code with `$folder`; as root, it runs as `nobody`.
    pub fn start(script: &str, ready: &str) -> Self {
        let folder = tempfile::tempdir().unwrap().keep();
        let mut command = Command::new("sh");
        command.args(["-c", KEEP, "sh", script]).arg(&folder).stdin(Stdio::piped()).stdout(Stdio::piped());
        command.current_dir(&folder);
        if is_root() {
            std::os::unix::fs::chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
            command.uid(NOBODY).gid(NOBODY);
        }
        let mut child = command.spawn().unwrap();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        let mut said = String::new();
        while !said.contains(ready) {
            let count = output.read_line(&mut said).unwrap();
            assert!(count > 0, "the program ended before it said '{ready}':\n{said}");
        }
        // Read on, or the program would wait for room in the pipe.
        std::thread::spawn(move || std::io::copy(&mut output, &mut std::io::sink()));
        Self { _child: child }
    }
}

fn is_root() -> bool {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata("/proc/self").unwrap().uid() == 0
}

/// A port that is free now.
pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}
