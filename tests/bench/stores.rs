//! Claims and commits a second on each store, without HTTP: one caller that waits for each answer, and sixteen. Before,
//! how long a plan of that many tasks takes to be taken in; after, how long the same bake takes that reuses them all.
//! Then callers that work in batches, at one server and at two, and claims and figures beside many ready tasks.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use lightkiln_proto::api::{BakeFilter, ClaimRequest, CommitVerdict, Needs, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_server::chunks::ChunkName;
use lightkiln_server::clock::SystemClock;
use lightkiln_server::store::chunk::KeptChunk;
use lightkiln_server::store::{FarmStore, SqlStore, Submission};
use sqlx::Connection as _;

use crate::model::MemoryStore;
use crate::parts::postgres::Postgres;
use crate::report::{millis, quantiles, row};

/// Tasks of a run. More → longer: each costs a few milliseconds.
const TASKS: usize = 2_000;
/// The same for the model, which counts all afresh with each call: its time grows with the square.
const MODEL_TASKS: usize = 300;
/// Callers beside one alone.
const CALLERS: usize = 16;

/// Kind of the tasks that plan.
const PLAN: &str = "plan";
/// Kind of a few tasks beside many.
const RARE: &str = "rare";
/// Leases of a claim, and results of a commit, of callers that work in batches.
const BATCH: u32 = 32;
/// Ready tasks beside which claims are timed, and a plan of that many is taken in.
const QUEUED: [usize; 2] = [1_000, 100_000];
/// Pause between two looks at a database's sessions.
const LOOK: Duration = Duration::from_millis(5);
/// Claims that are timed beside each.
const CLAIMS: usize = 400;

/// Measures each store.
pub fn measure() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let clock = Arc::new(SystemClock);
        measure_store("memory", Arc::new(MemoryStore::new(clock.clone())), MODEL_TASKS).await;
        let folder = tempfile::tempdir().unwrap();
        let sqlite = SqlStore::open_sqlite(&folder.path().join("farm.sqlite"), clock).await.unwrap();
        let sqlite: Arc<dyn FarmStore> = Arc::new(sqlite);
        measure_store("SQLite", sqlite.clone(), TASKS).await;
        measure_batches("SQLite", std::slice::from_ref(&sqlite)).await;
        measure_queued("SQLite", &*sqlite).await;
        // With its flushes, unlike in tests.
        let server = Postgres::start_with("");
        let open = async || {
            let store = SqlStore::open_postgres(&server.url(None), None).await.unwrap();
            Arc::new(store) as Arc<dyn FarmStore>
        };
        let stores = [open().await, open().await];
        measure_store("PostgreSQL", stores[0].clone(), TASKS).await;
        for (name, stores) in [("PostgreSQL", &stores[..1]), ("PostgreSQL, two servers", &stores)] {
            let (busy, waits) = (Busy::begin(), Waits::begin(server.url(None)));
            measure_batches(name, stores).await;
            row("processors busy meanwhile", name, &busy.end());
            row("what active sessions of the database did meanwhile", name, &waits.end().await);
        }
        measure_queued("PostgreSQL", &*stores[0]).await;
    });
}

async fn measure_store(name: &str, store: Arc<dyn FarmStore>, tasks: usize) {
    for callers in [1, CALLERS] {
        let place = format!("{name}, {callers} caller{}", if callers == 1 { "" } else { "s" });
        eprintln!("stores: {tasks} tasks on {place}");
        let run = Run::new(&format!("{name} {callers}"), tasks);
        if callers == 1 {
            row(&format!("plan of {} tasks", tasks + 1), name, &millis(run.plan(&*store).await));
        } else {
            run.plan(&*store).await;
        }
        row("claims and commits", &place, &work_all(std::slice::from_ref(&store), callers, 1).await);
        if callers == 1 {
            let started = Instant::now();
            run.submit(&*store).await;
            row(&format!("bake that reuses {} results", tasks + 2), name, &millis(started.elapsed()));
        }
    }
}

/// Sixteen callers that claim and commit in batches, shared out among servers that have a bake each.
async fn measure_batches(name: &str, stores: &[Arc<dyn FarmStore>]) {
    eprintln!("stores: batches on {name}");
    for number in 0..2 {
        Run::new(&format!("{name} batches {number}"), 2 * TASKS).plan(&*stores[0]).await;
    }
    let place = format!("{name}, {CALLERS} callers in batches of {BATCH}");
    row("claims and commits", &place, &work_all(stores, CALLERS, BATCH).await);
}

/// Plans, claims and figures of a farm with many ready tasks.
async fn measure_queued(name: &str, store: &dyn FarmStore) {
    for count in QUEUED {
        eprintln!("stores: {count} ready tasks on {name}");
        let run = Run::with_rare(&format!("{name} queued {count}"), count, CLAIMS);
        row(&format!("plan of {} tasks", count + 1), name, &millis(run.plan(store).await));
        for (kind, of) in [("work", "ready tasks"), (RARE, "ready tasks of another kind")] {
            let claim = ClaimRequest { kinds: vec![kind.to_owned()], ..request("queued", 1) };
            let mut claims = Vec::with_capacity(CLAIMS);
            for _ in 0..CLAIMS {
                let started = Instant::now();
                assert_eq!(store.claim(&claim).await.unwrap().len(), 1);
                claims.push(started.elapsed());
            }
            row(&format!("claim beside {count} {of}"), name, &quantiles(&mut claims));
        }
        let mut looks = Vec::new();
        for _ in 0..20 {
            let started = Instant::now();
            store.stats().await.unwrap();
            looks.push(started.elapsed());
        }
        row(&format!("figures for /metrics beside {count} ready tasks"), name, &quantiles(&mut looks));
        let bakes = store.list(&BakeFilter::default(), None, 1).await.unwrap().bakes;
        store.cancel(&bakes[0].id).await.unwrap();
    }
}

/// Lets callers work until nothing is ready; how many tasks a second they did.
async fn work_all(stores: &[Arc<dyn FarmStore>], callers: usize, batch: u32) -> String {
    let started = Instant::now();
    let runs =
        (0..callers).map(|caller| tokio::spawn(work(stores[caller % stores.len()].clone(), caller, batch)));
    let (mut done, mut claiming, mut committing) = (0, Duration::ZERO, Duration::ZERO);
    for run in runs.collect::<Vec<_>>() {
        let (tasks, claims, commits) = run.await.unwrap();
        (done, claiming, committing) = (done + tasks, claiming + claims, committing + commits);
    }
    let rate = f64::from(done) / started.elapsed().as_secs_f64();
    let [claim, commit] = [claiming, committing].map(|time| time.as_secs_f64() * 1000.0 / f64::from(done));
    format!("{rate:.0} of each a second; a claim {claim:.2} ms, a commit {commit:.2} ms")
}

/// Time that the machine's processors spend on anything.
struct Busy {
    began: Instant,
    ticks: u64,
}

impl Busy {
    fn begin() -> Self {
        Self { began: Instant::now(), ticks: Self::ticks() }
    }

    /// Ticks of all processors in `/proc/stat`, but idle ones and those that waited for disks.
    fn ticks() -> u64 {
        let stat = std::fs::read_to_string("/proc/stat").unwrap();
        let times: Vec<u64> =
            stat.lines().next().unwrap().split_whitespace().filter_map(|time| time.parse().ok()).collect();
        times.iter().take(8).sum::<u64>() - times[3] - times[4]
    }

    /// The share since the beginning.
    fn end(self) -> String {
        let cores = std::thread::available_parallelism().unwrap().get() as f64;
        let busy_secs = (Self::ticks() - self.ticks) as f64 / 100.0;
        format!("{:.0} %", 100.0 * busy_secs / (cores * self.began.elapsed().as_secs_f64()))
    }
}

/// Doings of the active sessions of a database, looked at again and again.
struct Waits {
    end: tokio::sync::oneshot::Sender<()>,
    looks: tokio::task::JoinHandle<BTreeMap<String, i64>>,
}

impl Waits {
    fn begin(url: String) -> Self {
        let (end, mut ended) = tokio::sync::oneshot::channel();
        let looks = tokio::spawn(async move {
            let sql = "SELECT coalesce(wait_event_type || ' ' || wait_event, 'run'), count(*) FROM pg_stat_activity
                 WHERE datname = current_database() AND pid <> pg_backend_pid() AND state = 'active' GROUP BY 1";
            let mut connection = sqlx::PgConnection::connect(&url).await.unwrap();
            let mut found = BTreeMap::new();
            while ended.try_recv().is_err() {
                let looked: Vec<(String, i64)> =
                    sqlx::query_as(sql).fetch_all(&mut connection).await.unwrap();
                for (doing, sessions) in looked {
                    *found.entry(doing).or_default() += sessions;
                }
                tokio::time::sleep(LOOK).await;
            }
            found
        });
        Self { end, looks }
    }

    /// Shares of all that they did, the largest first.
    async fn end(self) -> String {
        self.end.send(()).unwrap();
        let found = self.looks.await.unwrap();
        let all: i64 = found.values().sum();
        let mut found: Vec<(String, i64)> = found.into_iter().collect();
        found.sort_by_key(|(_, sessions)| -sessions);
        let share = |(doing, sessions): &(String, i64)| {
            format!("{doing} {:.0} %", 100.0 * *sessions as f64 / all as f64)
        };
        found.iter().take(5).map(share).collect::<Vec<_>>().join(", ")
    }
}

/// A bake: one task plans the others, as preparing does, and a last one needs them all.
pub struct Run {
    planner: TaskSpec,
    planned: Vec<TaskSpec>,
}

impl Run {
    /// A bake of so many tasks beside those two; another name gives other tasks.
    pub fn new(name: &str, tasks: usize) -> Self {
        // Of a kind of its own: who plans does not take a task of another run.
        let planner = TaskSpec { kind: PLAN.to_owned(), ..task(&format!("plan {name}"), &[]) };
        let planner = TaskSpec { key: planner.computed_key(), ..planner };
        let parts: Vec<TaskSpec> = (0..tasks).map(|i| task(&format!("{name} {i}"), &[&planner])).collect();
        let last = task(&format!("last {name}"), &parts.iter().collect::<Vec<_>>());
        Self { planner, planned: parts.into_iter().chain([last]).collect() }
    }

    /// The same, with some tasks of another kind that come after all others by their cost.
    fn with_rare(name: &str, tasks: usize, rare: usize) -> Self {
        let mut run = Self::new(name, tasks);
        for number in 0..rare {
            let inputs = vec![TaskInput::Task { name: "in".into(), key: run.planner.key }];
            let params = serde_json::json!({ "name": format!("{name} rare {number}") });
            run.planned.push(TaskSpec::new(RARE, 1, "rare", params, inputs, 1));
        }
        run
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
        let token = self.claim_planner(store).await;
        Self::commit_plan(store, &token, &self.result()).await
    }

    /// Submits, and claims the planner.
    pub async fn claim_planner(&self, store: &dyn FarmStore) -> String {
        let scene = KeptChunk { name: ChunkName::from(Digest::of(b"")), bytes: 0 };
        store.keep_chunk(scene, None, None).await.unwrap();
        self.submit(store).await;
        let request = ClaimRequest { kinds: vec![PLAN.to_owned()], ..request("planner", 1) };
        store.claim(&request).await.unwrap().remove(0).token
    }

    /// The planner's result.
    pub fn result(&self) -> TaskResult {
        TaskResult { plan: self.planned.clone(), ..TaskResult::default() }
    }

    /// Hands the planner's result in; how long that took.
    pub async fn commit_plan(store: &dyn FarmStore, token: &str, result: &TaskResult) -> Duration {
        let started = Instant::now();
        assert_eq!(store.commit(token, result).await.unwrap(), CommitVerdict::Committed);
        started.elapsed()
    }
}

/// Claims and commits until nothing is ready: tasks, time of claims, time of commits.
async fn work(store: Arc<dyn FarmStore>, caller: usize, batch: u32) -> (u32, Duration, Duration) {
    let request = request(&format!("worker {caller}"), batch);
    let result = TaskResult::default();
    let (mut done, mut claiming, mut committing) = (0, Duration::ZERO, Duration::ZERO);
    loop {
        let started = Instant::now();
        let leases = store.claim(&request).await.unwrap();
        if leases.is_empty() {
            return (done, claiming, committing);
        }
        claiming += started.elapsed();
        let started = Instant::now();
        let commits: Vec<_> = leases.iter().map(|lease| (lease.token.as_str(), &result)).collect();
        for verdict in store.commit_all(&commits).await {
            assert_eq!(verdict.unwrap(), CommitVerdict::Committed);
            done += 1;
        }
        committing += started.elapsed();
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
        limits: Default::default(),
        verify_share: 0.0,
    }
}

fn task(name: &str, needs: &[&TaskSpec]) -> TaskSpec {
    let inputs = needs.iter().map(|task| TaskInput::Task { name: "in".into(), key: task.key }).collect();
    TaskSpec::new("work", 1, name, serde_json::json!({ "name": name }), inputs, name.len() as u64)
}

fn request(worker: &str, max: u32) -> ClaimRequest {
    ClaimRequest {
        worker: worker.into(),
        kinds: vec!["work".into()],
        threads: 1,
        memory_mib: 0,
        labels: Vec::new(),
        machine: String::new(),
        max,
        ttl_secs: 3600,
        wait_secs: 0,
    }
}
