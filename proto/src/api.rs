//! Every message of the HTTP API in one place: people's side (bakes) and workers' side (leases).
//!
//! | call | body → answer |
//! |---|---|
//! | `HEAD, GET, PUT /v1/chunks/{digest}` | bytes; scenes and artefacts are chunks too |
//! | `HEAD, PUT /v1/scenes/{digest}` | the scene bundle's bytes → [`SceneStored`] |
//! | `PUT /v1/scene-parts/{digest}` | bytes of a part of a scene |
//! | `POST /v1/scenes/{digest}/parts` | [`SceneParts`] → [`SceneProgress`] |
//! | `POST /v1/bakes` (`Idempotency-Key`) | [`NewBake`] → 202 [`Bake`] |
//! | `GET /v1/bakes?after&limit&state&name&since_ms` | [`BakePage`] of the bakes that a [`BakeFilter`] takes |
//! | `…/v1/bakes/{id}…` | `id` may be shortened to a beginning, of [`MIN_ID_CHARS`] or more, that one bake's alone has |
//! | `GET, DELETE /v1/bakes/{id}` | [`Bake`], 204 |
//! | `POST /v1/bakes/{id}/cancel`, `…/pause`, `…/resume` | → [`Bake`] |
//! | `POST /v1/bakes/{id}/priority` | [`NewPriority`] → [`Bake`] |
//! | `GET, DELETE /v1/bakes/{id}/blocklist?worker` | [`Blocklist`] |
//! | `GET /v1/bakes/{id}/events?after&wait_secs` | [`EventPage`], or SSE of [`BakeEvent`] when `text/event-stream` is accepted |
//! | `GET /v1/bakes/{id}/results?kind&after&limit&wait_secs` | [`ResultPage`] of results as they land (long poll) |
//! | `GET /v1/bakes/{id}/manifest`, `…/report` | JSON as the bake's last task wrote it |
//! | `GET, PUT /v1/bakes/{id}/evaluation` | [`EvaluationIndex`] of a finished bake → 204 |
//! | `GET, PUT /v1/bakes/{id}/evaluation/files/{digest}` | bytes of a file of it, stored before it is named |
//! | `GET /v1/workers` | [`WorkerPage`] |
//! | `POST /v1/leases` | [`ClaimRequest`] → [`ClaimAnswer`] (long poll) |
//! | `POST /v1/leases/{token}/heartbeat` | [`Heartbeat`] → [`HeartbeatAnswer`] |
//! | `POST /v1/leases/{token}/commit` | [`TaskResult`] → [`CommitAnswer`] |
//! | `POST /v1/leases/commit` | [`Commits`] of several leases → [`CommitsAnswer`] |
//! | `POST /v1/leases/{token}/fail` | [`Failure`] → 204 |
//! | `POST /v1/leases/{token}/release` | → 204 |
//! | `POST /v1/enrolments` (a code as bearer token) | [`Enrolment`] → [`Enrolled`] |

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::ids::Digest;
use crate::jobs::{Artefact, TaskSpec};

pub use crate::commits::{Commit, CommitOutcome, Commits, CommitsAnswer, MAX_COMMITS};
pub use crate::evaluation::EvaluationIndex;
pub use crate::events::{BakeEvent, EventKind, EventPage};
pub use crate::filter::BakeFilter;
pub use crate::jobs::TaskResult;
pub use crate::limits::BakeLimits;
pub use crate::results::{BakeResult, MAX_PAGE_RESULTS, ResultPage};
pub use crate::scene_parts::{
    MAX_SCENE_PART_BYTES, MAX_SCENE_PARTS, SCENE_PART_BYTES, ScenePart, SceneParts, SceneProgress,
    SceneStored,
};

/// Fewest characters that a bake's id may be shortened to. Fewer → less to type, and a slip means another bake sooner.
pub const MIN_ID_CHARS: usize = 4;

/// Most bytes under one digest, scene bundle, artefact or chunk: 2 GiB. Larger → larger scenes, more memory in workers.
pub const MAX_CHUNK_BYTES: u64 = 2 << 30;

/// Asks for a bake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewBake {
    /// For people; need not be unique. At most 200 characters.
    #[schema(max_length = 200)]
    pub name: String,
    /// Digest of an uploaded scene bundle.
    pub scene: Digest,
    /// Kind of bake; absent or empty means the server's default.
    #[serde(default)]
    pub kind: String,
    /// Settings as the kind of bake documents them; absent or null means its defaults.
    #[serde(default)]
    #[schema(value_type = Option<Object>)]
    pub settings: serde_json::Value,
    /// Bigger runs first; 0 unless set.
    #[serde(default)]
    pub priority: i32,
    /// Requirements on workers that take tasks of this bake; none unless set.
    #[serde(default, skip_serializing_if = "Needs::is_none")]
    pub needs: Needs,
    /// Seconds that one attempt at a task may take, 1..=604800; then it counts as failed by its worker, however often
    /// that is heard from. Smaller → a stuck worker is noticed sooner; too small → slow machines fail. A day unless set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 604800)]
    pub attempt_limit_secs: Option<u32>,
    /// Limits of workers and attempts; the farm's unless set.
    #[serde(default, skip_serializing_if = "BakeLimits::is_none")]
    pub limits: BakeLimits,
    /// Share of its results, 0..=1, that an idle worker of another machine makes once more and that must come out alike; 0 unless set.
    /// Tasks are chosen by their keys. More → a machine that gives wrong bytes is found sooner, and that much more is
    /// computed, after tasks of all bakes. Of a task that several bakes want, the biggest share counts.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub verify_share: f64,
}

fn is_zero(share: &f64) -> bool {
    *share == 0.0
}

/// Requirements of a bake on the workers that take its tasks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Needs {
    /// Memory in MiB, at least.
    #[serde(default)]
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub memory_mib: u32,
    /// Threads, at least.
    #[serde(default)]
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub threads: u32,
    /// Labels, all of them; at most 16, of 1 to 64 characters.
    #[serde(default)]
    #[schema(max_items = 16, value_type = Vec<Label>)]
    pub labels: Vec<String>,
}

/// Pattern of a label, for the API's description.
#[derive(ToSchema)]
#[schema(min_length = 1, max_length = 64)]
#[expect(dead_code, reason = "it describes texts, which stay texts")]
struct Label(String);

impl Needs {
    /// Any worker will do.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// Where a bake stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BakeState {
    /// Has tasks that are not done.
    Running,
    /// Holds its tasks back until resumed.
    Paused,
    /// Every task is done; manifest and report can be fetched.
    Done,
    /// A task failed for good; see `failure`.
    Failed,
    /// Was cancelled.
    Cancelled,
}

impl BakeState {
    /// All states.
    pub const ALL: [Self; 5] = [Self::Running, Self::Paused, Self::Done, Self::Failed, Self::Cancelled];

    /// The state's name, as in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// The state of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }

    /// No more will happen.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

/// A bake as the server sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Bake {
    /// Id, unique on this farm.
    pub id: String,
    /// Name given with it.
    pub name: String,
    /// Kind of bake.
    pub kind: String,
    /// The scene bundle.
    pub scene: Digest,
    /// Settings as given; null if none were.
    #[schema(value_type = Option<Object>)]
    pub settings: serde_json::Value,
    /// Bigger runs first.
    pub priority: i32,
    /// Requirements on workers that take its tasks.
    #[serde(default)]
    pub needs: Needs,
    /// Limits of workers and attempts that it was submitted with.
    #[serde(default, skip_serializing_if = "BakeLimits::is_none")]
    pub limits: BakeLimits,
    /// Share of its results that are made once more on another machine, as it was submitted with.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub verify_share: f64,
    /// Where it stands.
    pub state: BakeState,
    /// Tasks by stage, in the order in which stages first appeared.
    pub stages: Vec<StageCount>,
    /// Tasks run for this bake.
    pub tasks_run: u64,
    /// Tasks whose result was there already.
    pub tasks_reused: u64,
    /// Results that are no longer there, as their bytes were lost after the bake had ended; 0 for a bake that is whole.
    /// A new bake of the scene makes them again, for this one, too.
    #[serde(default)]
    pub results_lost: u64,
    /// Attempts at its tasks that failed.
    #[serde(default)]
    pub attempts_failed: u64,
    /// Attempts at its tasks whose workers were lost.
    #[serde(default)]
    pub attempts_lost: u64,
    /// Results of its tasks that differed from one attempt to another (`result_differs` among its events): 0 unless a machine, or the
    /// code of a task, is not to be trusted.
    #[serde(default)]
    pub alarms: u64,
    /// The bearer whose token submitted it; it alone, and those with the scope admin, may change it. Absent where none was needed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
    /// Why it failed.
    pub failure: Option<String>,
    /// Digest of the manifest when done.
    pub manifest: Option<Digest>,
    /// Digest of the report when done.
    pub report: Option<Digest>,
    /// Digest of the index of the evaluation attached to it, if one is.
    #[serde(default)]
    pub evaluation: Option<Digest>,
    /// Submission time, Unix milliseconds.
    pub created_ms: i64,
    /// End time, Unix milliseconds.
    pub finished_ms: Option<i64>,
    /// Sum of the counters of the tasks run for this bake (reused ones count in `counters_reused`).
    pub counters: std::collections::BTreeMap<String, f64>,
    /// Sum of the counters that reused tasks had when they ran.
    pub counters_reused: std::collections::BTreeMap<String, f64>,
}

/// Changes a bake's priority.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewPriority {
    /// Bigger runs first.
    pub priority: i32,
}

/// Progress of one stage; its name is the task kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StageCount {
    /// Task kind.
    pub kind: String,
    /// All tasks.
    pub total: u64,
    /// Tasks done, reused ones included.
    pub done: u64,
    /// Tasks whose result was there already.
    pub reused: u64,
    /// Tasks held by a worker now.
    pub leased: u64,
    /// Sum of `cost` over all tasks, and over done ones.
    pub cost_total: u64,
    /// See `cost_total`.
    pub cost_done: u64,
    /// Milliseconds from the first claim to the last commit so far.
    pub elapsed_ms: u64,
}

/// Bakes, newest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BakePage {
    /// The page.
    pub bakes: Vec<Bake>,
    /// Give as `after` for the next page; absent on the last.
    pub next: Option<u64>,
}

/// A worker as the server sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Worker {
    /// Its name.
    pub name: String,
    /// Task kinds that it takes.
    pub kinds: Vec<String>,
    /// Threads that it uses.
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub threads: u32,
    /// Memory in MiB that its tasks may use.
    #[serde(default)]
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub memory_mib: u32,
    /// Its labels.
    #[serde(default)]
    pub labels: Vec<String>,
    /// Last time it was heard, Unix milliseconds.
    pub seen_ms: i64,
    /// Labels of the tasks that it holds.
    pub holds: Vec<String>,
}

/// All workers heard of lately.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WorkerPage {
    /// By name.
    pub workers: Vec<Worker>,
}

/// Workers that failed at tasks of a bake.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Blocklist {
    /// By name.
    pub workers: Vec<BlockedWorker>,
}

/// A worker that failed at tasks of a bake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BlockedWorker {
    /// Its name.
    pub worker: String,
    /// Tasks of the bake at which it failed.
    pub tasks: u64,
    /// It failed at so many that it gets none of this bake any more while another worker can do them.
    pub is_blocked: bool,
}

/// A worker asks for tasks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClaimRequest {
    /// The worker's name, unique on the farm; 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    pub worker: String,
    /// Task kinds that it knows; at most 64.
    #[schema(max_items = 64)]
    pub kinds: Vec<String>,
    /// Threads that it uses.
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub threads: u32,
    /// Memory in MiB that its tasks may use; 0 takes no bake that asks for some.
    #[serde(default)]
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub memory_mib: u32,
    /// Its labels, at most 16, of 1 to 64 characters: bakes may ask for them.
    #[serde(default)]
    #[schema(max_items = 16, value_type = Vec<Label>)]
    pub labels: Vec<String>,
    /// The machine that it runs on, the same for all workers there; at most 200 characters. Results are verified on another one. Empty
    /// where it cannot be told: then on another worker.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    #[schema(max_length = 200)]
    pub machine: String,
    /// At most this many leases, 1..=64.
    #[schema(minimum = 1, maximum = 64)]
    pub max: u32,
    /// Lease length in seconds, 5..=3600.
    #[schema(minimum = 5, maximum = 3600)]
    pub ttl_secs: u32,
    /// Wait this long for work before an empty answer, 0..=60.
    #[schema(maximum = 60)]
    pub wait_secs: u32,
}

/// Tasks handed out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClaimAnswer {
    /// Perhaps none.
    pub leases: Vec<Lease>,
}

/// The right to do one task until it expires.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Lease {
    /// Fencing token; names this attempt alone.
    pub token: String,
    /// Bake that the task belongs to.
    pub bake: String,
    /// The task.
    pub task: TaskSpec,
    /// Its inputs, resolved: `name` for artefacts, `name/output` for outputs of other tasks, in the task's order.
    pub inputs: Vec<Artefact>,
    /// Outputs of tasks alike that are done, newest first: hints that may be gone, and change no result.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alike: Vec<Vec<Artefact>>,
    /// Expiry, Unix milliseconds by the server's clock.
    pub expires_ms: i64,
    /// Trace that the bake's submission belongs to (W3C Trace Context), if it belongs to one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traceparent: Option<String>,
}

/// Says that a task is still being worked on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Heartbeat {
    /// Share done, 0..=1.
    #[schema(minimum = 0, maximum = 1)]
    pub progress: f32,
}

/// Order to a worker about a task that it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Go on; the lease is longer now.
    Keep,
    /// The bake was cancelled; stop, and release.
    Cancel,
    /// The lease is gone; stop, a result will be refused.
    Lost,
}

/// Answer to a heartbeat.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct HeartbeatAnswer {
    /// The order.
    pub verdict: Verdict,
    /// New expiry, Unix milliseconds.
    pub expires_ms: i64,
}

/// Fate of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CommitVerdict {
    /// It is the task's result.
    Committed,
    /// This very lease committed it before: the answer was lost on the way.
    AlreadyCommitted,
    /// The lease had run out or the bake was cancelled: refused, nothing changed.
    Stale,
}

/// Answer to a result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CommitAnswer {
    /// Its fate.
    pub verdict: CommitVerdict,
}

/// A worker exchanges a code for the right to work. It makes its token itself, so that the token stays where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Enrolment {
    /// blake3 digest of the token that the worker will call with: 256 random bits or more.
    pub token: Digest,
}

/// A worker that may work.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Enrolled {
    /// The name under which its token is listed and revoked.
    pub name: String,
}

/// Who is to blame for a failed attempt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Blame {
    /// The task itself (bad input): no other worker would do better, the bake fails.
    Task,
    /// This worker (out of memory, disk full, network): another may do better.
    #[default]
    Worker,
    /// Nobody: the worker's process or machine ended while it had the task, as its next start tells, or its memory was taken by others.
    Lost,
}

/// A failed attempt.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Failure {
    /// Who is to blame.
    pub blame: Blame,
    /// Event and remedy; only the first 4,000 characters are kept.
    pub message: String,
}
