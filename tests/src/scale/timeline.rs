//! Figures of a farm's work from the times of its tasks: the same for the model and for a run.

use std::time::Duration;

/// Part of the tasks after whose end the farm counts as warm.
pub const WARM_PART: usize = 4;

/// One task on a worker, since the beginning of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Its first instruction.
    pub begin: Duration,
    /// Its last one, before its result is handed in.
    pub end: Duration,
}

/// A farm while it has more tasks than it can take, and its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Tasks a second, from when a quarter is done until none is left to be taken.
    pub tasks_per_sec: f64,
    /// Share of that time in which the workers' places were at work.
    pub efficiency: f64,
    /// From when none is left to be taken to the last commit.
    pub tail: Duration,
}

/// Beginning and end of the time over which figures are taken: a quarter of the tasks is done; the last one begins. None if that is no
/// time at all: there were too few tasks.
pub fn window(spans: &[Span]) -> Option<(Duration, Duration)> {
    let mut ends: Vec<Duration> = spans.iter().map(|span| span.end).collect();
    ends.sort_unstable();
    let from = *ends.get(ends.len() / WARM_PART)?;
    let to = spans.iter().map(|span| span.begin).max()?;
    (to > from).then_some((from, to))
}

impl Figures {
    /// Of tasks on so many places for tasks; the last commit was at `finished`. None if there were too few tasks.
    pub fn of(spans: &[Span], places: usize, finished: Duration) -> Option<Self> {
        let (from, to) = window(spans)?;
        let secs = (to - from).as_secs_f64();
        let ended = spans.iter().filter(|span| span.end > from && span.end <= to).count();
        let within = |span: &Span| span.end.min(to).saturating_sub(span.begin.max(from)).as_secs_f64();
        let busy: f64 = spans.iter().map(within).sum();
        Some(Self {
            tasks_per_sec: ended as f64 / secs,
            efficiency: busy / (secs * places as f64),
            tail: finished.saturating_sub(to),
        })
    }
}

/// The time that this share of the times is within; zero of none.
pub fn quantile(times: &mut [Duration], share: f64) -> Duration {
    times.sort_unstable();
    let last = times.len().saturating_sub(1);
    times.get((last as f64 * share).round() as usize).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_of_the_time_in_which_there_was_work_for_all() {
        let secs = Duration::from_secs;
        // Two places: one is at work all the time, the other one every second second.
        let mut spans: Vec<Span> = (0..40).map(|s| Span { begin: secs(s), end: secs(s + 1) }).collect();
        spans.extend((0..20).map(|s| Span { begin: secs(2 * s), end: secs(2 * s + 1) }));
        let figures = Figures::of(&spans, 2, secs(45)).unwrap();
        assert!((figures.tasks_per_sec - 1.5).abs() < 0.03, "{figures:?}");
        assert!((figures.efficiency - 0.75).abs() < 0.01, "{figures:?}");
        assert_eq!(figures.tail, secs(6));
        assert_eq!(Figures::of(&spans[..1], 2, secs(45)), None);
    }
}
