//! What drivers write to standard error while an adapter is opened: for the log, not for whoever draws a picture.
//!
//! Vulkan's layers ask for a display that nobody needs here, and call it an error that there is none.

/// Runs `open`; lines that it writes to standard error go to the log, for those who debug.
pub(super) fn logged<T>(open: impl FnOnce() -> T) -> T {
    let (opened, heard) = overhear(open);
    for line in heard.lines() {
        tracing::debug!("a driver says: {line}");
    }
    opened
}

/// Runs `open`, and gives what it wrote to standard error with its answer. Where standard error cannot be turned aside,
/// or the loader of Vulkan was asked to tell more of itself, it goes its usual way.
#[cfg(unix)]
fn overhear<T>(open: impl FnOnce() -> T) -> (T, String) {
    use std::sync::{Mutex, PoisonError};
    // Whoever turned it aside second would turn it back to the first one's pipe.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let aside = match std::env::var_os("VK_LOADER_DEBUG") {
        None => aside::Aside::turn().ok(),
        Some(_) => None,
    };
    let opened = open();
    (opened, aside.map(aside::Aside::turn_back).unwrap_or_default())
}

#[cfg(not(unix))]
fn overhear<T>(open: impl FnOnce() -> T) -> (T, String) {
    (open(), String::new())
}

#[cfg(unix)]
mod aside {
    use std::io::{self, Read as _};
    use std::os::fd::{AsFd as _, OwnedFd};
    use std::thread::JoinHandle;

    use rustix::stdio::dup2_stderr;

    /// Standard error while it goes into a pipe.
    pub(super) struct Aside {
        own: Option<OwnedFd>,
        reader: Option<JoinHandle<String>>,
    }

    impl Aside {
        /// Turns standard error aside. A thread reads the pipe, so that nobody who writes has to wait for room.
        pub(super) fn turn() -> io::Result<Self> {
            let (mut from, into) = io::pipe()?;
            let own = Some(io::stderr().as_fd().try_clone_to_owned()?);
            let read = move || {
                let mut heard = Vec::new();
                // What came before an error is worth as much.
                let _ = from.read_to_end(&mut heard);
                String::from_utf8_lossy(&heard).into_owned()
            };
            let reader = Some(std::thread::spawn(read));
            dup2_stderr(&into)?;
            Ok(Self { own, reader })
        }

        /// Turns it back; gives what came meanwhile.
        pub(super) fn turn_back(mut self) -> String {
            self.restore();
            self.reader.take().and_then(|reader| reader.join().ok()).unwrap_or_default()
        }

        fn restore(&mut self) {
            // The pipe's end has gone with it: its reader ends.
            if let Some(own) = self.own.take() {
                let _ = dup2_stderr(&own);
            }
        }
    }

    /// Also after a panic.
    impl Drop for Aside {
        fn drop(&mut self) {
            self.restore();
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn drivers_words_are_heard_and_later_ones_are_not() {
        let say = |word: &str| std::io::stderr().write_all(word.as_bytes()).unwrap();
        let (answer, heard) = overhear(|| {
            say("error: no display\n");
            7
        });
        assert_eq!(answer, 7);
        assert!(heard.contains("error: no display"), "{heard}");
        let (_, long) = overhear(|| say(&"x".repeat(1 << 20)));
        assert!(long.len() >= 1 << 20, "more than a pipe holds: {}", long.len());
        let panicked = std::panic::catch_unwind(|| overhear(|| panic!("in a driver")));
        assert!(panicked.is_err());
        assert_eq!(overhear(|| ()).1, "", "nothing is left over");
    }
}
