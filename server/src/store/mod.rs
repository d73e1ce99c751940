//! The queue: bakes, tasks, leases and events, behind one trait.
//!
//! **Delivery** is at least once, the **effect** exactly once. Every claim gives a fencing token; [`FarmStore::commit`]
//! compares it in the transaction that writes the result, the events, the plan's new tasks and the unlocking of
//! dependants. A holder whose lease has run out is refused, whether or not anyone has noticed yet.
//!
//! **Tasks belong to the farm.** A key that has a result is never run again: a bake that asks for it counts it as
//! reused and takes over its plan. A key that another live bake waits for runs once for both.
//!
//! **States of a task**
//! ```text
//! waiting ──dependencies done──▶ ready ──claim──▶ leased ──commit──▶ done
//!                                  ▲               │ fail (worker), release, expiry
//!                                  └───────────────┘
//! ```
//! A task that nobody wants any more, or that failed for good, is dropped: there is no failed state to get stuck in.

pub mod chunk;
mod error;
mod lease;
pub mod limits;
pub mod rules;
mod sql;
pub mod verify;

use std::collections::BTreeSet;

use async_trait::async_trait;
use lightkiln_proto::api::{
    Bake, BakeFilter, BakePage, BakeState, Blame, Blocklist, ClaimRequest, CommitVerdict, EventPage,
    HeartbeatAnswer, Lease, Needs, NewBake, ResultPage, Worker,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, TaskResult, TaskSpec};

use crate::access::{Bearer, Scope};
use crate::chunks::ChunkName;

use chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
pub use error::{PlanError, Result, StoreError};
pub use lease::LeaseState;
pub use rules::{
    BACKOFF_MAX_MS, FarmRules, LOST_WORKERS, MAX_ATTEMPTS, MAX_GRACES, MAX_PARDONS, POISON_WORKERS,
    WAIT_MAX_MS, backoff_ms,
};
pub use sql::{FaultPoint, Faults, SqlStore};
pub use verify::Maker;

/// A bake to take in.
#[derive(Clone, Debug)]
pub struct Submission {
    /// Submitting again under the same key gives the same bake.
    pub idempotency_key: Option<String>,
    /// Digest of the request; another one under the same key is refused.
    pub body_hash: Digest,
    /// Trace that the submission belongs to, as W3C Trace Context writes it.
    pub traceparent: Option<String>,
    /// Bearer that submits it, if one was needed.
    pub owner: Option<String>,
    /// The bake asked for.
    pub bake: NewBake,
    /// Its first tasks.
    pub plan: Vec<TaskSpec>,
}

/// A bake as people tell it from others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// Its id.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Where it stands.
    pub state: BakeState,
}

/// Outcome of a submission.
#[derive(Clone, Debug, PartialEq)]
pub struct Submitted {
    /// The bake.
    pub bake: Bake,
    /// False when the idempotency key named it already.
    pub is_new: bool,
}

/// A task that is done already, and its outputs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownResult {
    /// The task.
    pub key: TaskKey,
    /// Its outputs.
    pub outputs: Vec<Artefact>,
    /// Artefacts named by those tasks that it planned and that are not done.
    pub named: BTreeSet<Digest>,
}

impl KnownResult {
    /// The results found along a plan, in that order.
    pub fn all(found: Vec<(TaskKey, TaskResult)>) -> Vec<Self> {
        let done: BTreeSet<TaskKey> = found.iter().map(|(key, _)| *key).collect();
        let known = |(key, result): (TaskKey, TaskResult)| {
            let open = result.plan.iter().filter(|task| !done.contains(&task.key));
            Self { key, named: open.flat_map(rules::named_artefacts).collect(), outputs: result.outputs }
        };
        found.into_iter().map(known).collect()
    }
}

/// Outcome of a reported failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailVerdict {
    /// The task will be tried again.
    Retry,
    /// The task was given up, and the bakes that wanted it have failed.
    GivenUp,
    /// A result was to be made once more; its bakes stay as they are.
    Rerun,
    /// The lease was gone: nothing changed.
    Stale,
}

/// Expired leases that the reaper ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reaped {
    /// Leases that had run out.
    pub expired: u64,
    /// Those whose workers count as lost.
    pub lost: u64,
    /// Tasks given up because of that.
    pub given_up: u64,
}

/// State of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TaskState {
    /// Some of its dependencies are not done.
    Waiting,
    /// Can be claimed, or could if its bakes were not paused.
    Ready,
    /// Held by a worker.
    Leased,
    /// Has its result.
    Done,
}

impl TaskState {
    /// Name in metrics and in the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Ready => "ready",
            Self::Leased => "leased",
            Self::Done => "done",
        }
    }
}

/// Number of tasks of a kind in one state.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TaskCount {
    /// Task kind.
    pub kind: String,
    /// Their state.
    pub state: TaskState,
    /// Their number.
    pub count: u64,
}

/// Ready tasks of running bakes that ask for the same kind of worker, as far as more workers could take them; one that two bakes want
/// counts for both. A bake with a limit of workers asks for no more tasks than it has places for others, one for each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Demand {
    /// Task kind.
    pub kind: String,
    /// Needs of their bakes.
    pub needs: Needs,
    /// Their number.
    pub ready: u64,
    /// Of bakes that have places: for how long the one that has waited longest could have been claimed, in milliseconds: since it became ready, its
    /// wait after a failure was over, or its bake's pause ended.
    pub waited_ms: u64,
}

/// The farm as those who wait want to know it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Look {
    /// Work that can be claimed now, by kind and needs, in no order.
    pub openings: Vec<Opening>,
    /// The bakes that were asked for, but those that are not there, in no order.
    pub standings: Vec<Standing>,
}

/// Ready tasks of running bakes of one kind that ask for the same kind of worker; of one bake alone, if that has a limit of workers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Opening {
    /// Task kind.
    pub kind: String,
    /// Needs of their bakes.
    pub needs: Needs,
    /// Their number, as far as it was counted; one at least.
    pub ready: u64,
    /// The workers that may take them, where their bake has a limit of workers.
    pub room: Option<Room>,
    /// The worker that gave their results, where these are there and are to be verified: for workers of other machines, once there is
    /// nothing else ([`verify`]).
    pub maker: Option<Maker>,
}

/// Workers that a bake with a limit has room for.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Room {
    /// Those that hold tasks of it, by name; they may take more.
    pub holders: BTreeSet<String>,
    /// How many others may join them.
    pub others: u64,
}

/// How far a bake has come.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Standing {
    /// Its id.
    pub bake: String,
    /// It has ended.
    pub is_final: bool,
    /// `seq` of its newest event.
    pub last_event: u64,
    /// Place of its newest result.
    pub last_place: u64,
}

/// Figures about the whole farm.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stats {
    /// Tasks by kind and state, ascending; none with a count of 0.
    pub tasks: Vec<TaskCount>,
    /// Ready tasks that more workers could take, by kind and needs; none with a count of 0.
    pub demand: Vec<Demand>,
    /// Bakes that are running or paused.
    pub bakes_live: u64,
    /// All bakes.
    pub bakes_total: u64,
    /// Tasks run since the farm began, for each bake that wanted them. Never falls.
    pub tasks_run: u64,
    /// Tasks whose result was there already when a bake wanted them, since the farm began. Never falls.
    pub tasks_reused: u64,
    /// Results that were not as another one of their task, since the farm began. Never falls.
    pub alarms: u64,
    /// Results that were made once more and compared, since the farm began. Never falls.
    pub verified: u64,
    /// Results that wait for that, or are being made once more.
    pub reruns_waiting: u64,
    /// Results that were to be made once more and were not: for want of time, workers or inputs. Never falls.
    pub reruns_lapsed: u64,
}

/// The farm's state. Every call is one transaction: all of it happened, or none.
#[async_trait]
pub trait FarmStore: Send + Sync {
    /// Takes a bake in. Tasks that are done already count as reused, and their plans are applied in turn.
    async fn submit(&self, submission: &Submission) -> Result<Submitted>;

    /// Results that `plan` would reuse, plans of reused results included.
    async fn reusable(&self, plan: &[TaskSpec]) -> Result<Vec<KnownResult>>;

    /// Forgets results whose bytes are lost: tasks that a live bake wants run again; dependants, and tasks that name an
    /// output by its digest, wait for them again. A worker whose attempt fails after it lost an input is not to blame. A
    /// bake fails when its tasks still need bytes that were not made again. Bakes that have ended count the result as lost ([`Bake::results_lost`]) until a bake runs the task again.
    async fn forget(&self, keys: &[TaskKey]) -> Result<()>;

    /// Hands out up to `max` ready tasks. One by one they come from the bake with the highest priority, of those from the
    /// one with the fewest tasks under way ([`rules`] says more), of a bake by cost ([`rules::claim_cost`]), then key. A bake at its
    /// limit of workers ([`lightkiln_proto::limits`]) gives tasks to those alone that hold some of it. A claim that finds none gets a task
    /// that is done, if its result is to be verified and this worker may do so ([`verify`]).
    async fn claim(&self, request: &ClaimRequest) -> Result<Vec<Lease>>;

    /// The work that running bakes have for those who can do it, counted up to `enough` for each kind of a bake, and how far these bakes
    /// have come.
    async fn look(&self, bakes: &[String], enough: u64) -> Result<Look>;

    /// Notes that workers are there: their claims wait. Those that have never claimed are not made.
    async fn note_present(&self, workers: &[String]) -> Result<()>;

    /// Prolongs a lease, or says why not. The first one says that the lease has arrived.
    async fn heartbeat(&self, token: &str, progress: f32) -> Result<HeartbeatAnswer>;

    /// Takes a result in if the lease is still good. One that is not as another of the same task, because it comes again, too late, or
    /// anew, is noted and told to the bakes that hold the task ([`rules::difference`]); the one that counts stays. The result of a task
    /// that was done is only compared.
    async fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict>;

    /// Takes several results in, each as if it had come alone, in any order; the verdicts are in theirs.
    async fn commit_all(&self, commits: &[(&str, &TaskResult)]) -> Vec<Result<CommitVerdict>> {
        let mut verdicts = Vec::with_capacity(commits.len());
        for (token, result) in commits {
            verdicts.push(self.commit(token, result).await);
        }
        verdicts
    }

    /// Ends an attempt without a result. Failures of workers, and workers that were lost, are counted apart.
    async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<FailVerdict>;

    /// Gives a task back; no attempt is counted. False when the lease was gone.
    async fn release(&self, token: &str) -> Result<bool>;

    /// Gives every lease that has at most half its length left the whole again: the farm did not hear its workers for a while.
    /// [`rules::MAX_GRACES`] times at most until the holder is heard again. Returns how many.
    async fn extend_leases(&self) -> Result<u64>;

    /// Workers that failed at tasks of a bake.
    async fn blocklist(&self, bake: &str) -> Result<Blocklist>;

    /// Forgets that a worker, or any, failed at tasks of a bake.
    async fn clear_blocklist(&self, bake: &str, worker: Option<&str>) -> Result<Blocklist>;

    /// Ends leases that have run out. Each counts as a worker lost with its task ([`rules::FarmRules`]), unless the worker was
    /// never heard about it: then the answer to its claim was lost, or the worker had gone, and nothing was attempted. A worker that is
    /// heard later, by a heartbeat, commit or release of that lease, was silent and is alive: the loss is given back, up to
    /// [`MAX_PARDONS`] times for a task. An attempt that took too long counts as failed, for good.
    ///
    /// Leases and waits that end later than they could if they began now were made by a clock that was set back since: they begin now.
    async fn reap(&self) -> Result<Reaped>;

    /// Holds a bake's tasks back; leases go on.
    async fn pause(&self, bake: &str) -> Result<Bake>;

    /// Ends a pause.
    async fn resume(&self, bake: &str) -> Result<Bake>;

    /// Ends a bake; tasks that no other live bake wants are dropped.
    async fn cancel(&self, bake: &str) -> Result<Bake>;

    /// Changes a live bake's priority.
    async fn reprioritise(&self, bake: &str, priority: i32) -> Result<Bake>;

    /// One bake.
    async fn show(&self, bake: &str) -> Result<Bake>;

    /// Bakes that the filter takes, newest first; those submitted before place `after`, which `next` of the page before
    /// gave. The bake there may be gone.
    async fn list(&self, filter: &BakeFilter, after: Option<u64>, limit: u32) -> Result<BakePage>;

    /// Bakes whose ids begin so, in lower-case hex, by id.
    async fn begin_with(&self, id: &str, limit: u32) -> Result<Vec<Named>>;

    /// Events with a `seq` above `after`, and the bake as it stands.
    async fn events_after(&self, bake: &str, after: u64, limit: u32) -> Result<EventPage>;

    /// Results of a bake behind place `after` in the order in which they landed, of tasks of one kind if it is named, and
    /// the bake as it stands; at most `limit`, and no more than [`rules::results_on_page`] says. A result that lands, for
    /// the first time or again, comes behind all that landed before, and behind the `next_after` of each page before.
    async fn results_after(
        &self,
        bake: &str,
        kind: Option<&str>,
        after: u64,
        limit: u32,
    ) -> Result<ResultPage>;

    /// Workers heard of lately, by name.
    async fn workers(&self) -> Result<Vec<Worker>>;

    /// Makes a bearer. A name is given once; the same call again gives the same bearer.
    async fn add_bearer(&self, name: &str, hash: Digest, scopes: &BTreeSet<Scope>) -> Result<Bearer>;

    /// Makes a bearer's token useless, for ever.
    async fn revoke_bearer(&self, name: &str) -> Result<Bearer>;

    /// All bearers ever made, by name.
    async fn bearers(&self) -> Result<Vec<Bearer>>;

    /// Those of `digests` whose bytes are kept.
    async fn find_chunks(&self, digests: &[Digest]) -> Result<Vec<KeptChunk>>;

    /// The same for one, which from now on stays for the grace.
    async fn touch_chunk(&self, digest: Digest) -> Result<Option<KeptChunk>>;

    /// Takes stored bytes in, in place of the generation `replaces` if that is what the chunk has. Refused if the farm
    /// would then store more than `quota` bytes.
    async fn keep_chunk(&self, chunk: KeptChunk, replaces: Option<u64>, quota: Option<u64>) -> Result<Kept>;

    /// Attaches an evaluation to a bake that is done, in place of the one that it has: its index and its files, which must be kept,
    /// stay as long as it is attached. The same call again changes nothing.
    async fn set_evaluation(&self, bake: &str, index: Digest, files: &BTreeSet<Digest>) -> Result<()>;

    /// Deletes a bake that has ended, and the results that no other bake holds.
    async fn delete_bake(&self, bake: &str) -> Result<()>;

    /// Deletes old bakes, condemns chunks that nobody needs, and says whose bytes are to be removed.
    async fn collect(&self, rules: &CollectRules) -> Result<Collected>;

    /// Forgets condemned chunks whose bytes have been removed.
    async fn purge(&self, names: &[ChunkName]) -> Result<()>;

    /// Gives up a chunk whose bytes are lost or damaged: results with it among their outputs are forgotten, as by
    /// [`FarmStore::forget`]. Returns how many. Nothing happens if the chunk has another generation by now.
    async fn lose_chunk(&self, name: ChunkName) -> Result<u64>;

    /// Chunks after `after`, by digest.
    async fn chunk_rows(&self, after: Option<Digest>, limit: u32) -> Result<Vec<ChunkRow>>;

    /// Those of `names` that are neither kept nor condemned.
    async fn orphans(&self, names: &[ChunkName]) -> Result<Vec<ChunkName>>;

    /// Condemns those of `chunks` that are neither kept nor condemned; returns their names.
    async fn condemn_orphans(&self, chunks: &[KeptChunk]) -> Result<Vec<ChunkName>>;

    /// Fill of the storage.
    async fn usage(&self) -> Result<Usage>;

    /// Figures about the whole farm.
    async fn stats(&self) -> Result<Stats>;

    /// Writes something, to show that writing works.
    async fn probe(&self) -> Result<()>;

    /// Errs if what is stored is damaged, as far as a look through it shows; it may take as long as reading all of it. A
    /// store that looks after that itself says nothing.
    async fn examine(&self) -> Result<()> {
        Ok(())
    }
}

/// Refuses calls that only a live bake allows.
pub fn require_live(bake: &str, state: BakeState, action: &'static str) -> Result<()> {
    if state.is_final() {
        return Err(StoreError::StateConflict { bake: bake.to_owned(), state, action });
    }
    Ok(())
}

/// Refuses calls that only an ended bake allows.
pub fn require_ended(bake: &str, state: BakeState, action: &'static str) -> Result<()> {
    if !state.is_final() {
        return Err(StoreError::StateConflict { bake: bake.to_owned(), state, action });
    }
    Ok(())
}

/// Refuses calls that only a bake with all its results allows.
pub fn require_done(bake: &str, state: BakeState, action: &'static str) -> Result<()> {
    if state != BakeState::Done {
        return Err(StoreError::StateConflict { bake: bake.to_owned(), state, action });
    }
    Ok(())
}

/// The bearer that has the name already, if it is the one to make.
pub fn same_bearer(found: Bearer, hash: Digest) -> Result<Bearer> {
    if found.hash == hash { Ok(found) } else { Err(StoreError::BearerExists { name: found.name }) }
}
