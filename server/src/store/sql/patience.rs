//! Waits for bakes that somebody else has locked, so that one that is locked for long holds up its own callers alone.
//!
//! Most locks last for milliseconds, and whoever wants the bake waits in line for it. A plan of a hundred thousand tasks takes
//! seconds, and so does a server that is stopped in the middle of a transaction. A call that has waited for a moment
//! ([`brief`](super::postgres)) therefore ends its transaction, and for [`WARY`] from then on bakes that are locked are left out. Where nothing but such a bake can serve a call, it waits
//! as long as the database lets it; a few at a time, so that all others find a connection.
//!
//! A change of the farm waits for every transaction under way, and all that come after it wait behind it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Semaphore, SemaphorePermit};

use super::batch::CommitQueue;
use crate::store::StoreError;

/// Time for which locked bakes are left out, once one was not free in time.
const WARY: Duration = Duration::from_secs(1);
/// Claims that wait for locked bakes at a time, and so many connections.
const WAITING_CLAIMS: usize = 2;
/// Commits that wait for locked bakes, or bring plans, at a time.
const WAITING_COMMITS: usize = 3;

/// Treatment of bakes that somebody else has locked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Locked {
    /// Wait in line.
    AreWaitedFor,
    /// Go without them.
    AreLeft,
}

pub(super) struct Patience {
    wary_since: Mutex<Option<Instant>>,
    claims: Semaphore,
    commits: Semaphore,
    /// By bake, commits that wait for it.
    lines: Mutex<BTreeMap<i64, Arc<CommitQueue>>>,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            wary_since: Mutex::default(),
            claims: Semaphore::new(WAITING_CLAIMS),
            commits: Semaphore::new(WAITING_COMMITS),
            lines: Mutex::default(),
        }
    }
}

impl Patience {
    /// Whether some bake was not free in time, a moment ago.
    pub(super) fn is_wary(&self) -> bool {
        lock(&self.wary_since).is_some_and(|since| since.elapsed() < WARY)
    }

    pub(super) fn note_long_wait(&self) {
        *lock(&self.wary_since) = Some(Instant::now());
    }

    /// A place among the claims that wait.
    pub(super) async fn claim(&self) -> Option<SemaphorePermit<'_>> {
        // Never closed.
        self.claims.acquire().await.ok()
    }

    /// A place among the commits that wait.
    pub(super) async fn commit(&self) -> Option<SemaphorePermit<'_>> {
        self.commits.acquire().await.ok()
    }

    /// The line of commits that wait for a bake; those that nobody is in any more go.
    pub(super) fn line(&self, bake: i64) -> Arc<CommitQueue> {
        let mut lines = lock(&self.lines);
        lines.retain(|_, line| Arc::strong_count(line) > 1);
        lines.entry(bake).or_default().clone()
    }
}

/// Whether a row was not free in time.
pub(super) fn is_long_wait(error: &StoreError) -> bool {
    let StoreError::Unavailable(source) = error else { return false };
    let Some(sqlx::Error::Database(error)) = source.downcast_ref::<sqlx::Error>() else { return false };
    error.code().is_some_and(|code| code == "55P03")
}

fn lock<T>(held: &Mutex<T>) -> MutexGuard<'_, T> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}
