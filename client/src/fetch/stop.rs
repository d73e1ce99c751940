//! A wish to stop, on which waits wait.

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Ends waits and downloads early, e.g. on Ctrl-C. Shared by reference or in an `Arc`.
#[derive(Debug, Default)]
pub struct Stop {
    wished: Mutex<bool>,
    changed: Condvar,
}

impl Stop {
    /// Wishes all waits to end now, for good.
    pub fn wish(&self) {
        *self.wished.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.changed.notify_all();
    }

    /// Whether an end was wished.
    pub fn is_wished(&self) -> bool {
        *self.wished.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits `limit` or until an end is wished; true in the latter case.
    pub fn wait(&self, limit: Duration) -> bool {
        let end = Instant::now() + limit;
        let mut wished = self.wished.lock().unwrap_or_else(PoisonError::into_inner);
        while !*wished {
            let Some(left) = end.checked_duration_since(Instant::now()) else { break };
            let waited = self.changed.wait_timeout(wished, left);
            wished = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        *wished
    }
}
