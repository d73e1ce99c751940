//! A farm to test, tasks to run on it, and a worker's everyday moves.

use std::sync::Arc;
use std::time::Duration;

use crate::clock::ManualClock;
use crate::model::MemoryStore;
use crate::parts::postgres::empty_schema;
use lightkiln_proto::api::{
    Bake, BakeEvent, BakeState, ClaimRequest, CommitVerdict, Lease, Needs, NewBake, Verdict,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, TaskInput, TaskResult, TaskSpec};
use lightkiln_server::chunks::{ChunkName, ObjectChunks};
use lightkiln_server::store::chunk::KeptChunk;
use lightkiln_server::store::{FarmStore, SqlStore, Submission};
use object_store::memory::InMemory;

/// Lease length of the tests' claims.
pub const TTL_SECS: u32 = 30;
/// The same in milliseconds.
pub const TTL_MS: i64 = 30_000;

/// Longest that one thing may take, however busy the machine is.
const LIMIT: Duration = Duration::from_secs(240);

/// Waits for something that must come.
pub async fn in_time<T>(future: impl Future<Output = T>) -> T {
    let Ok(value) = tokio::time::timeout(LIMIT, future).await else { panic!("not done within {LIMIT:?}") };
    value
}

/// A store over a clock that stands still.
pub struct World {
    pub store: Arc<dyn FarmStore>,
    pub clock: Arc<ManualClock>,
    _folder: Option<tempfile::TempDir>,
}

/// Where every world's clock stands at first.
const START_MS: i64 = 1_000_000;

/// A task of kind `work` with that name and those dependencies.
pub fn task(name: &str, needs: &[&TaskSpec]) -> TaskSpec {
    task_of("work", name, needs, 1)
}

/// A task of a kind and a cost.
pub fn task_of(kind: &str, name: &str, needs: &[&TaskSpec], cost: u64) -> TaskSpec {
    let inputs = needs.iter().enumerate();
    let inputs = inputs.map(|(i, needs)| TaskInput::Task { name: format!("in{i}"), key: needs.key });
    TaskSpec::new(kind, 1, name, serde_json::json!({ "name": name }), inputs.collect(), cost)
}

/// A bake of the scene.
pub fn new_bake(name: &str, kind: &str) -> NewBake {
    NewBake {
        name: name.into(),
        scene: Digest::of(SCENE),
        kind: kind.into(),
        settings: serde_json::json!({}),
        priority: 0,
        needs: Needs::default(),
        attempt_limit_secs: None,
        limits: Default::default(),
        verify_share: 0.0,
    }
}

/// A submission without an idempotency key.
pub fn submission(name: &str, plan: &[TaskSpec]) -> Submission {
    let settings = serde_json::json!({ "preset": "draft" });
    let bake = NewBake { settings, ..new_bake(name, "test") };
    let body_hash = Digest::of(name.as_bytes());
    Submission { idempotency_key: None, body_hash, traceparent: None, owner: None, bake, plan: plan.to_vec() }
}

/// A claim of kind `work`.
pub fn request(worker: &str, max: u32) -> ClaimRequest {
    let kinds = vec!["work".to_owned(), "more".to_owned()];
    ClaimRequest {
        worker: worker.into(),
        kinds,
        threads: 2,
        memory_mib: 0,
        labels: Vec::new(),
        machine: String::new(),
        max,
        ttl_secs: TTL_SECS,
        wait_secs: 0,
    }
}

/// Bytes that tests need not store: every world has them.
pub const SCENE: &[u8] = b"scene";
/// Chunks that tasks' outputs are taken from.
const OUTPUTS: u8 = 4;
/// Length of each output.
const OUTPUT_BYTES: u64 = 32;

/// The outputs of a task: a pure function of its key.
pub fn outputs(key: TaskKey) -> Vec<Artefact> {
    vec![Artefact { name: "out".into(), digest: output(key.0[0]), bytes: OUTPUT_BYTES }]
}

/// One of the chunks that outputs are taken from.
pub fn output(number: u8) -> Digest {
    Digest::of(&[number % OUTPUTS])
}

/// A chunk of that digest, stored for the `generation`-th time.
pub fn chunk(digest: Digest, generation: u64) -> KeptChunk {
    KeptChunk { name: ChunkName { digest, generation }, bytes: OUTPUT_BYTES }
}

/// Stores the scene and the outputs, unless that was done before.
pub async fn stock(store: &dyn FarmStore) {
    let digests = (0..OUTPUTS).map(output).chain([Digest::of(SCENE)]);
    let digests: Vec<Digest> = digests.collect();
    let known = store.find_chunks(&digests).await.unwrap();
    for digest in digests.into_iter().filter(|digest| !known.iter().any(|chunk| chunk.name.digest == *digest))
    {
        store.keep_chunk(chunk(digest, 1), None, None).await.unwrap();
    }
}

/// A result with that plan.
pub fn result(lease: &Lease, plan: &[TaskSpec]) -> TaskResult {
    let counters = [("rays".to_owned(), 10.0)].into();
    TaskResult { outputs: outputs(lease.task.key), plan: plan.to_vec(), counters, ..TaskResult::default() }
}

impl World {
    pub async fn memory() -> Self {
        let clock = Arc::new(ManualClock::at(START_MS));
        let store = MemoryStore::new(clock.clone());
        stock(&store).await;
        Self { store: Arc::new(store), clock, _folder: None }
    }

    pub async fn sqlite() -> Self {
        let clock = Arc::new(ManualClock::at(START_MS));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("farm.sqlite");
        let store = SqlStore::open_sqlite(&path, clock.clone()).await.unwrap();
        stock(&store).await;
        Self { store: Arc::new(store), clock, _folder: Some(folder) }
    }

    pub async fn postgres() -> Self {
        let clock = Arc::new(ManualClock::at(START_MS));
        let url = empty_schema().await;
        let store = SqlStore::open_postgres(&url, Some(clock.clone())).await.unwrap();
        stock(&store).await;
        Self { store: Arc::new(store), clock, _folder: None }
    }

    pub async fn submit(&self, name: &str, plan: &[TaskSpec]) -> Bake {
        self.store.submit(&submission(name, plan)).await.unwrap().bake
    }

    pub async fn submit_at(&self, name: &str, priority: i32, plan: &[TaskSpec]) -> Bake {
        let mut submission = submission(name, plan);
        submission.bake.priority = priority;
        self.store.submit(&submission).await.unwrap().bake
    }

    pub async fn claim(&self, worker: &str, max: u32) -> Vec<Lease> {
        self.store.claim(&request(worker, max)).await.unwrap()
    }

    /// Claims one task, which must be there.
    pub async fn claim_one(&self, worker: &str) -> Lease {
        self.claim(worker, 1).await.pop().expect("a task is ready")
    }

    /// The same, and the worker says that it has it.
    pub async fn begin_one(&self, worker: &str) -> Lease {
        let lease = self.claim_one(worker).await;
        assert_eq!(self.store.heartbeat(&lease.token, 0.0).await.unwrap().verdict, Verdict::Keep);
        lease
    }

    /// Labels of the tasks that a worker is given.
    pub async fn claim_labels(&self, worker: &str, max: u32) -> Vec<String> {
        self.claim(worker, max).await.into_iter().map(|lease| lease.task.label).collect()
    }

    pub async fn commit(&self, lease: &Lease) -> CommitVerdict {
        self.commit_plan(lease, &[]).await
    }

    pub async fn commit_plan(&self, lease: &Lease, plan: &[TaskSpec]) -> CommitVerdict {
        self.store.commit(&lease.token, &result(lease, plan)).await.unwrap()
    }

    /// Runs all ready tasks, and those that become ready by it; returns their number.
    pub async fn drain(&self, worker: &str) -> usize {
        let mut count = 0;
        loop {
            let leases = self.claim(worker, 16).await;
            if leases.is_empty() {
                return count;
            }
            for lease in leases {
                assert_eq!(self.commit(&lease).await, CommitVerdict::Committed);
                count += 1;
            }
        }
    }

    pub async fn show(&self, bake: &Bake) -> Bake {
        self.store.show(&bake.id).await.unwrap()
    }

    pub async fn state(&self, bake: &Bake) -> BakeState {
        self.show(bake).await.state
    }

    pub async fn events(&self, bake: &Bake) -> Vec<BakeEvent> {
        self.store.events_after(&bake.id, 0, 1000).await.unwrap().events
    }

    /// Lets every lease run out, and reaps; returns how many did.
    pub async fn expire_leases(&self) -> u64 {
        self.clock.advance_ms(TTL_MS);
        self.store.reap().await.unwrap().expired
    }
}

/// A chunk store without files.
pub fn chunks_in_memory() -> ObjectChunks {
    ObjectChunks::over(Arc::new(InMemory::new()))
}
