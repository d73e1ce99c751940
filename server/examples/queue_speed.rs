//! Measures the queue: `cargo run --release -p lightkiln-server --example queue_speed [tasks] [folder] [postgres://…]`.
//!
//! Figures are for one caller that waits for each answer; every commit is flushed to the disk of `folder`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use lightkiln_proto::api::{ClaimRequest, Needs, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult, TaskSpec};
use lightkiln_server::clock::SystemClock;
use lightkiln_server::store::{FarmStore, MemoryStore, SqlStore, Submission};

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let tasks =
        arguments.next().map_or(Ok(5_000), |count| count.parse()).context("tasks must be a number")?;
    let folder = match arguments.next() {
        Some(folder) => PathBuf::from(folder),
        None => std::env::temp_dir(),
    };
    let folder = tempfile::tempdir_in(folder).context("no folder to measure in")?;
    let clock = Arc::new(SystemClock);
    if let Some(url) = arguments.next() {
        measure("postgres", &SqlStore::open_postgres(&url, None).await?, tasks).await?;
    }
    let sqlite = SqlStore::open_sqlite(&folder.path().join("farm.sqlite"), clock.clone()).await?;
    measure("sqlite", &sqlite, tasks).await?;
    measure("memory", &MemoryStore::new(clock), tasks.min(5_000)).await
}

fn bake(plan: Vec<TaskSpec>) -> Submission {
    let settings = serde_json::Value::Null;
    let bake = NewBake {
        name: "speed".into(),
        scene: Digest::of(b""),
        kind: "x".into(),
        settings,
        priority: 0,
        needs: Needs::default(),
        attempt_limit_secs: None,
    };
    Submission { idempotency_key: None, body_hash: Digest::of(b""), traceparent: None, bake, plan }
}

fn task(name: &str, needs: &[&TaskSpec], cost: u64) -> TaskSpec {
    let inputs = needs.iter().map(|task| TaskInput::Task { name: "in".into(), key: task.key }).collect();
    TaskSpec::new("work", 1, name, serde_json::json!({ "name": name }), inputs, cost)
}

/// One task plans `count` others, as preparing does; a last one needs them all.
async fn measure(name: &str, store: &dyn FarmStore, count: usize) -> anyhow::Result<()> {
    let planner = task("plan", &[], 1);
    let parts: Vec<TaskSpec> =
        (0..count).map(|i| task(&format!("{i}"), &[&planner], i as u64 % 97)).collect();
    let last = task("last", &parts.iter().collect::<Vec<_>>(), 1);
    let plan: Vec<TaskSpec> = parts.into_iter().chain([last]).collect();
    store.submit(&bake(vec![planner.clone()])).await?;
    let request = |max| ClaimRequest {
        worker: "w".into(),
        kinds: vec!["work".into()],
        threads: 1,
        memory_mib: 0,
        labels: Vec::new(),
        max,
        ttl_secs: 3600,
        wait_secs: 0,
    };
    let lease = store.claim(&request(1)).await?.remove(0);
    let started = Instant::now();
    store.commit(&lease.token, &TaskResult { plan, ..TaskResult::default() }).await?;
    println!("{name}: a plan of {} tasks in {:?}", count + 1, started.elapsed());

    let (mut claiming, mut committing, mut done) = (Duration::ZERO, Duration::ZERO, 0_u32);
    loop {
        let started = Instant::now();
        let leases = store.claim(&request(1)).await?;
        claiming += started.elapsed();
        let Some(lease) = leases.first() else { break };
        let output = Artefact { name: "out".into(), digest: lease.task.key, bytes: 1 };
        let result = TaskResult { outputs: vec![output], ..TaskResult::default() };
        let started = Instant::now();
        store.commit(&lease.token, &result).await?;
        committing += started.elapsed();
        done += 1;
    }
    println!(
        "{name}: {done} claims, {:?} each; as many commits, {:?} each",
        claiming / done,
        committing / done
    );

    let started = Instant::now();
    let again = store.submit(&bake(vec![planner])).await?.bake;
    println!("{name}: the same bake again reuses {} tasks in {:?}", again.tasks_reused, started.elapsed());
    Ok(())
}
