//! Clocks that run ahead or behind: libfaketime tells a program its time, as a file says.

use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::NamedTempFile;

/// The clock of a program on a machine of its own.
pub struct Clock {
    /// How far it is ahead, as libfaketime reads it with each look at the time.
    file: NamedTempFile,
}

impl Clock {
    /// One that is right.
    pub fn new() -> Self {
        let clock = Self { file: NamedTempFile::new().unwrap() };
        // PostgreSQL runs as somebody else.
        clock.file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644)).unwrap();
        clock.set(0);
        clock
    }

    /// Puts it so many seconds ahead of the machine's, or behind.
    pub fn set(&self, ahead_secs: i64) {
        // In one write of one length: a reader sees no half of it.
        self.file.reopen().unwrap().write_all(format!("{ahead_secs:+012}\n").as_bytes()).unwrap();
    }

    /// Variables with which a program goes by it.
    pub fn variables(&self) -> [(&'static str, String); 5] {
        let on = || "1".to_owned();
        [
            ("LD_PRELOAD", library().display().to_string()),
            ("FAKETIME_TIMESTAMP_FILE", self.file.path().display().to_string()),
            ("FAKETIME_NO_CACHE", on()),
            // Durations are right whatever the clock says, and files have the times that their disk gives them.
            ("FAKETIME_DONT_FAKE_MONOTONIC", on()),
            ("NO_FAKE_STAT", on()),
        ]
    }
}

/// Removes what libfaketime leaves behind of a program that was killed.
pub fn clear_after(process: u32) {
    for name in [format!("faketime_shm_{process}"), format!("sem.faketime_sem_{process}")] {
        let _ = std::fs::remove_file(Path::new("/dev/shm").join(name));
    }
}

/// The library for programs with threads, where Debian puts it.
fn library() -> PathBuf {
    let folders = std::fs::read_dir("/usr/lib").unwrap().map(|entry| entry.unwrap().path());
    let found = folders.map(|folder| folder.join("faketime/libfaketimeMT.so.1"));
    found
        .into_iter()
        .find(|library| library.is_file())
        .expect("libfaketime is not installed; tests/run installs it")
}

#[test]
fn program_goes_by_the_clock_that_it_was_given() {
    let clock = Clock::new();
    let told = || {
        let ended = Command::new("date").arg("+%s").envs(clock.variables()).output().unwrap();
        String::from_utf8(ended.stdout).unwrap().trim().parse::<i64>().unwrap()
    };
    let truth = || std::time::UNIX_EPOCH.elapsed().unwrap().as_secs() as i64;
    for ahead in [0, 7_200, -7_200, 86_400, 1] {
        clock.set(ahead);
        let (before, told, after) = (truth(), told(), truth());
        assert!(
            (before + ahead..=after + ahead).contains(&told),
            "{told} between {before} and {after}, {ahead} ahead"
        );
    }
}
