//! What has happened in this process, and the text that Prometheus reads.

use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::store::Stats;

/// A number that only grows.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Adds to it.
    pub fn add(&self, count: u64) {
        self.0.fetch_add(count, Ordering::Relaxed);
    }

    /// Reads it.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Counts since this process started.
#[derive(Debug, Default)]
pub struct Metrics {
    /// Bakes taken in.
    pub submissions: Counter,
    /// Tasks handed out.
    pub claims: Counter,
    /// Results taken in.
    pub commits: Counter,
    /// Results refused because their lease was gone.
    pub stale_commits: Counter,
    /// Attempts that a worker reported as failed.
    pub failures: Counter,
    /// Leases given back.
    pub releases: Counter,
    /// Leases that ran out.
    pub expiries: Counter,
    /// Results forgotten because their bytes were gone.
    pub forgotten_results: Counter,
    /// Bakes deleted because they ended long ago.
    pub deleted_bakes: Counter,
    /// Chunks removed because nobody needed them.
    pub removed_chunks: Counter,
    /// Bytes of chunks and scenes taken in.
    pub bytes_in: Counter,
}

/// The Prometheus text: process counts, and the farm's figures from the store.
pub fn render(metrics: &Metrics, farm: &Stats) -> String {
    let mut text = String::new();
    let counters = [
        ("submissions", "Bakes taken in by this process.", &metrics.submissions),
        ("claims", "Tasks handed out by this process.", &metrics.claims),
        ("commits", "Results taken in by this process.", &metrics.commits),
        ("stale_commits", "Results refused because their lease was gone.", &metrics.stale_commits),
        ("failures", "Attempts that a worker reported as failed.", &metrics.failures),
        ("releases", "Leases given back by workers.", &metrics.releases),
        ("expiries", "Leases that ran out.", &metrics.expiries),
        ("forgotten_results", "Results forgotten because their bytes were gone.", &metrics.forgotten_results),
        ("deleted_bakes", "Bakes deleted because they ended long ago.", &metrics.deleted_bakes),
        ("removed_chunks", "Chunks removed because nobody needed them.", &metrics.removed_chunks),
        ("received_bytes", "Bytes of chunks and scenes taken in.", &metrics.bytes_in),
    ];
    for (name, help, counter) in counters {
        single(&mut text, &format!("lightkiln_{name}_total"), "counter", help, counter.get());
    }
    single(&mut text, "lightkiln_bakes_live", "gauge", "Bakes running or paused.", farm.bakes_live);
    single(&mut text, "lightkiln_bakes", "gauge", "Bakes ever submitted to the farm.", farm.bakes_total);
    single(&mut text, "lightkiln_tasks_run", "gauge", "Tasks run, over all bakes.", farm.tasks_run);
    single(&mut text, "lightkiln_tasks_reused", "gauge", "Tasks reused, over all bakes.", farm.tasks_reused);
    head(&mut text, "lightkiln_tasks", "gauge", "Tasks that the farm holds, by kind and state.");
    for count in &farm.tasks {
        let (kind, state) = (escaped(&count.kind), count.state.name());
        line(&mut text, &format!("lightkiln_tasks{{kind=\"{kind}\",state=\"{state}\"}}"), count.count);
    }
    text
}

fn single(text: &mut String, name: &str, kind: &str, help: &str, value: u64) {
    head(text, name, kind, help);
    line(text, name, value);
}

fn head(text: &mut String, name: &str, kind: &str, help: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
}

fn line(text: &mut String, series: &str, value: u64) {
    let _ = writeln!(text, "{series} {value}");
}

fn escaped(label: &str) -> String {
    label.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{TaskCount, TaskState};

    #[test]
    fn text_has_help_type_and_escaped_labels() {
        let metrics = Metrics::default();
        metrics.claims.add(3);
        let count = TaskCount { kind: "a\"b".into(), state: TaskState::Ready, count: 2 };
        let text = render(&metrics, &Stats { tasks: vec![count], ..Stats::default() });
        assert!(text.contains("# TYPE lightkiln_claims_total counter\nlightkiln_claims_total 3\n"), "{text}");
        assert!(text.contains("lightkiln_tasks{kind=\"a\\\"b\",state=\"ready\"} 2\n"), "{text}");
    }
}
