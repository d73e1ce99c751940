//! Bakes, tasks, leases and workers of the model.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{BakeEvent, BakeState, NewBake};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, MANIFEST_OUTPUT, REPORT_OUTPUT, TaskResult, TaskSpec};

use super::alarms::Given;
use lightkiln_server::store::rules::Abilities;
use lightkiln_server::store::{LeaseState, Submission};

#[derive(Clone)]
pub(super) struct BakeEntry {
    /// Its place among all bakes, in order of submission.
    pub(super) seq: u64,
    pub(super) id: String,
    pub(super) idempotency_key: Option<String>,
    pub(super) body_hash: Digest,
    pub(super) traceparent: Option<String>,
    pub(super) new: NewBake,
    pub(super) state: BakeState,
    pub(super) members: BTreeMap<TaskKey, Member>,
    /// Its scene, and stored artefacts that its tasks name.
    pub(super) artefacts: BTreeSet<Digest>,
    /// Kinds in the order of their first appearance.
    pub(super) stages: Vec<Stage>,
    pub(super) events: Vec<BakeEvent>,
    /// Places that were given to results.
    pub(super) places: u64,
    pub(super) tasks_run: u64,
    pub(super) counters: BTreeMap<String, f64>,
    pub(super) counters_reused: BTreeMap<String, f64>,
    pub(super) manifest: Option<Digest>,
    pub(super) report: Option<Digest>,
    /// Index of the attached evaluation, and all chunks that it takes.
    pub(super) evaluation: Option<(Digest, BTreeSet<Digest>)>,
    pub(super) owner: Option<String>,
    pub(super) attempts_failed: u64,
    pub(super) attempts_lost: u64,
    pub(super) alarms: u64,
    pub(super) failure: Option<String>,
    pub(super) created_ms: i64,
    pub(super) finished_ms: Option<i64>,
}

/// A task as one bake counts it; stays when the task itself is dropped.
#[derive(Clone)]
pub(super) struct Member {
    pub(super) kind: String,
    pub(super) cost: u64,
    pub(super) done: bool,
    pub(super) reused: bool,
    /// The bake holds the task, and its result: false once the task was dropped.
    pub(super) held: bool,
    /// The bake had ended when the result was forgotten; it holds it again when the task has run again.
    pub(super) lost: bool,
    /// Place of its result among those of the bake, in the order in which they landed.
    pub(super) place: Option<u64>,
}

#[derive(Clone)]
pub(super) struct Stage {
    pub(super) kind: String,
    pub(super) first_claim_ms: Option<i64>,
    pub(super) last_commit_ms: Option<i64>,
}

#[derive(Clone)]
pub(super) struct Task {
    pub(super) spec: TaskSpec,
    /// Tasks that there were before it.
    pub(super) number: u64,
    /// Result, and the token that committed it.
    pub(super) done: Option<(TaskResult, String)>,
    /// Token of the attempt under way.
    pub(super) lease: Option<String>,
    /// Attempts that failed.
    pub(super) attempts: u32,
    /// Times that a worker was lost with it.
    pub(super) losses: u32,
    /// Attempts that were given back, or not counted, as their workers were silent for a while, and alive.
    pub(super) pardons: u32,
    pub(super) not_before_ms: i64,
    /// Workers that failed at it.
    pub(super) blamed: BTreeSet<String>,
    /// Workers that were lost with it.
    pub(super) lost_with: BTreeSet<String>,
    /// Worker that gave its result.
    pub(super) done_by: String,
    /// Results that came too late, until it has one.
    pub(super) witnesses: Vec<Given>,
    /// Tasks that are to make again the artefacts that it names.
    pub(super) makers: BTreeSet<TaskKey>,
    /// Its outputs before its result was forgotten.
    pub(super) outputs_before: Vec<Artefact>,
}

#[derive(Clone)]
pub(super) struct LeaseEntry {
    pub(super) key: TaskKey,
    /// Id of the bake that the task was handed out for.
    pub(super) bake: String,
    pub(super) worker: String,
    pub(super) ttl_ms: i64,
    pub(super) started_ms: i64,
    pub(super) expires_ms: i64,
    /// When the attempt has taken too long.
    pub(super) deadline_ms: i64,
    pub(super) cancelled: bool,
    pub(super) state: LeaseState,
    /// Something that the task reads was lost meanwhile.
    pub(super) input_lost: bool,
    /// Which attempt at the task it is.
    pub(super) attempt: u32,
    /// How often it was given its whole length again since the worker was heard.
    pub(super) graces: u32,
}

/// An attempt whose lease ran out.
#[derive(Clone)]
pub(super) struct ExpiredEntry {
    pub(super) key: TaskKey,
    pub(super) worker: String,
    /// It counts as a loss, as its worker was not heard since.
    pub(super) counted: bool,
    /// The worker had not been lost with the task before.
    pub(super) is_first: bool,
}

#[derive(Clone)]
pub(super) struct WorkerEntry {
    pub(super) abilities: Abilities,
    pub(super) machine: String,
    pub(super) seen_ms: i64,
    /// Scene of the bake that it last got a task of.
    pub(super) scene: Option<Digest>,
}

impl BakeEntry {
    pub(super) fn new(submission: &Submission, seq: u64, id: String, now_ms: i64) -> Self {
        Self {
            seq,
            id,
            idempotency_key: submission.idempotency_key.clone(),
            body_hash: submission.body_hash,
            traceparent: submission.traceparent.clone(),
            new: submission.bake.clone(),
            state: BakeState::Running,
            members: BTreeMap::new(),
            artefacts: BTreeSet::from([submission.bake.scene]),
            stages: Vec::new(),
            events: Vec::new(),
            places: 0,
            tasks_run: 0,
            counters: BTreeMap::new(),
            counters_reused: BTreeMap::new(),
            manifest: None,
            report: None,
            evaluation: None,
            owner: submission.owner.clone(),
            attempts_failed: 0,
            attempts_lost: 0,
            alarms: 0,
            failure: None,
            created_ms: now_ms,
            finished_ms: None,
        }
    }

    pub(super) fn add_member(&mut self, task: &Task, now_ms: i64) {
        let done = task.done.is_some();
        let (kind, cost) = (task.spec.kind.clone(), task.spec.cost);
        let stage = self.stage(&kind);
        if task.lease.is_some() {
            stage.first_claim_ms.get_or_insert(now_ms);
        }
        let place = done.then(|| self.next_place());
        let member = Member { kind, cost, done, reused: done, held: true, lost: false, place };
        self.members.insert(task.spec.key, member);
    }

    /// The place of a result that lands now.
    pub(super) fn next_place(&mut self) -> u64 {
        self.places += 1;
        self.places
    }

    /// The stage of a kind, made at its first appearance.
    pub(super) fn stage(&mut self, kind: &str) -> &mut Stage {
        let index = self.stages.iter().position(|stage| stage.kind == kind).unwrap_or_else(|| {
            self.stages.push(Stage { kind: kind.to_owned(), first_claim_ms: None, last_commit_ms: None });
            self.stages.len() - 1
        });
        &mut self.stages[index]
    }

    pub(super) fn note_outputs(&mut self, outputs: &[Artefact]) {
        for output in outputs {
            match output.name.as_str() {
                MANIFEST_OUTPUT => self.manifest = Some(output.digest),
                REPORT_OUTPUT => self.report = Some(output.digest),
                _ => (),
            }
        }
    }
}

impl Task {
    pub(super) fn new(spec: TaskSpec, number: u64) -> Self {
        let (blamed, makers, outputs_before) = (BTreeSet::new(), BTreeSet::new(), Vec::new());
        let (attempts, losses, pardons, not_before_ms) = (0, 0, 0, 0);
        Self {
            spec,
            number,
            done: None,
            lease: None,
            attempts,
            losses,
            pardons,
            not_before_ms,
            blamed,
            lost_with: BTreeSet::new(),
            done_by: String::new(),
            witnesses: Vec::new(),
            makers,
            outputs_before,
        }
    }

    /// All that it waits for until it is done.
    pub(super) fn needs(&self) -> BTreeSet<TaskKey> {
        self.spec.dependencies().chain(self.makers.iter().copied()).collect()
    }
}
