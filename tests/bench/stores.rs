//! Claims and commits a second on each store, without HTTP: one caller that waits for each answer, and sixteen.

use std::sync::Arc;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{ClaimRequest, Needs, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_server::chunks::ChunkName;
use lightkiln_server::clock::SystemClock;
use lightkiln_server::store::chunk::KeptChunk;
use lightkiln_server::store::{FarmStore, MemoryStore, SqlStore, Submission};

use crate::parts::postgres::Postgres;
use crate::report::row;

/// Tasks of a run.
const TASKS: usize = 5_000;
/// Callers beside one alone.
const CALLERS: usize = 16;

/// Measures each store.
pub fn measure() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let clock = Arc::new(SystemClock);
        measure_store("memory", Arc::new(MemoryStore::new(clock.clone()))).await;
        let folder = tempfile::tempdir().unwrap();
        let sqlite = SqlStore::open_sqlite(&folder.path().join("farm.sqlite"), clock).await.unwrap();
        measure_store("SQLite", Arc::new(sqlite)).await;
        // With its flushes, unlike in tests.
        let server = Postgres::start_with("");
        let postgres = SqlStore::open_postgres(&server.url(None), None).await.unwrap();
        measure_store("PostgreSQL", Arc::new(postgres)).await;
    });
}

async fn measure_store(name: &str, store: Arc<dyn FarmStore>) {
    for callers in [1, CALLERS] {
        plan(&*store, callers).await;
        let started = Instant::now();
        let runs = (0..callers).map(|caller| tokio::spawn(work(store.clone(), caller)));
        let (mut done, mut claiming, mut committing) = (0, Duration::ZERO, Duration::ZERO);
        for run in runs.collect::<Vec<_>>() {
            let (tasks, claims, commits) = run.await.unwrap();
            (done, claiming, committing) = (done + tasks, claiming + claims, committing + commits);
        }
        let rate = f64::from(done) / started.elapsed().as_secs_f64();
        let [claim, commit] =
            [claiming, committing].map(|time| time.as_secs_f64() * 1000.0 / f64::from(done));
        let place = format!("{name}, {callers} caller{}", if callers == 1 { "" } else { "s" });
        let figure = format!("{rate:.0} of each a second; a claim {claim:.2} ms, a commit {commit:.2} ms");
        row("claims and commits", &place, &figure);
    }
}

/// A bake with [`TASKS`] ready tasks: one plans them, as preparing does, and a last one needs them all.
async fn plan(store: &dyn FarmStore, run: usize) {
    let scene = KeptChunk { name: ChunkName::from(Digest::of(b"")), bytes: 0 };
    store.keep_chunk(scene, None, None).await.unwrap();
    let planner = task(&format!("plan {run}"), &[]);
    let parts: Vec<TaskSpec> = (0..TASKS).map(|i| task(&format!("{run} {i}"), &[&planner])).collect();
    let last = task(&format!("last {run}"), &parts.iter().collect::<Vec<_>>());
    let submission = Submission {
        idempotency_key: None,
        traceparent: None,
        body_hash: Digest::of(b""),
        bake: bake(),
        plan: vec![planner],
    };
    store.submit(&submission).await.unwrap();
    let lease = store.claim(&request("planner")).await.unwrap().remove(0);
    let plan = parts.into_iter().chain([last]).collect();
    store.commit(&lease.token, &TaskResult { plan, ..TaskResult::default() }).await.unwrap();
}

/// Claims and commits until nothing is ready: tasks, time of claims, time of commits.
async fn work(store: Arc<dyn FarmStore>, caller: usize) -> (u32, Duration, Duration) {
    let request = request(&format!("worker {caller}"));
    let (mut done, mut claiming, mut committing) = (0, Duration::ZERO, Duration::ZERO);
    loop {
        let started = Instant::now();
        let leases = store.claim(&request).await.unwrap();
        let Some(lease) = leases.first() else { return (done, claiming, committing) };
        claiming += started.elapsed();
        let started = Instant::now();
        store.commit(&lease.token, &TaskResult::default()).await.unwrap();
        committing += started.elapsed();
        done += 1;
    }
}

fn bake() -> NewBake {
    NewBake {
        name: "load".into(),
        scene: Digest::of(b""),
        kind: "x".into(),
        settings: serde_json::Value::Null,
        priority: 0,
        needs: Needs::default(),
        attempt_limit_secs: None,
    }
}

fn task(name: &str, needs: &[&TaskSpec]) -> TaskSpec {
    let inputs = needs.iter().map(|task| TaskInput::Task { name: "in".into(), key: task.key }).collect();
    TaskSpec::new("work", 1, name, serde_json::json!({ "name": name }), inputs, name.len() as u64)
}

fn request(worker: &str) -> ClaimRequest {
    ClaimRequest {
        worker: worker.into(),
        kinds: vec!["work".into()],
        threads: 1,
        memory_mib: 0,
        labels: Vec::new(),
        max: 1,
        ttl_secs: 3600,
        wait_secs: 0,
    }
}
