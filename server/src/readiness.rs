//! Whether the farm can work, told within a second whatever its database and its chunk store do.
//!
//! Looks go on when nobody waits for them any more, and whoever asks meanwhile joins the one under way: a database that
//! hangs is asked once, not by every probe of every load balancer. A look has an end of its own, so that one that waits on
//! a dead connection is followed by one on another.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::error::{Result, ServerError};
use crate::storage::Storage;
use crate::store::{FarmStore, StoreError};

/// Time in which the database must be written, and the chunk store written and read.
const PROBE_WITHIN: Duration = Duration::from_millis(600);
/// A look at one of them ends after this time. Below the database's own limits of waits for locks, which would else be
/// told as faults.
const PROBE_ENDS_AFTER: Duration = Duration::from_secs(8);
/// Time in which a database that cannot be written, as others hold its lock, must be read.
const READ_WITHIN: Duration = Duration::from_millis(150);
/// A database that was written so lately, and can be read, is ready: a big plan that is committed holds the lock for
/// seconds. Longer → one whose writes hang is found later.
const WRITTEN_WITHIN: Duration = Duration::from_secs(30);
/// Time that is waited for an examination of the database; its outcome counts later if it takes longer.
const EXAMINE_WITHIN: Duration = Duration::from_millis(150);
/// The database is examined again after this time, or after as many times as long as it took. Shorter → damage is known
/// sooner, at more load.
const EXAMINE_AFTER: (Duration, u32) = (Duration::from_secs(1), 50);

/// Outcome of a look.
type Verdict = std::result::Result<(), Fault>;

/// Fault that makes a farm unready.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Fault {
    /// In words.
    why: String,
    /// It is a full disk.
    is_full: bool,
    /// There was no answer, which a lock may be the cause of.
    is_silence: bool,
}

/// Looks at the farm.
#[derive(Default)]
pub(crate) struct Readiness {
    database: Flight,
    chunks: Flight,
    examination: Flight,
    /// Last time that the database was written.
    written: Arc<Mutex<Option<Instant>>>,
    examined: Arc<Mutex<Option<Examined>>>,
}

/// Outcome of an examination.
#[derive(Clone)]
struct Examined {
    ended: Instant,
    took: Duration,
    verdict: Verdict,
}

impl Readiness {
    /// Errs with what hinders the farm.
    pub(crate) async fn check(&self, store: &Arc<dyn FarmStore>, storage: &Storage) -> Result<()> {
        let (of_probe, of_farm) = (store.clone(), storage.clone());
        let write = async move { of_probe.probe().await.map_err(|error| told(&error.into())) };
        let read = async { store.look(&[], 1).await.is_ok() };
        let put = async move { of_farm.probe().await.map_err(|error| told(&error)) };
        let stored = self.chunks.outcome(PROBE_WITHIN, ended("chunk store", PROBE_ENDS_AFTER, put));
        let (database, stored) = tokio::join!(self.database(write, read), stored);
        database.map_err(not_ready)?;
        stored.unwrap_or_else(|| Err(silence("chunk store"))).map_err(not_ready)?;
        if self.is_due() {
            self.examination.outcome(EXAMINE_WITHIN, examine(store.clone(), self.examined.clone())).await;
        }
        let examined = lock(&self.examined).as_ref().map(|examined| examined.verdict.clone());
        examined.unwrap_or(Ok(())).map_err(not_ready)
    }

    /// Whether the database works: it is written, or was lately and is read.
    async fn database(
        &self,
        write: impl Future<Output = Verdict> + Send + 'static,
        read: impl Future<Output = bool>,
    ) -> Verdict {
        const DATABASE: &str = "database";
        let noted = self.written.clone();
        let write = async move {
            let verdict = write.await;
            if verdict.is_ok() {
                *lock(&noted) = Some(Instant::now());
            }
            verdict
        };
        let written = self.database.outcome(PROBE_WITHIN, ended(DATABASE, PROBE_ENDS_AFTER, write)).await;
        match written.unwrap_or_else(|| Err(silence(DATABASE))) {
            Err(fault) if fault.is_silence && self.was_written_lately() => {
                let is_read = tokio::time::timeout(READ_WITHIN, read).await.unwrap_or(false);
                if is_read { Ok(()) } else { Err(fault) }
            }
            verdict => verdict,
        }
    }

    fn was_written_lately(&self) -> bool {
        lock(&self.written).is_some_and(|written| written.elapsed() < WRITTEN_WITHIN)
    }

    fn is_due(&self) -> bool {
        let (least, times) = EXAMINE_AFTER;
        let is_due = |examined: &Examined| examined.ended.elapsed() >= least.max(times * examined.took);
        lock(&self.examined).as_ref().is_none_or(is_due)
    }
}

/// Reads the database, and notes whether it is damaged. One that does not answer is the probe's matter.
async fn examine(store: Arc<dyn FarmStore>, examined: Arc<Mutex<Option<Examined>>>) -> Verdict {
    let began = Instant::now();
    let verdict = match store.examine().await {
        Err(error @ StoreError::Corrupt { .. }) => Err(told(&error.into())),
        _ => Ok(()),
    };
    let noted = Examined { ended: Instant::now(), took: began.elapsed(), verdict: verdict.clone() };
    *lock(&examined) = Some(noted);
    verdict
}

/// The work, which ends in silence when it takes too long.
async fn ended(place: &'static str, within: Duration, work: impl Future<Output = Verdict>) -> Verdict {
    tokio::time::timeout(within, work).await.unwrap_or_else(|_| Err(silence(place)))
}

fn told(error: &ServerError) -> Fault {
    tracing::error!(error = error.chain(), "the farm is not ready");
    let is_full = error.code() == lightkiln_proto::problem::ProblemCode::StorageFull;
    Fault { why: error.to_string(), is_full, is_silence: false }
}

fn silence(place: &str) -> Fault {
    let millis = PROBE_WITHIN.as_millis();
    let why = format!("the farm's {place} did not answer within {millis} ms");
    Fault { why, is_full: false, is_silence: true }
}

fn not_ready(Fault { why, is_full, .. }: Fault) -> ServerError {
    ServerError::NotReady { why, is_full }
}

/// Work that several callers wait for, and that goes on without them.
#[derive(Default)]
struct Flight(Mutex<Option<watch::Receiver<Option<Verdict>>>>);

impl Flight {
    /// Outcome of the work under way, or of `work` if there is none; nothing if it takes longer than that.
    async fn outcome(
        &self,
        within: Duration,
        work: impl Future<Output = Verdict> + Send + 'static,
    ) -> Option<Verdict> {
        let mut landed = self.join(work);
        let landed = tokio::time::timeout(within, landed.wait_for(Option::is_some)).await;
        landed.ok()?.ok()?.clone()
    }

    fn join(&self, work: impl Future<Output = Verdict> + Send + 'static) -> watch::Receiver<Option<Verdict>> {
        let mut under_way = lock(&self.0);
        // A sender that is gone left no verdict: its work panicked.
        let is_flying = |landed: &&watch::Receiver<Option<Verdict>>| {
            landed.borrow().is_none() && landed.has_changed().is_ok()
        };
        if let Some(landed) = under_way.as_ref().filter(is_flying) {
            return landed.clone();
        }
        let (land, landed) = watch::channel(None);
        tokio::spawn(async move {
            let verdict = work.await;
            land.send_replace(Some(verdict));
        });
        *under_way = Some(landed.clone());
        landed
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::future::{pending, ready};
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[tokio::test]
    async fn lock_that_others_hold_makes_nothing_unready_and_a_database_that_hangs_does() {
        let silent = Err(silence("database"));
        let readiness = Readiness::default();
        assert_eq!(readiness.database(pending(), ready(true)).await, silent, "it was never written");
        let readiness = Readiness::default();
        assert_eq!(readiness.database(ready(Ok(())), pending()).await, Ok(()));
        assert_eq!(readiness.database(pending(), ready(true)).await, Ok(()), "it can be read");
        assert_eq!(readiness.database(pending(), ready(false)).await, silent);
        *lock(&readiness.written) = Instant::now().checked_sub(WRITTEN_WITHIN);
        assert_eq!(readiness.database(pending(), ready(true)).await, silent, "that was long ago");
    }

    #[tokio::test]
    async fn fault_that_the_database_tells_is_no_silence() {
        let readiness = Readiness::default();
        *lock(&readiness.written) = Some(Instant::now());
        let fault = Fault { why: "it is full".to_owned(), is_full: true, is_silence: false };
        assert_eq!(readiness.database(ready(Err(fault.clone())), ready(true)).await, Err(fault));
    }

    #[tokio::test]
    async fn look_that_hangs_ends_by_itself() {
        let ends = ended("database", Duration::from_millis(5), pending()).await;
        assert_eq!(ends, Err(silence("database")));
    }

    #[tokio::test]
    async fn work_that_hangs_is_begun_once_however_many_ask_and_its_end_is_heard() {
        let (flight, begun) = (Flight::default(), Arc::new(AtomicU32::new(0)));
        let (end, ended) = watch::channel(false);
        let work = || {
            let (begun, mut ended) = (begun.clone(), ended.clone());
            async move {
                begun.fetch_add(1, Ordering::Relaxed);
                let _ = ended.wait_for(|ended| *ended).await;
                Ok(())
            }
        };
        for _ in 0..5 {
            assert_eq!(flight.outcome(Duration::from_millis(5), work()).await, None);
        }
        assert_eq!(begun.load(Ordering::Relaxed), 1);
        end.send_replace(true);
        assert_eq!(flight.outcome(Duration::from_secs(60), work()).await, Some(Ok(())));
        assert_eq!(flight.outcome(Duration::from_secs(60), work()).await, Some(Ok(())));
        assert_eq!(begun.load(Ordering::Relaxed), 2, "an outcome is no answer to a later question");
    }
}
