//! Hints that something changed, so that waiting calls look again at once.
//!
//! Lossy by contract: a hint may never arrive. Who waits also looks again after a while by itself, and nothing but
//! the store is believed.

mod postgres;

use std::time::Duration;

use async_trait::async_trait;
use tokio::sync::watch;

pub use postgres::PostgresWakeup;

/// Wakes waiting calls early, perhaps.
#[async_trait]
pub trait Wakeup: Send + Sync {
    /// A mark to take **before** looking at the store and to give to [`Wakeup::wait`] after.
    fn mark(&self) -> u64;

    /// Says that the store changed.
    fn hint(&self);

    /// Returns after a hint given since `mark`, or after `timeout`.
    async fn wait(&self, mark: u64, timeout: Duration);
}

/// Hints within one process.
#[derive(Debug)]
pub struct LocalWakeup {
    hints: watch::Sender<u64>,
}

impl Default for LocalWakeup {
    fn default() -> Self {
        Self { hints: watch::Sender::new(0) }
    }
}

#[async_trait]
impl Wakeup for LocalWakeup {
    fn mark(&self) -> u64 {
        *self.hints.borrow()
    }

    fn hint(&self) {
        self.hints.send_modify(|count| *count = count.wrapping_add(1));
    }

    async fn wait(&self, mark: u64, timeout: Duration) {
        let mut hints = self.hints.subscribe();
        let changed = hints.wait_for(|count| *count != mark);
        // Timeout and a closed channel mean the same: look again.
        let _ = tokio::time::timeout(timeout, changed).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONG: Duration = Duration::from_secs(3600);

    #[tokio::test]
    async fn hint_given_between_look_and_wait_is_not_lost() {
        let wakeup = LocalWakeup::default();
        let mark = wakeup.mark();
        wakeup.hint();
        wakeup.wait(mark, LONG).await;
    }

    #[tokio::test]
    async fn hint_wakes_every_waiter() {
        let wakeup = LocalWakeup::default();
        let mark = wakeup.mark();
        let waiters = futures::future::join(wakeup.wait(mark, LONG), wakeup.wait(mark, LONG));
        let hint = async { wakeup.hint() };
        futures::future::join(waiters, hint).await;
    }

    #[tokio::test]
    async fn wait_without_a_hint_ends_at_its_timeout() {
        LocalWakeup::default().wait(0, Duration::from_millis(1)).await;
    }
}
