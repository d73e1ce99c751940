//! How many tasks may be in hand: all that the worker is to have, until memory is used up while there are several. Then one at a
//! time, so that tasks which fit alone are done, and one that does not is found; twice as many after each series that went well.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Tasks of the first series; each time that memory is used up by several doubles it.
const FIRST_SERIES: u32 = 8;
/// Tasks of the longest series. Longer → less work is lost where memory is short, and a worker is slower for longer where it is not.
const LONGEST_SERIES: u32 = 512;

#[derive(Debug)]
pub(super) struct Crowd {
    most: usize,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    allowed: usize,
    /// Tasks done since that changed.
    done: u32,
    /// Tasks to be done before it rises.
    series: u32,
}

impl Crowd {
    /// So many tasks, at least one.
    pub(super) fn new(most: usize) -> Self {
        let most = most.max(1);
        Self { most, state: Mutex::new(State { allowed: most, done: 0, series: FIRST_SERIES / 2 }) }
    }

    /// Tasks that may be in hand.
    pub(super) fn allowed(&self) -> usize {
        self.lock().allowed
    }

    /// Memory was used up while several tasks were in hand.
    pub(super) fn squeeze(&self) {
        let mut state = self.lock();
        let series = (2 * state.series).min(LONGEST_SERIES);
        *state = State { allowed: 1, done: 0, series };
        drop(state);
        if self.most > 1 {
            tracing::warn!(
                at_a_time = self.most,
                series,
                "memory was used up by several tasks: one at a time until a series is done"
            );
        }
    }

    /// A task was done.
    pub(super) fn note_done(&self) {
        let mut state = self.lock();
        state.done = state.done.saturating_add(1);
        if state.allowed < self.most && state.done >= state.series {
            state.allowed = (2 * state.allowed).min(self.most);
            state.done = 0;
            tracing::info!(at_a_time = state.allowed, "more tasks at a time, as memory sufficed");
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tasks that may be in hand after each series, until all may.
    fn recovery(crowd: &Crowd) -> Vec<(u32, usize)> {
        let mut steps = Vec::new();
        let mut done = 0;
        while crowd.allowed() < crowd.most {
            let before = crowd.allowed();
            crowd.note_done();
            done += 1;
            if crowd.allowed() != before {
                steps.push((done, crowd.allowed()));
            }
        }
        steps
    }

    #[test]
    fn tasks_that_used_up_memory_together_are_done_one_at_a_time_for_a_while() {
        let crowd = Crowd::new(6);
        crowd.note_done();
        assert_eq!(crowd.allowed(), 6);
        crowd.squeeze();
        assert_eq!(crowd.allowed(), 1);
        assert_eq!(recovery(&crowd), [(8, 2), (16, 4), (24, 6)]);
        // Again and again: less and less of the work is lost to it.
        crowd.squeeze();
        assert_eq!(recovery(&crowd)[0], (16, 2));
        (0..20).for_each(|_| crowd.squeeze());
        assert_eq!(recovery(&crowd)[0], (512, 2));
    }

    #[test]
    fn worker_of_one_task_stays_one() {
        for most in [0, 1] {
            let crowd = Crowd::new(most);
            crowd.squeeze();
            assert_eq!((crowd.allowed(), recovery(&crowd).len()), (1, 0));
        }
    }
}
