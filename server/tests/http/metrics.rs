//! Metrics as a reader of OpenMetrics takes them.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{
    Bake, BakeState, ClaimAnswer, ClaimRequest, CommitVerdict, Heartbeat, HeartbeatAnswer, NewBake, Verdict,
};
use lightkiln_proto::ids::Digest;
use serde_json::json;

use crate::bakes::{SCENE, commit, new_bake, put_scene, request, run, submit};
use crate::support::start;

/// A line with a value.
#[derive(Debug)]
struct Sample {
    /// Behind the family's name.
    suffix: String,
    labels: BTreeMap<String, String>,
    value: f64,
}

/// Samples under one name.
#[derive(Debug)]
struct Family {
    kind: String,
    samples: Vec<Sample>,
}

/// Reads a text of OpenMetrics; panics where it is none.
fn parse(text: &str) -> BTreeMap<String, Family> {
    let text = text.strip_suffix("# EOF\n").expect("the text ends with its mark");
    let mut families = BTreeMap::new();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let help = line.strip_prefix("# HELP ").unwrap_or_else(|| panic!("{line} stands in no family"));
        let (name, _) = help.split_once(' ').expect("help has words");
        let told = lines.next().and_then(|line| line.strip_prefix("# TYPE ")?.strip_prefix(name));
        let kind = told.expect("the type follows").trim_start().to_owned();
        let mut samples = Vec::new();
        while let Some(line) = lines.next_if(|line| !line.starts_with('#')) {
            samples.push(parse_sample(line, name));
        }
        let family = Family { kind, samples };
        assert!(families.insert(name.to_owned(), family).is_none(), "{name} comes twice");
    }
    families
}

fn parse_sample(line: &str, name: &str) -> Sample {
    let rest = line.strip_prefix(name).unwrap_or_else(|| panic!("{line} stands under {name}"));
    let end = rest.find(['{', ' ']).expect("a value follows");
    let (suffix, mut rest) = rest.split_at(end);
    let mut labels = BTreeMap::new();
    if let Some(mut inner) = rest.strip_prefix('{') {
        loop {
            let (label, behind) = inner.split_once("=\"").expect("a label has a value in quotes");
            let mut value = String::new();
            let mut chars = behind.char_indices();
            let end = loop {
                match chars.next().expect("the quotes end") {
                    (_, '\\') => value.push(match chars.next() {
                        Some((_, 'n')) => '\n',
                        Some((_, escaped @ ('"' | '\\'))) => escaped,
                        other => panic!("{other:?} is escaped in {line}"),
                    }),
                    (at, '"') => break at + 1,
                    (_, char) => value.push(char),
                }
            };
            assert!(labels.insert(label.to_owned(), value).is_none(), "{label} comes twice in {line}");
            match behind[end..].strip_prefix(',') {
                Some(more) => inner = more,
                None => break rest = behind[end..].strip_prefix('}').expect("the labels end"),
            }
        }
    }
    let value = rest.strip_prefix(' ').and_then(|value| value.parse().ok());
    Sample {
        suffix: suffix.to_owned(),
        labels,
        value: value.unwrap_or_else(|| panic!("{line} has no value")),
    }
}

/// Holds a family against the rules of its type.
fn check(name: &str, family: &Family) {
    let suffixes: &[&str] = match family.kind.as_str() {
        "counter" => &["_total"],
        "gauge" => &[""],
        "histogram" => &["_bucket", "_sum", "_count"],
        other => panic!("{name} is a {other}"),
    };
    let mut series = BTreeSet::new();
    let mut buckets: BTreeMap<Vec<&str>, Vec<(f64, f64)>> = BTreeMap::new();
    for Sample { suffix, labels, value } in &family.samples {
        assert!(suffixes.contains(&suffix.as_str()) && *value >= 0.0, "{name}{suffix} {value}");
        assert!(series.insert((suffix, labels)), "{name}{suffix} {labels:?} comes twice");
        if suffix == "_bucket" {
            let others = labels.iter().filter(|(label, _)| *label != "le");
            let others = others.map(|(_, value)| value.as_str()).collect();
            buckets.entry(others).or_default().push((labels["le"].parse().unwrap(), *value));
        }
    }
    for (_, buckets) in buckets {
        assert!(buckets.is_sorted_by(|a, b| a.0 < b.0 && a.1 <= b.1), "{name} {buckets:?}");
        assert_eq!(buckets.last().map(|last| last.0), Some(f64::INFINITY));
    }
}

#[tokio::test]
async fn metrics_of_a_farm_are_read_by_the_rules_of_their_format() {
    let server = start().await;
    server.get("/readyz").await;
    submit(&server).await;
    run(&server).await;
    submit(&server).await;
    let empty: ClaimAnswer = server.post("/v1/leases", &request(0)).await.json(200);
    assert!(empty.leases.is_empty());
    let answer = server.get("/metrics").await;
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    assert_eq!(answer.header("content-type"), Some(kind));
    let families = parse(std::str::from_utf8(&answer.body).unwrap());
    families.iter().for_each(|(name, family)| check(name, family));
    for (name, labels, value) in [
        ("claims", "", 2.0),
        ("commits", "", 2.0),
        ("stale_commits", "", 0.0),
        ("expiries", "", 0.0),
        ("lost_workers", "", 0.0),
        ("differing_results", "", 0.0),
        ("verified_results", "", 0.0),
        ("lapsed_checks", "", 0.0),
        ("waiting_checks", "", 0.0),
        ("full_refusals", "", 0.0),
        ("tasks_run", "", 2.0),
        ("tasks_reused", "", 2.0),
        ("workers", "", 1.0),
        ("sent_bytes", "", 0.0),
        ("stored_chunks", "", 4.0),
        ("lost_chunks", "", 0.0),
        ("tasks", "two.first done", 1.0),
    ] {
        let found = families[&format!("lightkiln_{name}")].samples.iter().find(|sample| {
            sample.labels.values().map(String::as_str).collect::<Vec<_>>().join(" ") == labels
        });
        assert_eq!(found.map(|sample| sample.value), Some(value), "{name} {labels}");
    }
    let latencies = &families["lightkiln_http_request_duration_seconds"].samples;
    let ready =
        latencies.iter().find(|sample| sample.suffix == "_count" && sample.labels["route"] == "/readyz");
    assert_eq!(ready.map(|sample| sample.value), Some(1.0));
}

#[tokio::test]
async fn result_that_another_machine_makes_otherwise_is_told() {
    let server = start().await;
    put_scene(&server).await;
    let new = NewBake { verify_share: 1.0, ..new_bake(Digest::of(SCENE), json!({})) };
    let bake: Bake = server.post("/v1/bakes", &new).await.json(202);
    run(&server).await;
    let other = ClaimRequest { worker: "other".into(), machine: "elsewhere".into(), ..request(0) };
    let mut answer: ClaimAnswer = server.post("/v1/leases", &other).await.json(200);
    let lease = answer.leases.remove(0);
    assert_eq!((&lease.bake, answer.leases.len()), (&bake.id, 0));
    let heartbeat = format!("/v1/leases/{}/heartbeat", lease.token);
    let kept: HeartbeatAnswer = server.post(&heartbeat, &Heartbeat { progress: 0.5 }).await.json(200);
    assert_eq!(kept.verdict, Verdict::Keep);
    assert_eq!(commit(&server, &lease, &[("scene", b"otherwise")]).await, CommitVerdict::Committed);
    let shown: Bake = server.get(&format!("/v1/bakes/{}", bake.id)).await.json(200);
    assert_eq!((shown.alarms, shown.state, shown.tasks_run), (1, BakeState::Done, 2));
    let text = server.get("/metrics").await.body;
    let text = std::str::from_utf8(&text).unwrap();
    for line in [
        "lightkiln_verified_results_total 1",
        "lightkiln_waiting_checks 1",
        "lightkiln_lapsed_checks_total 0",
        "lightkiln_differing_results_total 1",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
    }
}

#[test]
#[should_panic(expected = "comes twice")]
fn series_that_comes_twice_is_no_text_of_metrics() {
    let text = "# HELP a b.\n# TYPE a gauge\na{x=\"1\"} 1\na{x=\"1\"} 2\n# EOF\n";
    parse(text).iter().for_each(|(name, family)| check(name, family));
}
