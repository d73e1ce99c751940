//! Ctrl-C and SIGTERM: the first winds the command down, a second one ends the process at once.

use std::time::{Duration, Instant};

use lightkiln_http::{Level, ShutdownFlag};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::console::say;
use crate::failure::{Exit, Failure, Result};

/// Time from the first signal within which others are its echoes: shells and process managers signal a group and its processes, too.
/// Longer → whoever means it has to wait.
const ECHO: Duration = Duration::from_millis(500);

/// Raised by the first signal.
#[derive(Clone, Default)]
pub struct Interrupt {
    flag: ShutdownFlag,
}

/// Meaning of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meaning {
    WindDown,
    /// The first one, once more.
    Echo,
    EndNow,
}

/// Meaning of a signal that comes so long after the first; none for the first itself.
fn meaning(since_first: Option<Duration>) -> Meaning {
    match since_first {
        None => Meaning::WindDown,
        Some(since) if since < ECHO => Meaning::Echo,
        Some(_) => Meaning::EndNow,
    }
}

impl Interrupt {
    /// Listens for signals from now on.
    pub fn listen() -> Result<Self> {
        let interrupt = Self::default();
        let raised = interrupt.clone();
        let mut signals = Signals::new([SIGINT, SIGTERM])
            .map_err(|error| Failure::new(Exit::Failed, "cannot listen for signals").caused_by(&error))?;
        std::thread::spawn(move || {
            let mut first: Option<Instant> = None;
            for _ in signals.forever() {
                match meaning(first.map(|first| first.elapsed())) {
                    Meaning::WindDown => {
                        first = Some(Instant::now());
                        raised.flag.raise(Level::Drain);
                        say!("winding down; a second signal ends this at once");
                    }
                    Meaning::Echo => {}
                    Meaning::EndNow => std::process::exit(Exit::Interrupted as i32),
                }
            }
        });
        Ok(interrupt)
    }

    /// Whether a signal came.
    pub fn is_raised(&self) -> bool {
        self.flag.level() > Level::Run
    }

    /// Drains workers and ends waits for a server on the first signal.
    pub fn flag(&self) -> &ShutdownFlag {
        &self.flag
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_signal_counts_half_a_second_after_the_first_and_not_before() {
        let after = |millis| meaning(Some(Duration::from_millis(millis)));
        assert_eq!(meaning(None), Meaning::WindDown);
        assert_eq!([0, 3, 499].map(after), [Meaning::Echo; 3]);
        assert_eq!([500, 60_000].map(after), [Meaning::EndNow; 2]);
    }
}
