//! A worker begins tasks where there is memory for them, and waits with a word where there is not.

use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lightkiln_http::{Level, ShutdownFlag};

use super::memory::{Exhausted, LOOK_EVERY, News};
use super::{Worker, WorkerError};

/// Time for which a worker without a task waits for memory, before it ends, where most of that is its own: its next start begins with
/// none taken.
const OWN_PATIENCE: Duration = Duration::from_secs(5);
/// The same where others have most of it, and its end would help them.
const SHARED_PATIENCE: Duration = Duration::from_secs(60);
/// Longest time without a look whether a task may begin; those that end tell.
const LOOK_AGAIN_EVERY: Duration = Duration::from_secs(5);

impl Worker {
    /// The memory that the worker waits for, in words, as long as it begins no task for want of it.
    pub fn waits_for_memory(&self) -> Option<String> {
        self.waits_for_memory.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Looks at the memory until all tasks have ended.
    pub(super) fn watch_memory(&self, has_ended: &AtomicBool, shutdown: &ShutdownFlag) {
        let mut noted = None;
        while !has_ended.load(Ordering::Acquire) {
            self.look_at_memory(shutdown);
            let signs = self.memory_watch.signs();
            if let Some(seat) = self.config.seat.as_ref().filter(|_| noted.as_ref() != Some(&signs)) {
                seat.note_memory(signs.clone());
                noted = Some(signs);
            }
            shutdown.wait(LOOK_EVERY, |_| has_ended.load(Ordering::Acquire));
        }
    }

    /// Looks once. Before a limit counts as reached, the cache lets go of all that no task has in use.
    pub(super) fn look_at_memory(&self, shutdown: &ShutdownFlag) {
        let news = self.memory_watch.look(&self.in_hand, || {
            let mib = self.memory.bytes() >> 20;
            self.memory.clear();
            if mib > 0 {
                tracing::info!(mib, "memory is used up: decoded artefacts are dropped");
            }
        });
        if matches!(news, News::Exhausted { tasks: 2.. }) {
            self.crowd.squeeze();
        }
        if news != News::Nothing {
            // Those who keep leases, or wait for memory, look at it.
            shutdown.wake();
        }
    }

    /// Waits until a task may be begun; false when the worker is to end. Errors if memory does not come free without any task.
    pub(super) fn wait_for_room(&self, shutdown: &ShutdownFlag) -> Result<bool, WorkerError> {
        if shutdown.level() == Level::Run {
            self.wait_for_memory(shutdown)?;
            self.wait_for_place(shutdown);
        }
        Ok(shutdown.level() == Level::Run)
    }

    /// Begins nothing while memory is used up, whoever has it.
    fn wait_for_memory(&self, shutdown: &ShutdownFlag) -> Result<(), WorkerError> {
        let Some(exhausted) = self.memory_watch.exhausted() else { return Ok(()) };
        let (words, began) = (exhausted.words(), Instant::now());
        tracing::warn!(memory = words, "no task is begun until memory comes free");
        self.tell_of_wait(Some(words));
        let waited = self.wait_until_free(shutdown);
        self.tell_of_wait(None);
        if waited.is_err() {
            // Before another thread begins to wait.
            shutdown.raise(Level::Drain);
        }
        if waited.is_ok() && !self.memory_watch.is_exhausted() {
            tracing::warn!(
                waited_secs = began.elapsed().as_secs_f64(),
                "memory is free again; tasks are begun"
            );
        }
        waited
    }

    fn wait_until_free(&self, shutdown: &ShutdownFlag) -> Result<(), WorkerError> {
        let mut idle_since = None;
        while shutdown.level() == Level::Run
            && let Some(exhausted) = self.memory_watch.exhausted()
        {
            // Tasks that were told to stop are still letting go of theirs.
            if self.in_hand.load(Ordering::Acquire) > 0 {
                idle_since = None;
            } else {
                let idle = idle_since.get_or_insert_with(Instant::now).elapsed();
                if patience(&exhausted, self.config.memory_patience).is_some_and(|longest| idle >= longest) {
                    let (seen, is_own) = (exhausted.words(), exhausted.is_much());
                    return Err(WorkerError::Memory { seen, is_own });
                }
            }
            shutdown.wait(LOOK_EVERY, |level| level > Level::Run || !self.memory_watch.is_exhausted());
        }
        Ok(())
    }

    /// Whether a task may be begun at once.
    pub(super) fn has_room(&self) -> bool {
        !self.memory_watch.is_exhausted() && self.places() > 0
    }

    /// Tasks that may be begun beside those in hand.
    pub(super) fn places(&self) -> usize {
        self.crowd.allowed().saturating_sub(self.in_hand.load(Ordering::Acquire))
    }

    /// Waits until fewer tasks are in hand than may be.
    fn wait_for_place(&self, shutdown: &ShutdownFlag) {
        let has_place = || self.places() > 0;
        while shutdown.level() == Level::Run && !has_place() {
            shutdown.wait(LOOK_AGAIN_EVERY, |level| level > Level::Run || has_place());
        }
    }

    fn tell_of_wait(&self, words: Option<String>) {
        *self.waits_for_memory.lock().unwrap_or_else(PoisonError::into_inner) = words;
    }
}

/// Time for which a worker without a task waits for memory; `of_others` where its end would help nobody.
fn patience(exhausted: &Exhausted, of_others: Option<Duration>) -> Option<Duration> {
    match (exhausted.is_own(), exhausted.is_much()) {
        (true, _) => Some(OWN_PATIENCE),
        (_, true) => Some(SHARED_PATIENCE),
        _ => of_others,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::super::memory::MemoryWatch;
    use super::super::memory::tests::{Script, machine};
    use super::*;

    #[test]
    fn worker_that_has_the_memory_ends_soon_and_one_that_has_none_as_it_was_told() {
        let of = |own_mib: u64, of_others: Option<Duration>| {
            let watch = MemoryWatch::new(None, Script::new(move || machine(true, own_mib)));
            watch.look(&AtomicUsize::new(0), || ());
            patience(&watch.exhausted().unwrap(), of_others)
        };
        assert_eq!(of(3000, None), Some(OWN_PATIENCE));
        // Two workers that have half of it each and nothing to do do not wait for each other.
        assert_eq!(of(1900, None), Some(SHARED_PATIENCE));
        assert_eq!(of(100, None), None);
        assert_eq!(of(100, Some(Duration::ZERO)), Some(Duration::ZERO));
    }
}
