//! Metrics of this process and of the farm, in the text format of OpenMetrics, which Prometheus reads.

use std::fmt;
use std::time::Duration;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::{encode, encode_registry};
use prometheus_client::encoding::{DescriptorEncoder, EncodeGaugeValue, EncodeLabelSet, EncodeMetric};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::Registry;

use crate::store::chunk::Usage;
use crate::store::{Demand, Stats, TaskCount};

/// The type of an answer with metrics.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
/// Prefix of the names of all metrics.
const PREFIX: &str = "lightkiln";
/// Bounds of the latency histogram's buckets, in seconds; one without a bound follows.
const BUCKETS_SECS: [f64; 7] = [0.005, 0.025, 0.1, 0.5, 2.5, 10.0, 60.0];

/// The counters of this process: each is a field, and the metric `lightkiln_NAME_total`.
macro_rules! counters {
    ($($name:ident: $help:literal;)+) => {
        /// Metrics of this process since it started.
        #[derive(Debug)]
        pub struct Metrics {
            registry: Registry,
            latencies: Latencies,
            $(#[doc = $help] pub $name: Counter,)+
        }

        impl Metrics {
            /// All counts are 0; `lost_chunks` is counted elsewhere.
            pub fn new(lost_chunks: Counter) -> Self {
                let mut registry = Registry::with_prefix(PREFIX);
                let help = "Chunks given up because their bytes were lost or damaged";
                registry.register("lost_chunks", help, lost_chunks);
                let latencies = Latencies::new_with_constructor(|| Histogram::new(BUCKETS_SECS));
                let help = "Time until answers began; claims and events wait for news by design";
                registry.register("http_request_duration_seconds", help, latencies.clone());
                $(let $name = Counter::default();
                registry.register(stringify!($name), $help, $name.clone());)+
                Self { registry, latencies, $($name,)+ }
            }
        }
    };
}

counters! {
    submissions: "Bakes taken in by this process";
    claims: "Tasks handed out by this process";
    commits: "Results taken in by this process";
    stale_commits: "Results refused because their lease was gone";
    failures: "Attempts that a worker reported as failed";
    releases: "Leases given back by workers";
    expiries: "Leases that ran out";
    lost_workers: "Workers lost with a task: their leases ran out, or their next start told so";
    forgotten_results: "Results forgotten because their bytes were gone";
    deleted_bakes: "Bakes deleted because they ended long ago";
    removed_chunks: "Chunks removed because nobody needed them";
    full_refusals: "Calls refused because the disk or the quota was full";
    received_bytes: "Bytes of chunks and scenes taken in";
    sent_bytes: "Bytes of chunks, manifests and reports given out";
}

/// Durations of requests until their answers began.
type Latencies = Family<Call, Histogram, fn() -> Histogram>;

/// Requests of one kind.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Call {
    method: String,
    route: String,
    status: u16,
}

impl Metrics {
    /// Notes a request; `route` is one of the router's, so that there are few.
    pub fn note_latency(&self, method: &str, route: &str, status: u16, took: Duration) {
        let call = Call { method: method.to_owned(), route: route.to_owned(), status };
        self.latencies.get_or_create(&call).observe(took.as_secs_f64());
    }

    /// The text: counts of this process, and figures of the farm.
    pub fn render(&self, figures: Figures) -> String {
        let mut farm = Registry::with_prefix(PREFIX);
        farm.register_collector(Box::new(figures));
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = encode_registry(&mut text, &self.registry).and_then(|()| encode(&mut text, &farm));
        text
    }
}

/// Figures of the farm at the moment when they were asked for.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// The queue.
    pub farm: Stats,
    /// Workers heard of lately.
    pub workers: u64,
    /// Stored chunks and their bytes.
    pub usage: Usage,
    /// Most bytes that may be.
    pub quota_bytes: Option<u64>,
}

impl Collector for Figures {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        self.encode_totals(&mut encoder)?;
        self.encode_queue(&mut encoder)
    }
}

impl Figures {
    fn encode_totals(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let Self { farm, workers, usage, quota_bytes } = self;
        let totals = [
            ("tasks_run", "Tasks run since the farm began.", farm.tasks_run),
            (
                "tasks_reused",
                "Tasks whose result was there already, since the farm began.",
                farm.tasks_reused,
            ),
            (
                "differing_results",
                "Results that were not as another one of their task, since the farm began.",
                farm.alarms,
            ),
            ("verified_results", "Results made once more and compared, since the farm began.", farm.verified),
            (
                "lapsed_checks",
                "Results that were to be made once more and were not, since the farm began.",
                farm.reruns_lapsed,
            ),
        ];
        for (name, help, count) in totals {
            let family = encoder.encode_descriptor(name, help, None, MetricType::Counter)?;
            ConstCounter::new(count).encode(family)?;
        }
        let gauges = [
            ("bakes_live", "Bakes running or paused.", Some(farm.bakes_live)),
            ("bakes", "Bakes that the farm knows.", Some(farm.bakes_total)),
            ("waiting_checks", "Results to be made once more on another machine.", Some(farm.reruns_waiting)),
            ("workers", "Workers heard of in the last ten minutes.", Some(*workers)),
            ("stored_chunks", "Chunks stored.", Some(usage.chunks)),
            ("stored_bytes", "Bytes of stored chunks.", Some(usage.bytes)),
            ("quota_bytes", "Most bytes that may be stored.", *quota_bytes),
        ];
        for (name, help, value) in gauges {
            let Some(value) = value else { continue };
            let family = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
            ConstGauge::new(value).encode(family)?;
        }
        Ok(())
    }

    fn encode_queue(&self, encoder: &mut DescriptorEncoder) -> fmt::Result {
        let Stats { tasks, demand, .. } = &self.farm;
        let help = "Tasks that the farm holds, by kind and state.";
        let label = |count: &TaskCount| {
            ([("kind", count.kind.clone()), ("state", count.state.name().to_owned())], count.count)
        };
        gauges(encoder, "tasks", help, tasks.iter().map(label))?;
        let help = "Ready tasks that more workers could take, by kind and what a worker needs.";
        gauges(encoder, "ready_tasks", help, demand.iter().map(|demand| (labels_of(demand), demand.ready)))?;
        let help = "For how long the oldest of them has been waiting for a worker.";
        let age = |demand: &Demand| (labels_of(demand), demand.waited_ms as f64 / 1e3);
        gauges(encoder, "oldest_ready_task_age_seconds", help, demand.iter().map(age))
    }
}

/// Writes the gauges of one name, by their labels.
fn gauges<const LABELS: usize>(
    encoder: &mut DescriptorEncoder,
    name: &str,
    help: &str,
    gauges: impl Iterator<Item = ([(&'static str, String); LABELS], impl EncodeGaugeValue)>,
) -> fmt::Result {
    let mut family = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
    for (labels, value) in gauges {
        family.encode_family(&labels)?.encode_gauge(&value)?;
    }
    Ok(())
}

/// Labels of a kind of tasks, and of the workers that may take them.
fn labels_of(demand: &Demand) -> [(&'static str, String); 4] {
    let Demand { kind, needs, .. } = demand;
    let [memory_mib, threads] = [needs.memory_mib, needs.threads].map(|count| count.to_string());
    let labels = needs.labels.join(",");
    [("kind", kind.clone()), ("memory_mib", memory_mib), ("threads", threads), ("labels", labels)]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use lightkiln_proto::api::Needs;

    use super::*;
    use crate::store::TaskState;

    fn text() -> String {
        let metrics = Metrics::new(Counter::default());
        metrics.claims.inc_by(3);
        metrics.note_latency("GET", "/v1/bakes", 200, Duration::from_millis(20));
        metrics.note_latency("GET", "/v1/bakes", 200, Duration::from_secs(100));
        let needs = Needs { threads: 4, labels: vec!["gpu".into(), "a\"b\\\n".into()], ..Needs::default() };
        let any = Demand { kind: "work".into(), needs: Needs::default(), ready: 1, waited_ms: 0 };
        let demand = vec![any, Demand { kind: "work".into(), needs, ready: 7, waited_ms: 61_500 }];
        let tasks = vec![TaskCount { kind: "a\"b".into(), state: TaskState::Ready, count: 2 }];
        let farm = Stats { tasks, demand, tasks_run: 5, tasks_reused: 6, ..Stats::default() };
        let usage = Usage { chunks: 2, bytes: 30 };
        metrics.render(Figures { farm, workers: 2, usage, quota_bytes: Some(40) })
    }

    #[test]
    fn figures_are_told_with_their_labels() {
        let text = text();
        let gpu = "kind=\"work\",memory_mib=\"0\",threads=\"4\",labels=\"gpu,a\\\"b\\\\\\n\"";
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
            "lightkiln_lost_chunks_total 0",
            &format!("{latency}_bucket{{le=\"0.005\",{get}}} 0"),
            &format!("{latency}_bucket{{le=\"0.025\",{get}}} 1"),
            &format!("{latency}_bucket{{le=\"+Inf\",{get}}} 2"),
            &format!("{latency}_sum{{{get}}} 100.02"),
            &format!("{latency}_count{{{get}}} 2"),
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
        }
    }

    /// Names as the conventions of Prometheus want them: one prefix, base units, help and type once.
    #[test]
    fn names_follow_the_conventions_of_prometheus() {
        let text = text();
        let mut seen = BTreeSet::new();
        for help in text.lines().filter_map(|line| line.strip_prefix("# HELP ")) {
            let (name, told) = help.split_once(' ').unwrap();
            assert!(seen.insert(name) && told.ends_with('.') && !told.ends_with(".."), "{help}");
            let words = name.strip_prefix("lightkiln_").unwrap();
            assert!(words.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{name}");
            let suffixes = ["_total", "_ms", "_millis", "_mib", "_kb", "_minutes", "_percent", "_count"];
            assert!(!suffixes.iter().any(|suffix| words.ends_with(suffix)), "{name}");
        }
        assert!(seen.len() > 20, "only {} names", seen.len());
    }
}
