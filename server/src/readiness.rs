//! Whether the farm can work, told within a second whatever its database and its chunk store do.
//!
//! Looks go on when nobody waits for them any more, and whoever asks meanwhile joins the one under way: a database that
//! hangs is asked once, not by every probe of every load balancer.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::error::{Result, ServerError};
use crate::storage::Storage;
use crate::store::{FarmStore, StoreError};

/// Time in which the database must be written, and the chunk store written and read.
const PROBE_WITHIN: Duration = Duration::from_millis(700);
/// Time that is waited for an examination of the database; its outcome counts later if it takes longer.
const EXAMINE_WITHIN: Duration = Duration::from_millis(200);
/// The database is examined again after this time, or after as many times as long as it took. Shorter → damage is known
/// sooner, at more load.
const EXAMINE_AFTER: (Duration, u32) = (Duration::from_secs(1), 50);

/// Fault that makes a farm unready, in words, and whether that is a full disk.
type Verdict = std::result::Result<(), (String, bool)>;

/// Looks at the farm.
#[derive(Default)]
pub(crate) struct Readiness {
    probe: Flight,
    examination: Flight,
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
        let probe = async move {
            let probed = async {
                of_probe.probe().await?;
                of_farm.probe().await
            };
            probed.await.map_err(|error| told(&error))
        };
        let probed = self.probe.outcome(PROBE_WITHIN, probe).await;
        probed.unwrap_or_else(|| Err(silence())).map_err(not_ready)?;
        if self.is_due() {
            self.examination.outcome(EXAMINE_WITHIN, examine(store.clone(), self.examined.clone())).await;
        }
        let examined = lock(&self.examined).as_ref().map(|examined| examined.verdict.clone());
        examined.unwrap_or(Ok(())).map_err(not_ready)
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

fn told(error: &ServerError) -> (String, bool) {
    tracing::error!(error = error.chain(), "the farm is not ready");
    (error.to_string(), error.code() == lightkiln_proto::problem::ProblemCode::StorageFull)
}

fn silence() -> (String, bool) {
    let millis = PROBE_WITHIN.as_millis();
    (format!("the farm's database, or its chunk store, did not answer within {millis} ms"), false)
}

fn not_ready((why, is_full): (String, bool)) -> ServerError {
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
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

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
