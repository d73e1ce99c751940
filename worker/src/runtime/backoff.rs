//! Growing waits between tries of a call, with jitter so that workers do not come back all at once.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::time::Duration;

const FIRST_WAIT: Duration = Duration::from_millis(200);
const LONGEST_WAIT: Duration = Duration::from_secs(15);

/// The waits of one series of tries.
#[derive(Debug)]
pub(super) struct Backoff {
    next: Duration,
}

impl Backoff {
    /// Starts with the shortest wait.
    pub(super) fn new() -> Self {
        Self { next: FIRST_WAIT }
    }

    /// The next wait: doubling up to the longest, of which half is left to chance.
    pub(super) fn wait(&mut self) -> Duration {
        let whole = self.next;
        self.next = (whole * 2).min(LONGEST_WAIT);
        whole / 2 + (whole / 2).mul_f64(chance())
    }

    /// Starts over after a success.
    pub(super) fn reset(&mut self) {
        self.next = FIRST_WAIT;
    }
}

/// A number in 0..1 that differs between processes and calls; no result hangs on it.
fn chance() -> f64 {
    let random = RandomState::new().build_hasher().finish();
    (random >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_grow_to_the_longest_and_start_over() {
        let mut backoff = Backoff::new();
        assert!(backoff.wait() <= FIRST_WAIT);
        let late = (0..20).map(|_| backoff.wait()).last().unwrap();
        assert!(late >= LONGEST_WAIT / 2 && late <= LONGEST_WAIT, "{late:?}");
        backoff.reset();
        assert!(backoff.wait() <= FIRST_WAIT);
    }
}
