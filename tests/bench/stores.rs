//! Claims and commits a second on each store, without HTTP: one caller that waits for each answer, and sixteen. Before,
//! how long a plan of that many tasks takes to be taken in; after, how long the same bake takes that reuses them all.

use std::sync::Arc;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{ClaimRequest, Needs, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_server::chunks::ChunkName;
use lightkiln_server::clock::SystemClock;
use lightkiln_server::store::chunk::KeptChunk;
use lightkiln_server::store::{FarmStore, SqlStore, Submission};

use crate::model::MemoryStore;
use crate::parts::postgres::Postgres;
use crate::report::row;

/// Tasks of a run. More → longer: each costs a few milliseconds.
const TASKS: usize = 2_000;
/// The same for the model, which counts all afresh with each call: its time grows with the square.
const MODEL_TASKS: usize = 300;
/// Callers beside one alone.
const CALLERS: usize = 16;

/// Measures each store.
pub fn measure() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let clock = Arc::new(SystemClock);
        measure_store("memory", Arc::new(MemoryStore::new(clock.clone())), MODEL_TASKS).await;
        let folder = tempfile::tempdir().unwrap();
        let sqlite = SqlStore::open_sqlite(&folder.path().join("farm.sqlite"), clock).await.unwrap();
        measure_store("SQLite", Arc::new(sqlite), TASKS).await;
        // With its flushes, unlike in tests.
        let server = Postgres::start_with("");
        let postgres = SqlStore::open_postgres(&server.url(None), None).await.unwrap();
        measure_store("PostgreSQL", Arc::new(postgres), TASKS).await;
    });
}

async fn measure_store(name: &str, store: Arc<dyn FarmStore>, tasks: usize) {
    for callers in [1, CALLERS] {
        let place = format!("{name}, {callers} caller{}", if callers == 1 { "" } else { "s" });
        eprintln!("stores: {tasks} tasks on {place}");
        let run = Run::new(callers, tasks);
        if callers == 1 {
            row(&format!("plan of {} tasks", tasks + 1), name, &millis(run.plan(&*store).await));
        } else {
            run.plan(&*store).await;
        }
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
        let figure = format!("{rate:.0} of each a second; a claim {claim:.2} ms, a commit {commit:.2} ms");
        row("claims and commits", &place, &figure);
        if callers == 1 {
            let started = Instant::now();
            run.submit(&*store).await;
            row(&format!("bake that reuses {} results", tasks + 2), name, &millis(started.elapsed()));
        }
    }
}

fn millis(time: Duration) -> String {
    format!("{:.0} ms", time.as_secs_f64() * 1000.0)
}

/// A bake: one task plans the others, as preparing does, and a last one needs them all.
struct Run {
    planner: TaskSpec,
    planned: Vec<TaskSpec>,
}

impl Run {
    fn new(number: usize, tasks: usize) -> Self {
        let planner = task(&format!("plan {number}"), &[]);
        let parts: Vec<TaskSpec> = (0..tasks).map(|i| task(&format!("{number} {i}"), &[&planner])).collect();
        let last = task(&format!("last {number}"), &parts.iter().collect::<Vec<_>>());
        Self { planner, planned: parts.into_iter().chain([last]).collect() }
    }

    async fn submit(&self, store: &dyn FarmStore) {
        let (body_hash, plan) = (Digest::of(b""), vec![self.planner.clone()]);
        let submission = Submission {
            idempotency_key: None,
            traceparent: None,
            owner: None,
            body_hash,
            bake: bake(),
            plan,
        };
        store.submit(&submission).await.unwrap();
    }

    /// Submits, and runs the planner; how long it took to take its plan in.
    async fn plan(&self, store: &dyn FarmStore) -> Duration {
        let scene = KeptChunk { name: ChunkName::from(Digest::of(b"")), bytes: 0 };
        store.keep_chunk(scene, None, None).await.unwrap();
        self.submit(store).await;
        let lease = store.claim(&request("planner")).await.unwrap().remove(0);
        let started = Instant::now();
        store
            .commit(&lease.token, &TaskResult { plan: self.planned.clone(), ..TaskResult::default() })
            .await
            .unwrap();
        started.elapsed()
    }
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
