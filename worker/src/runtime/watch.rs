//! Keeps a lease while its task runs, and tells the task to stop when the server, or whoever ends this worker, says so.

use std::cell::Cell;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lightkiln_http::{CallError, FOREVER, Level, ShutdownFlag, retry};
use lightkiln_proto::api::{Blame, Failure, Verdict};

use super::aside::Aside;
use super::farm::Farm;
use super::memory::{Exhausted, MemoryWatch};
use super::store::LeaseStore;
use crate::task::Progress;

/// Most characters of a failure message.
const MESSAGE_CHARS_MAX: usize = 4000;

/// Longer than any heartbeat takes; it ends by its own timeout first.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Longest time for which a worker that is to end goes on saying so. Longer → more tasks need not wait for their leases' end when the
/// server is away for a moment; a worker ends within this time and the grace of its tasks.
const FAREWELL: Duration = Duration::from_secs(5);

/// Pause after a heartbeat without an answer: a lease has time for several tries.
pub(super) const RETRY_WAIT: Duration = Duration::from_secs(1);

/// Heartbeats of the length of a lease.
pub(super) const LEASE_INTERVALS: u32 = 3;

/// Why a task was told to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StopReason {
    /// The lease is gone; a result would be refused.
    Lost,
    /// The bake was cancelled.
    Cancelled,
    /// This worker is being shut down.
    Drained,
    /// Memory is used up; the failure was reported, with that blame.
    Exhausted(Blame),
}

/// One lease under watch; [`run`](Self::run) on a thread of its own until [`finish`](Self::finish).
pub(super) struct LeaseWatch<'a> {
    pub(super) farm: &'a Farm,
    pub(super) token: &'a str,
    /// Time between heartbeats.
    pub(super) interval: Duration,
    /// Time that a task may still take once draining began.
    pub(super) grace: Duration,
    pub(super) progress: &'a Progress,
    pub(super) memory: &'a MemoryWatch,
    pub(super) shutdown: &'a ShutdownFlag,
    pub(super) finished: AtomicBool,
    pub(super) stop: Mutex<Option<StopReason>>,
}

/// Time for which a worker goes on saying how an attempt ended.
pub(super) struct LastWords<'a> {
    shutdown: &'a ShutdownFlag,
    until: Cell<Instant>,
    /// The worker is to end.
    is_last: Cell<bool>,
}

impl<'a> LastWords<'a> {
    pub(super) fn lasting(shutdown: &'a ShutdownFlag, time: Duration) -> Self {
        Self { shutdown, until: Cell::new(Instant::now() + time), is_last: Cell::new(false) }
    }

    /// Time that is left, less once the worker is to end; and the level that was seen.
    fn left(&self) -> (Duration, Level) {
        let (now, level) = (Instant::now(), self.shutdown.level());
        if level > Level::Run && !self.is_last.replace(true) {
            self.until.set(self.until.get().min(now + FAREWELL));
        }
        (self.until.get().saturating_duration_since(now), level)
    }

    /// Waits before the next try; false when there is to be none.
    fn wait(&self, wait: Duration) -> bool {
        let (left, seen) = self.left();
        let changed = |level| level == Level::Stop || level != seen;
        !left.is_zero() && self.shutdown.wait(wait.min(left), changed) < Level::Stop
    }

    /// Makes a call while there is time, as long as which its answer is waited for.
    fn call(&self, call: impl FnOnce() -> Result<(), CallError> + Send + 'static) -> Result<(), CallError> {
        if self.left().0.is_zero() {
            return Err(CallError::Stopped);
        }
        let aside = Aside::begin(self.shutdown, call);
        loop {
            let (left, seen) = self.left();
            match aside.wait(left, |level| level != seen) {
                Some(answer) => return answer,
                None if left.is_zero() => return Err(CallError::Stopped),
                None => {}
            }
        }
    }
}

impl LeaseWatch<'_> {
    /// From now on, for as long as a lease lasts: the server may have heard the last heartbeat a moment ago.
    pub(super) fn last_words(&self) -> LastWords<'_> {
        LastWords::lasting(self.shutdown, LEASE_INTERVALS * self.interval)
    }

    /// Sends heartbeats until the lease is finished with.
    pub(super) fn run(&self) {
        let mut next_beat = Instant::now() + self.interval;
        let mut drain_deadline = None;
        while !self.finished.load(Ordering::Acquire) {
            if self.stop_reason().is_none()
                && let Some(exhausted) = self.memory.exhausted()
            {
                self.stop(StopReason::Exhausted(exhausted.blame()));
                // Said from here, as the task may take its time to stop, and the kernel none.
                report_exhausted(self, &exhausted);
            }
            let seen = self.shutdown.level();
            if seen == Level::Stop {
                self.stop(StopReason::Drained);
            } else if seen == Level::Drain {
                let deadline = *drain_deadline.get_or_insert_with(|| Instant::now() + self.grace);
                if Instant::now() >= deadline {
                    self.stop(StopReason::Drained);
                }
            }
            let wake_at = match (drain_deadline, self.stop_reason()) {
                (Some(deadline), None) => next_beat.min(deadline),
                _ => next_beat,
            };
            let nap = wake_at.saturating_duration_since(Instant::now());
            let is_over = || self.stop_reason().is_none() && self.memory.is_exhausted();
            self.shutdown
                .wait(nap, |level| level != seen || self.finished.load(Ordering::Acquire) || is_over());
            if Instant::now() >= next_beat && !self.finished.load(Ordering::Acquire) {
                let until = drain_deadline.filter(|_| self.stop_reason().is_none());
                next_beat = Instant::now() + self.beat(until);
            }
        }
    }

    /// Ends the watch; nothing more is sent for the lease.
    pub(super) fn finish(&self) {
        self.finished.store(true, Ordering::Release);
        self.shutdown.wake();
    }

    /// Why the task was told to stop, if it was.
    pub(super) fn stop_reason(&self) -> Option<StopReason> {
        *self.stop.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the server that the lease has arrived, until it has heard that. If a worker ends before, or never got the
    /// answer to its claim, nothing was attempted, and the server counts no attempt.
    ///
    /// A lease that is gone by then, as the answer took that long, stops the task before it starts. An answer is waited for as long as
    /// it may say anything: behind a slow line none comes before the next heartbeat would be due, and the task would never start.
    pub(super) fn acknowledge(&self, store: &LeaseStore<'_>) -> Result<(), CallError> {
        let lease = LEASE_INTERVALS * self.interval;
        let token = self.token.to_owned();
        let answer = store.insist(move |farm| farm.heartbeat(&token, 0.0, lease))?;
        self.heed(answer.verdict);
        self.progress.check().map_err(|_| CallError::Stopped)
    }

    /// Sends a heartbeat and heeds the answer, which is not waited for beyond `until`; gives the time until the next one.
    pub(super) fn beat(&self, until: Option<Instant>) -> Duration {
        let (farm, token, interval) = (self.farm.clone(), self.token.to_owned(), self.interval);
        let (share, seen) = (self.progress.share(), self.shutdown.level());
        let aside = Aside::begin(self.shutdown, move || farm.heartbeat(&token, share, interval));
        let left = until.map_or(PATIENCE, |until| until.saturating_duration_since(Instant::now()));
        let is_over = |level| level != seen || self.finished.load(Ordering::Acquire);
        match aside.wait(left, is_over) {
            Some(Ok(answer)) => {
                self.heed(answer.verdict);
                return self.interval;
            }
            // The work goes on: if the lease outlives the outage the result counts, else the server refuses it.
            Some(Err(error)) => tracing::warn!(%error, "a heartbeat found no answer"),
            // There is more to see to than that answer.
            None => {}
        }
        RETRY_WAIT.min(self.interval)
    }

    fn heed(&self, verdict: Verdict) {
        match verdict {
            Verdict::Keep => {}
            Verdict::Cancel => self.stop(StopReason::Cancelled),
            Verdict::Lost => self.stop(StopReason::Lost),
        }
    }

    /// Tells the task to stop; a lost lease overrides any other reason, as it forbids even a release.
    fn stop(&self, reason: StopReason) {
        let mut stop = self.stop.lock().unwrap_or_else(PoisonError::into_inner);
        if stop.is_none() || reason == StopReason::Lost {
            *stop = Some(reason);
        }
        drop(stop);
        self.progress.cancel();
        self.shutdown.wake();
    }
}

/// Fails a lease at once, as memory is used up: whoever has its task may be ended before it has stopped.
fn report_exhausted(watch: &LeaseWatch<'_>, exhausted: &Exhausted) {
    let failure = Failure { blame: exhausted.blame(), message: cut(&exhausted_message(exhausted)) };
    tracing::error!(failure.message, "a task failed");
    let token = watch.token.to_owned();
    tell("failure", watch.farm, &watch.last_words(), move |farm| farm.fail(&token, &failure));
}

fn exhausted_message(exhausted: &Exhausted) -> String {
    let (words, tasks) = (exhausted.words(), exhausted.tasks);
    let (had, remedy) = match (exhausted.is_own(), tasks) {
        (false, _) => ("the task", "close other programs there, give its machine more"),
        (true, 0 | 1) => ("the task", "give its workers more, fewer tasks at a time (--tasks)"),
        (true, _) => ("several tasks", "give its workers more, fewer tasks at a time (--tasks)"),
    };
    format!(
        "out of memory: {words} while the worker had {had}; {remedy}, or bakes that need it a worker that has it (--needs-memory-mib)"
    )
}

/// Makes a report until it is heard. It is given up when the lease has surely run out, or nobody may wait any more: then
/// the server finds out by itself, and counts an attempt.
pub(super) fn tell(
    what: &str,
    farm: &Farm,
    patience: &LastWords<'_>,
    call: impl Fn(&Farm) -> Result<(), CallError> + Clone + Send + 'static,
) {
    let once = || {
        let (farm, call) = (farm.clone(), call.clone());
        patience.call(move || call(&farm))
    };
    let pause = |error: &CallError, wait| {
        tracing::warn!(%error, "a {what} could not be reported yet");
        if patience.wait(wait) { Ok(()) } else { Err(CallError::Stopped) }
    };
    // At once a second time: a connection that was kept open may have been closed meanwhile.
    if let Err(error) = once().or_else(|_| retry(FOREVER, once, pause)) {
        tracing::warn!(%error, "a {what} could not be reported; the lease will run out instead");
    }
}

/// As much of a message as a server keeps; U+0000 would be refused.
pub(super) fn cut(text: &str) -> String {
    let kept = text.chars().take(MESSAGE_CHARS_MAX);
    kept.map(|c| if c == '\0' { char::REPLACEMENT_CHARACTER } else { c }).collect()
}
