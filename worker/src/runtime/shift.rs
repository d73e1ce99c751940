//! How long a worker stays: until it is told to go, for so many tasks, or until there is nothing to do.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// One run of a worker.
pub(super) struct Shift {
    max_tasks: Option<u32>,
    exit_when_idle: Option<Duration>,
    state: Mutex<State>,
}

struct State {
    taken: u32,
    in_hand: u32,
    idle_since: Instant,
}

/// A task in hand.
pub(super) struct InHand<'a>(&'a Shift);

impl Shift {
    pub(super) fn new(max_tasks: Option<u32>, exit_when_idle: Option<Duration>) -> Self {
        let state = State { taken: 0, in_hand: 0, idle_since: Instant::now() };
        Self { max_tasks, exit_when_idle, state: Mutex::new(state) }
    }

    /// Whether as many tasks were taken as there may be.
    pub(super) fn is_full(&self) -> bool {
        self.max_tasks.is_some_and(|max| self.lock().taken >= max)
    }

    /// Tasks to claim at once, if so many were wanted.
    pub(super) fn at_most(&self, wanted: u32) -> u32 {
        self.max_tasks.map_or(wanted, |max| wanted.min(max.saturating_sub(self.lock().taken)))
    }

    /// Whether there was nothing to do for too long; asked once the server has said that there is nothing.
    pub(super) fn is_idle(&self) -> bool {
        self.idle_left().is_some_and(|left| left.is_zero())
    }

    /// Seconds that the server may hold a claim, of so many at most: a worker that goes is not to be late.
    pub(super) fn wait_secs(&self, longest: u32) -> u32 {
        let left = self.idle_left().map(|left| left.as_secs_f64().ceil() as u32);
        left.map_or(longest, |left| left.min(longest))
    }

    /// A task was claimed; it is in hand until the answer is dropped.
    pub(super) fn take(&self) -> InHand<'_> {
        let mut state = self.lock();
        state.taken += 1;
        state.in_hand += 1;
        InHand(self)
    }

    /// Nobody said whether there is something to do.
    pub(super) fn note_silence(&self) {
        self.lock().idle_since = Instant::now();
    }

    /// Time until the worker has been idle for too long; none if it may be, or has a task.
    fn idle_left(&self) -> Option<Duration> {
        let longest = self.exit_when_idle?;
        let state = self.lock();
        (state.in_hand == 0).then(|| longest.saturating_sub(state.idle_since.elapsed()))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for InHand<'_> {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        state.in_hand -= 1;
        state.idle_since = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    #[test]
    fn worker_that_may_stay_is_never_over() {
        let shift = Shift::new(None, None);
        drop(shift.take());
        assert!(!shift.is_full() && !shift.is_idle());
        assert_eq!((shift.wait_secs(20), shift.at_most(4)), (20, 4));
    }

    #[test]
    fn tasks_are_counted_when_they_are_taken() {
        let shift = Shift::new(Some(2), None);
        drop(shift.take());
        assert!(!shift.is_full());
        assert_eq!([1, 4].map(|wanted| shift.at_most(wanted)), [1, 1]);
        let _in_hand = shift.take();
        assert!(shift.is_full() && !shift.is_idle());
    }

    #[test]
    fn time_without_a_task_ends_the_shift_but_for_silence_and_tasks_in_hand() {
        let shift = Shift::new(None, Some(HOUR));
        assert!(!shift.is_idle() && shift.wait_secs(7200) == 3600 && shift.wait_secs(20) == 20);
        let ago = |time: Duration| shift.lock().idle_since = Instant::now().checked_sub(time).unwrap();
        ago(HOUR);
        assert!(shift.is_idle() && shift.wait_secs(20) == 0);
        shift.note_silence();
        assert!(!shift.is_idle());
        ago(HOUR);
        let in_hand = shift.take();
        assert!(!shift.is_idle() && shift.wait_secs(20) == 20);
        drop(in_hand);
        assert!(!shift.is_idle(), "it was busy a moment ago");
        assert!(Shift::new(None, Some(Duration::ZERO)).is_idle());
    }
}
