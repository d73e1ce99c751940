//! What has happened in this process, and the text that Prometheus reads.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use crate::store::Stats;
use crate::store::chunk::Usage;

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
    /// How long requests took.
    pub latencies: Latencies,
}

/// Bounds of the latency histogram's buckets, in seconds.
const BUCKETS_SECS: [f64; 8] = [0.005, 0.025, 0.1, 0.5, 2.5, 10.0, 60.0, f64::INFINITY];

/// How long requests took, by method, route and status.
#[derive(Debug, Default)]
pub struct Latencies(Mutex<BTreeMap<(String, String, u16), Histogram>>);

/// Requests of one kind.
#[derive(Clone, Copy, Debug, Default)]
struct Histogram {
    /// Requests within each bucket's bound and above the bound before.
    counts: [u64; BUCKETS_SECS.len()],
    sum_secs: f64,
}

impl Latencies {
    /// Notes a request; `route` is one of the router's, so that there are few.
    pub fn note(&self, method: &str, route: &str, status: u16, took: Duration) {
        let secs = took.as_secs_f64();
        let bucket = BUCKETS_SECS.iter().position(|bound| secs <= *bound).unwrap_or(BUCKETS_SECS.len() - 1);
        let mut kinds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let histogram = kinds.entry((method.to_owned(), route.to_owned(), status)).or_default();
        histogram.counts[bucket] += 1;
        histogram.sum_secs += secs;
    }

    fn render(&self, text: &mut String) {
        let name = "lightkiln_request_seconds";
        head(text, name, "histogram", "Time until answers began; claims and events wait for news by design.");
        let kinds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for ((method, route, status), histogram) in &*kinds {
            let labels = format!("method=\"{method}\",route=\"{}\",status=\"{status}\"", escaped(route));
            let mut count = 0;
            for (bound, within) in BUCKETS_SECS.iter().zip(histogram.counts) {
                count += within;
                let bound = if bound.is_infinite() { "+Inf".to_owned() } else { bound.to_string() };
                line(text, &format!("{name}_bucket{{{labels},le=\"{bound}\"}}"), count);
            }
            let _ = writeln!(text, "{name}_sum{{{labels}}} {}", histogram.sum_secs);
            line(text, &format!("{name}_count{{{labels}}}"), count);
        }
    }
}

/// How full the storage is, and what was lost of it.
#[derive(Clone, Copy, Debug, Default)]
pub struct StorageFigures {
    /// What is stored.
    pub usage: Usage,
    /// Most bytes that may be.
    pub quota_bytes: Option<u64>,
    /// Chunks given up since this process started.
    pub lost: u64,
}

/// The Prometheus text: process counts, and the farm's figures from the store.
pub fn render(metrics: &Metrics, farm: &Stats, storage: StorageFigures) -> String {
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
    head(
        &mut text,
        "lightkiln_ready_tasks",
        "gauge",
        "Ready tasks of running bakes, by kind and what a worker needs.",
    );
    for demand in &farm.demand {
        let (kind, labels) = (escaped(&demand.kind), escaped(&demand.needs.labels.join(",")));
        let (memory_mib, threads) = (demand.needs.memory_mib, demand.needs.threads);
        let labels =
            format!("kind=\"{kind}\",memory_mib=\"{memory_mib}\",threads=\"{threads}\",labels=\"{labels}\"");
        line(&mut text, &format!("lightkiln_ready_tasks{{{labels}}}"), demand.ready);
    }
    let StorageFigures { usage, quota_bytes, lost } = storage;
    single(&mut text, "lightkiln_stored_chunks", "gauge", "Chunks stored.", usage.chunks);
    single(&mut text, "lightkiln_stored_bytes", "gauge", "Bytes of stored chunks.", usage.bytes);
    if let Some(quota) = quota_bytes {
        single(&mut text, "lightkiln_quota_bytes", "gauge", "Most bytes that may be stored.", quota);
    }
    let help = "Chunks given up because their bytes were lost or damaged.";
    single(&mut text, "lightkiln_lost_chunks_total", "counter", help, lost);
    metrics.latencies.render(&mut text);
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
    use crate::store::{Demand, TaskCount, TaskState};
    use lightkiln_proto::api::Needs;

    #[test]
    fn text_has_help_type_and_escaped_labels() {
        let metrics = Metrics::default();
        metrics.claims.add(3);
        let count = TaskCount { kind: "a\"b".into(), state: TaskState::Ready, count: 2 };
        metrics.latencies.note("GET", "/v1/bakes", 200, Duration::from_millis(20));
        metrics.latencies.note("GET", "/v1/bakes", 200, Duration::from_secs(100));
        let needs = Needs { threads: 4, labels: vec!["gpu".into(), "a\"b".into()], ..Needs::default() };
        let demand = vec![Demand { kind: "work".into(), needs, ready: 7 }];
        let stats = Stats { tasks: vec![count], demand, ..Stats::default() };
        let usage = Usage { chunks: 2, bytes: 30 };
        let text = render(&metrics, &stats, StorageFigures { usage, quota_bytes: Some(40), lost: 1 });
        for line in [
            "lightkiln_ready_tasks{kind=\"work\",memory_mib=\"0\",threads=\"4\",labels=\"gpu,a\\\"b\"} 7",
            "lightkiln_stored_bytes 30",
            "lightkiln_quota_bytes 40",
            "lightkiln_request_seconds_bucket{method=\"GET\",route=\"/v1/bakes\",status=\"200\",le=\"0.005\"} 0",
            "lightkiln_request_seconds_bucket{method=\"GET\",route=\"/v1/bakes\",status=\"200\",le=\"0.025\"} 1",
            "lightkiln_request_seconds_bucket{method=\"GET\",route=\"/v1/bakes\",status=\"200\",le=\"+Inf\"} 2",
            "lightkiln_request_seconds_sum{method=\"GET\",route=\"/v1/bakes\",status=\"200\"} 100.02",
            "lightkiln_request_seconds_count{method=\"GET\",route=\"/v1/bakes\",status=\"200\"} 2",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
        }
        assert!(text.contains("# TYPE lightkiln_claims_total counter\nlightkiln_claims_total 3\n"), "{text}");
        assert!(text.contains("lightkiln_tasks{kind=\"a\\\"b\",state=\"ready\"} 2\n"), "{text}");
    }
}
