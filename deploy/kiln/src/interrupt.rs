//! Ctrl-C and SIGTERM: the first winds the command down, the second ends the process at once.

use lightkiln_http::{Level, ShutdownFlag};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::failure::{Exit, Failure, Result};

/// Raised by the first signal.
#[derive(Clone, Default)]
pub struct Interrupt {
    flag: ShutdownFlag,
}

impl Interrupt {
    /// Listens for signals from now on.
    pub fn listen() -> Result<Self> {
        let interrupt = Self::default();
        let raised = interrupt.clone();
        let mut signals = Signals::new([SIGINT, SIGTERM])
            .map_err(|error| Failure::new(Exit::Failed, "cannot listen for signals").caused_by(&error))?;
        std::thread::spawn(move || {
            for _ in signals.forever() {
                if raised.is_raised() {
                    std::process::exit(Exit::Interrupted as i32);
                }
                raised.flag.raise(Level::Drain);
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
