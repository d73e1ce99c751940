//! A bake's progress for people: a bar on a terminal, plain lines elsewhere; always on standard error.

pub mod estimate;
pub mod line;
#[cfg(test)]
mod tests;
mod tracker;

use std::io::{IsTerminal as _, stderr};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use lightkiln_proto::api::{Bake, BakeEvent, EventKind};

use crate::console::say;
use line::line;
use tracker::Tracker;

/// Time between plain lines of one stage.
const LINE_INTERVAL: Duration = Duration::from_secs(10);
/// Steps of the bar.
const BAR_STEPS: u64 = 1000;

/// Shows one bake's progress.
pub struct ProgressView {
    tracker: Tracker,
    output: Output,
}

enum Output {
    Bar(ProgressBar),
    Lines { stage: String, next_line: Instant },
}

impl ProgressView {
    /// A bar if standard error is a terminal, else lines.
    pub fn new() -> Self {
        let now = Instant::now();
        let output = if stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(BAR_STEPS), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{spinner} [{bar:14}] {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.enable_steady_tick(Duration::from_millis(200));
            Output::Bar(bar)
        } else {
            Output::Lines { stage: String::new(), next_line: now }
        };
        Self { tracker: Tracker::new(now), output }
    }

    /// Shows where the bake stands now, and what went wrong since the last call.
    pub fn update(&mut self, bake: &Bake, events: &[BakeEvent]) {
        for event in events {
            if let Some(line) = trouble(&event.event) {
                self.say(&line);
            }
        }
        let now = Instant::now();
        let snapshot = self.tracker.observe(bake, now);
        match &mut self.output {
            Output::Bar(bar) => {
                bar.set_position((snapshot.estimate.share * BAR_STEPS as f64) as u64);
                bar.set_message(line(&snapshot));
            }
            Output::Lines { stage, next_line } => {
                if *stage != snapshot.stage || now >= *next_line {
                    say!("{}", line(&snapshot));
                    stage.clone_from(&snapshot.stage);
                    *next_line = now + LINE_INTERVAL;
                }
            }
        }
    }

    /// Prints a line without disturbing the bar.
    pub fn say(&self, line: &str) {
        match &self.output {
            Output::Bar(bar) => bar.suspend(|| say!("{line}")),
            Output::Lines { .. } => say!("{line}"),
        }
    }
}

/// Nothing of the bar stays behind, however the command ends.
impl Drop for ProgressView {
    fn drop(&mut self) {
        if let Output::Bar(bar) = &self.output {
            bar.finish_and_clear();
        }
    }
}

/// An event that people should hear of at once, in words.
fn trouble(event: &EventKind) -> Option<String> {
    match event {
        EventKind::TaskFailed { label, kind, worker, message, retry: true, .. } => {
            Some(format!("{label} ({kind}) failed on worker {worker} and will be tried again: {message}"))
        }
        EventKind::LeaseExpired { label, kind, worker, took_too_long: false, .. } => {
            Some(format!("worker {worker} was not heard from in time; {label} ({kind}) goes to another"))
        }
        EventKind::LeaseExpired { label, kind, worker, took_too_long: true, .. } => {
            Some(format!("worker {worker} took too long; {label} ({kind}) goes to another"))
        }
        EventKind::ResultLost { label, kind, .. } => {
            Some(format!("the result of {label} ({kind}) was lost; it runs again"))
        }
        EventKind::ResultDiffers { label, kind, output, .. } => Some(format!(
            "{label} ({kind}) gave other bytes in another attempt (output '{output}'): a machine of the farm is not to be trusted, or \
             the code of the task; see kiln logs"
        )),
        // A failure for good is the bake's own, told when the command ends.
        EventKind::TaskFailed { retry: false, .. }
        | EventKind::Submitted
        | EventKind::Planned { .. }
        | EventKind::TaskStarted { .. }
        | EventKind::TaskReleased { .. }
        | EventKind::TaskDone { .. }
        | EventKind::State { .. } => None,
    }
}
