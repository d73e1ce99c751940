//! What has happened in this process, and the text that Prometheus reads.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::store::chunk::Usage;
use crate::store::{Demand, Stats};

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
    /// Bytes of chunks, manifests and reports given out.
    pub bytes_out: Arc<Counter>,
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
        let name = "lightkiln_http_request_duration_seconds";
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

/// What is known of the farm when it is asked for.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// The queue.
    pub farm: Stats,
    /// Workers heard of lately.
    pub workers: u64,
    /// What is stored.
    pub usage: Usage,
    /// Most bytes that may be.
    pub quota_bytes: Option<u64>,
    /// Chunks given up since this process started.
    pub lost: u64,
}

/// The Prometheus text: process counts, and the farm's figures.
pub fn render(metrics: &Metrics, figures: &Figures) -> String {
    let mut text = String::new();
    render_counters(&mut text, metrics);
    render_queue(&mut text, &figures.farm);
    single(
        &mut text,
        "lightkiln_workers",
        "gauge",
        "Workers heard of in the last ten minutes.",
        figures.workers,
    );
    render_storage(&mut text, figures);
    metrics.latencies.render(&mut text);
    text
}

fn render_counters(text: &mut String, metrics: &Metrics) {
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
        ("sent_bytes", "Bytes of chunks, manifests and reports given out.", &metrics.bytes_out),
    ];
    for (name, help, counter) in counters {
        single(text, &format!("lightkiln_{name}_total"), "counter", help, counter.get());
    }
}

fn render_queue(text: &mut String, farm: &Stats) {
    let totals = [
        ("tasks_run", "Tasks run since the farm began.", farm.tasks_run),
        ("tasks_reused", "Tasks whose result was there already, since the farm began.", farm.tasks_reused),
    ];
    for (name, help, count) in totals {
        single(text, &format!("lightkiln_{name}_total"), "counter", help, count);
    }
    single(text, "lightkiln_bakes_live", "gauge", "Bakes running or paused.", farm.bakes_live);
    single(text, "lightkiln_bakes", "gauge", "Bakes that the farm knows.", farm.bakes_total);
    head(text, "lightkiln_tasks", "gauge", "Tasks that the farm holds, by kind and state.");
    for count in &farm.tasks {
        let (kind, state) = (escaped(&count.kind), count.state.name());
        line(text, &format!("lightkiln_tasks{{kind=\"{kind}\",state=\"{state}\"}}"), count.count);
    }
    let name = "lightkiln_ready_tasks";
    head(text, name, "gauge", "Ready tasks of running bakes, by kind and what a worker needs.");
    for demand in &farm.demand {
        line(text, &format!("{name}{{{}}}", labels_of(demand)), demand.ready);
    }
    let name = "lightkiln_oldest_ready_task_age_seconds";
    head(text, name, "gauge", "For how long the oldest of them has been waiting for a worker.");
    for demand in &farm.demand {
        let secs = demand.waited_ms as f64 / 1e3;
        let _ = writeln!(text, "{name}{{{}}} {secs}", labels_of(demand));
    }
}

/// What kind of worker is asked for.
fn labels_of(demand: &Demand) -> String {
    let (kind, labels) = (escaped(&demand.kind), escaped(&demand.needs.labels.join(",")));
    let (memory_mib, threads) = (demand.needs.memory_mib, demand.needs.threads);
    format!("kind=\"{kind}\",memory_mib=\"{memory_mib}\",threads=\"{threads}\",labels=\"{labels}\"")
}

fn render_storage(text: &mut String, figures: &Figures) {
    let Figures { usage, quota_bytes, lost, .. } = figures;
    single(text, "lightkiln_stored_chunks", "gauge", "Chunks stored.", usage.chunks);
    single(text, "lightkiln_stored_bytes", "gauge", "Bytes of stored chunks.", usage.bytes);
    if let Some(quota) = quota_bytes {
        single(text, "lightkiln_quota_bytes", "gauge", "Most bytes that may be stored.", *quota);
    }
    let help = "Chunks given up because their bytes were lost or damaged.";
    single(text, "lightkiln_lost_chunks_total", "counter", help, *lost);
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
    use lightkiln_proto::api::Needs;

    fn text() -> String {
        let metrics = Metrics::default();
        metrics.claims.add(3);
        metrics.latencies.note("GET", "/v1/bakes", 200, Duration::from_millis(20));
        metrics.latencies.note("GET", "/v1/bakes", 200, Duration::from_secs(100));
        let needs = Needs { threads: 4, labels: vec!["gpu".into(), "a\"b".into()], ..Needs::default() };
        let any = Demand { kind: "work".into(), needs: Needs::default(), ready: 1, waited_ms: 0 };
        let demand = vec![any, Demand { kind: "work".into(), needs, ready: 7, waited_ms: 61_500 }];
        let tasks = vec![TaskCount { kind: "a\"b".into(), state: TaskState::Ready, count: 2 }];
        let farm = Stats { tasks, demand, tasks_run: 5, tasks_reused: 6, ..Stats::default() };
        let usage = Usage { chunks: 2, bytes: 30 };
        render(&metrics, &Figures { farm, workers: 2, usage, quota_bytes: Some(40), lost: 1 })
    }

    #[test]
    fn figures_are_told_with_their_labels() {
        let text = text();
        let gpu = "kind=\"work\",memory_mib=\"0\",threads=\"4\",labels=\"gpu,a\\\"b\"";
        let get = "method=\"GET\",route=\"/v1/bakes\",status=\"200\"";
        let latency = "lightkiln_http_request_duration_seconds";
        for line in [
            "lightkiln_claims_total 3",
            "lightkiln_tasks_run_total 5",
            "lightkiln_tasks_reused_total 6",
            "lightkiln_tasks{kind=\"a\\\"b\",state=\"ready\"} 2",
            &format!("lightkiln_ready_tasks{{{gpu}}} 7"),
            &format!("lightkiln_oldest_ready_task_age_seconds{{{gpu}}} 61.5"),
            "lightkiln_workers 2",
            "lightkiln_stored_bytes 30",
            "lightkiln_quota_bytes 40",
            &format!("{latency}_bucket{{{get},le=\"0.005\"}} 0"),
            &format!("{latency}_bucket{{{get},le=\"0.025\"}} 1"),
            &format!("{latency}_bucket{{{get},le=\"+Inf\"}} 2"),
            &format!("{latency}_sum{{{get}}} 100.02"),
            &format!("{latency}_count{{{get}}} 2"),
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
        }
    }

    /// Names as the conventions of Prometheus want them: one prefix, base units, `_total` for counters alone; help and type
    /// once, before the samples, which stand together; no series twice.
    #[test]
    fn names_follow_the_conventions_of_prometheus() {
        let text = text();
        let (mut seen, mut series) = (std::collections::BTreeSet::new(), std::collections::BTreeSet::new());
        let (mut name, mut kind) = ("", "");
        for line in text.lines() {
            if let Some(help) = line.strip_prefix("# HELP ") {
                let told;
                (name, told) = help.split_once(' ').unwrap();
                assert!(seen.insert(name) && told.ends_with('.'), "{line}");
            } else if let Some(of) = line.strip_prefix("# TYPE ") {
                kind = of.strip_prefix(name).unwrap().trim_start();
                let words = name.strip_prefix("lightkiln_").unwrap();
                assert!(words.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{line}");
                assert_eq!(words.ends_with("_total"), kind == "counter", "{line}");
                let units =
                    ["_ms", "_millis", "_mib", "_kb", "_minutes", "_percent", "_gauge", "_counter", "_count"];
                assert!(!units.iter().any(|unit| words.trim_end_matches("_total").ends_with(unit)), "{line}");
            } else {
                let (sample, value) = line.rsplit_once(' ').unwrap();
                assert!(value.parse::<f64>().is_ok() && series.insert(sample), "{line}");
                let of = sample.split('{').next().unwrap().strip_prefix(name);
                let suffixes: &[&str] =
                    if kind == "histogram" { &["_bucket", "_sum", "_count"] } else { &[""] };
                assert!(of.is_some_and(|of| suffixes.contains(&of)), "{line} stands under {name}");
            }
        }
        assert!(seen.len() > 20, "only {} names", seen.len());
    }
}
