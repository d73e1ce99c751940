//! A task's progress, the rays that it has cast, and whether it should stop.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use thiserror::Error;

use crate::rays::{RayCount, counted};

/// The task was given up because its lease or bake is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the task was cancelled")]
pub struct Cancelled;

/// Shared by the threads of a task and its heartbeat. Every method may be called from any thread.
///
/// A task has steps, each with a span of the whole (0..=1) and a count of units; all orders are relaxed, as nothing
/// but display and an early stop hangs on them.
#[derive(Debug, Default)]
pub struct Progress {
    step_from: AtomicU32,
    step_to: AtomicU32,
    units_total: AtomicU64,
    units_done: AtomicU64,
    rays_closest: AtomicU64,
    rays_occlusion: AtomicU64,
    rays_linking: AtomicU64,
    cancelled: AtomicBool,
    /// Calls of [`check`](Self::check), and the one at which the task is cancelled, if any.
    #[cfg(test)]
    checks: AtomicU64,
    #[cfg(test)]
    cancelled_at: AtomicU64,
}

impl Progress {
    /// Nothing done.
    pub fn new() -> Self {
        Self::default()
    }

    /// Starts a step that takes the task from share `from` to share `to` in `units` calls' worth of [`advance`](Self::advance).
    pub fn begin(&self, from: f32, to: f32, units: u64) {
        self.units_done.store(0, Ordering::Relaxed);
        self.units_total.store(units, Ordering::Relaxed);
        self.step_from.store(from.to_bits(), Ordering::Relaxed);
        self.step_to.store(to.to_bits(), Ordering::Relaxed);
    }

    /// `units` more of the step are done.
    pub fn advance(&self, units: u64) {
        self.units_done.fetch_add(units, Ordering::Relaxed);
    }

    /// Share of the task that is done, 0..=1.
    pub fn share(&self) -> f32 {
        let from = f32::from_bits(self.step_from.load(Ordering::Relaxed));
        let to = f32::from_bits(self.step_to.load(Ordering::Relaxed));
        let total = self.units_total.load(Ordering::Relaxed).max(1);
        let done = self.units_done.load(Ordering::Relaxed).min(total);
        (from + (to - from) * (done as f64 / total as f64) as f32).clamp(0.0, 1.0)
    }

    /// Does work of one thread, and counts the rays that it casts.
    pub fn casting<T>(&self, work: impl FnOnce() -> T) -> T {
        let (done, cast) = counted(work);
        self.rays_closest.fetch_add(cast.closest, Ordering::Relaxed);
        self.rays_occlusion.fetch_add(cast.occlusion, Ordering::Relaxed);
        self.rays_linking.fetch_add(cast.linking, Ordering::Relaxed);
        done
    }

    /// Rays cast so far.
    pub fn rays(&self) -> RayCount {
        RayCount {
            closest: self.rays_closest.load(Ordering::Relaxed),
            occlusion: self.rays_occlusion.load(Ordering::Relaxed),
            linking: self.rays_linking.load(Ordering::Relaxed),
        }
    }

    /// Asks the task to stop at its next [`check`](Self::check).
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Whether the task was asked to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// Errors once the task was asked to stop. Call it at least every hundred milliseconds or so of work.
    pub fn check(&self) -> Result<(), Cancelled> {
        #[cfg(test)]
        if self.checks.fetch_add(1, Ordering::Relaxed) + 1 == self.cancelled_at.load(Ordering::Relaxed) {
            self.cancel();
        }
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}

#[cfg(test)]
impl Progress {
    /// Nothing done; the `check`th look for a cancel finds one.
    pub fn cancelled_at(check: u64) -> Self {
        Self { cancelled_at: AtomicU64::new(check), ..Self::default() }
    }

    /// Looks for a cancel so far.
    pub fn checks(&self) -> u64 {
        self.checks.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_runs_through_the_span_of_the_step_and_no_further() {
        let progress = Progress::new();
        assert_eq!(progress.share(), 0.0);
        progress.begin(0.5, 1.0, 4);
        progress.advance(2);
        assert_eq!(progress.share(), 0.75);
        progress.advance(99);
        assert_eq!(progress.share(), 1.0);
        progress.begin(0.2, 0.2, 0);
        assert_eq!(progress.share(), 0.2);
    }

    #[test]
    fn check_fails_from_cancel_on() {
        let progress = Progress::new();
        assert_eq!(progress.check(), Ok(()));
        progress.cancel();
        assert_eq!(progress.check(), Err(Cancelled));
    }
}
