//! A flag that tells a role to wind down, and on which its threads wait.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How urgently to stop. Only ever rises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Go on.
    #[default]
    Run,
    /// Begin nothing more, end waits; a worker finishes the task in hand within the grace period, else releases it.
    Drain,
    /// End now; a worker releases the task in hand.
    Stop,
}

/// Shared by whoever may end a role and by the role's threads; clones are the same flag.
#[derive(Clone, Debug, Default)]
pub struct ShutdownFlag(Arc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    level: Mutex<Level>,
    changed: Condvar,
}

impl ShutdownFlag {
    /// A flag at [`Level::Run`].
    pub fn new() -> Self {
        Self::default()
    }

    /// Raises the flag to `level` if it is lower, and wakes all who wait.
    pub fn raise(&self, level: Level) {
        let mut current = self.lock();
        *current = level.max(*current);
        self.0.changed.notify_all();
    }

    /// The level now.
    pub fn level(&self) -> Level {
        *self.lock()
    }

    /// Makes all who wait look at their condition again. Call it after changing what a condition reads.
    pub fn wake(&self) {
        let _lock = self.lock();
        self.0.changed.notify_all();
    }

    /// Waits until `done(level)` or for `timeout` at most; the answer is the level then.
    pub fn wait(&self, timeout: Duration, done: impl Fn(Level) -> bool) -> Level {
        let deadline = Instant::now() + timeout;
        let mut level = self.lock();
        while !done(*level) {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            let waited = self.0.changed.wait_timeout(level, left);
            level = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        *level
    }

    fn lock(&self) -> MutexGuard<'_, Level> {
        self.0.level.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_never_falls() {
        let flag = ShutdownFlag::new();
        flag.raise(Level::Stop);
        flag.raise(Level::Drain);
        assert_eq!(flag.level(), Level::Stop);
    }

    #[test]
    fn wait_ends_when_another_thread_raises_the_flag() {
        let flag = ShutdownFlag::new();
        std::thread::scope(|scope| {
            scope.spawn(|| flag.raise(Level::Drain));
            let level = flag.wait(Duration::from_secs(60), |level| level >= Level::Drain);
            assert_eq!(level, Level::Drain);
        });
    }
}
