//! Leases of the model: claim, heartbeat, commit, fail, release, expiry.

use std::cmp::Reverse;

use lightkiln_proto::api::{
    BakeState, Blame, ClaimRequest, CommitVerdict, EventKind, HeartbeatAnswer, Lease, Verdict,
};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use super::farm::{Farm, LeaseEntry, Task, WorkerEntry};
use crate::store::rules::{self, WORKER_PRESENT_MS, WORKER_SEEN_GRAIN_MS, add_counters};
use crate::store::{FailVerdict, Reaped, StoreError, TaskState, token};

impl Farm {
    pub(super) fn claim(&mut self, request: &ClaimRequest, now_ms: i64) -> Result<Vec<Lease>, StoreError> {
        self.see_worker(request, now_ms);
        let mut leases = Vec::new();
        while leases.len() < request.max as usize {
            let Some((bake, key)) = self.best_ready(request, now_ms) else { break };
            leases.push(self.lease(bake, key, request, now_ms)?);
        }
        Ok(leases)
    }

    fn see_worker(&mut self, request: &ClaimRequest, now_ms: i64) {
        let (kinds, threads) = (request.kinds.clone(), request.threads);
        let fresh = WorkerEntry { kinds, threads, seen_ms: now_ms };
        let worker = self.workers.entry(request.worker.clone()).or_insert_with(|| fresh.clone());
        let same = worker.kinds == fresh.kinds && worker.threads == fresh.threads;
        if !same || now_ms - worker.seen_ms >= WORKER_SEEN_GRAIN_MS {
            *worker = fresh;
        }
    }

    pub(super) fn state_of(&self, task: &Task) -> TaskState {
        let is_done = |key: &TaskKey| self.tasks.get(key).is_some_and(|task| task.done.is_some());
        if task.done.is_some() {
            TaskState::Done
        } else if task.lease.is_some() {
            TaskState::Leased
        } else if rules::dependencies(&task.spec).iter().all(is_done) {
            TaskState::Ready
        } else {
            TaskState::Waiting
        }
    }

    /// The first task in claim order and the bake that it is claimed for.
    fn best_ready(&self, request: &ClaimRequest, now_ms: i64) -> Option<(usize, TaskKey)> {
        let mut running: Vec<usize> = (0..self.bakes.len()).collect();
        running.retain(|index| self.bakes[*index].state == BakeState::Running);
        running.sort_by_key(|index| (Reverse(self.bakes[*index].new.priority), *index));
        running.into_iter().find_map(|bake| {
            let open = self.bakes[bake].members.iter().filter(|(_, member)| !member.done);
            let tasks = open.filter_map(|(key, _)| self.tasks.get(key));
            let claimable = tasks.filter(|task| self.is_claimable(task, request, now_ms));
            let best = claimable.min_by_key(|task| (Reverse(task.spec.cost), task.spec.key))?;
            Some((bake, best.spec.key))
        })
    }

    fn is_claimable(&self, task: &Task, request: &ClaimRequest, now_ms: i64) -> bool {
        request.kinds.contains(&task.spec.kind)
            && task.not_before_ms <= now_ms
            && !self.is_left_to_others(task, &request.worker, now_ms)
            && self.state_of(task) == TaskState::Ready
    }

    /// A worker that failed at a task leaves it to others, if one that has not failed at it is present.
    fn is_left_to_others(&self, task: &Task, worker: &str, now_ms: i64) -> bool {
        task.blamed.contains(worker)
            && self.workers.iter().any(|(name, other)| {
                !task.blamed.contains(name)
                    && other.seen_ms > now_ms - WORKER_PRESENT_MS
                    && other.kinds.contains(&task.spec.kind)
            })
    }

    fn lease(
        &mut self,
        bake: usize,
        key: TaskKey,
        request: &ClaimRequest,
        now_ms: i64,
    ) -> Result<Lease, StoreError> {
        let token = token::new_token()?;
        let ttl_ms = i64::from(request.ttl_secs) * 1000;
        let expires_ms = now_ms + ttl_ms;
        for bake in self.live_bakes_of(key) {
            let kind = self.tasks[&key].spec.kind.clone();
            self.bakes[bake].stage(&kind).first_claim_ms.get_or_insert(now_ms);
        }
        let worker = request.worker.clone();
        self.leases.insert(token.clone(), LeaseEntry { key, worker, ttl_ms, expires_ms, cancelled: false });
        if let Some(task) = self.tasks.get_mut(&key) {
            task.lease = Some(token.clone());
        }
        let task = self.tasks[&key].spec.clone();
        let inputs = rules::resolve_inputs(&task, |key| {
            let done = self.tasks.get(key).and_then(|task| task.done.as_ref());
            done.map(|(result, _)| result.outputs.clone()).unwrap_or_default()
        });
        Ok(Lease { token, bake: self.bakes[bake].id.clone(), task, inputs, expires_ms })
    }

    pub(super) fn heartbeat(&mut self, token: &str, _progress: f32, now_ms: i64) -> HeartbeatAnswer {
        let Some(lease) = self.leases.get_mut(token) else {
            return HeartbeatAnswer { verdict: Verdict::Lost, expires_ms: now_ms };
        };
        let mut verdict = Verdict::Keep;
        if lease.cancelled {
            verdict = Verdict::Cancel;
        } else if lease.expires_ms <= now_ms {
            verdict = Verdict::Lost;
        } else {
            lease.expires_ms = now_ms + lease.ttl_ms;
        }
        if let Some(worker) = self.workers.get_mut(&lease.worker)
            && now_ms - worker.seen_ms >= WORKER_SEEN_GRAIN_MS
        {
            worker.seen_ms = now_ms;
        }
        HeartbeatAnswer { verdict, expires_ms: lease.expires_ms }
    }

    /// Takes the lease away if it is still good. A cancelled one goes too, but gives nothing.
    fn end_lease(&mut self, token: &str, now_ms: i64) -> Option<LeaseEntry> {
        let lease = self.leases.get(token)?;
        if lease.cancelled {
            self.leases.remove(token);
            return None;
        }
        if lease.expires_ms <= now_ms {
            return None;
        }
        self.take_lease(token)
    }

    fn take_lease(&mut self, token: &str) -> Option<LeaseEntry> {
        let lease = self.leases.remove(token)?;
        if let Some(task) = self.tasks.get_mut(&lease.key)
            && !lease.cancelled
        {
            task.lease = None;
        }
        Some(lease)
    }

    pub(super) fn commit(
        &mut self,
        token: &str,
        result: &TaskResult,
        now_ms: i64,
    ) -> Result<CommitVerdict, StoreError> {
        let by_token = |task: &Task| task.done.as_ref().is_some_and(|(_, by)| by == token);
        if self.tasks.values().any(by_token) {
            return Ok(CommitVerdict::AlreadyCommitted);
        }
        rules::check_plan(&result.plan)?;
        let Some(lease) = self.end_lease(token, now_ms) else { return Ok(CommitVerdict::Stale) };
        let key = lease.key;
        let Some(task) = self.tasks.get_mut(&key) else { return Ok(CommitVerdict::Stale) };
        for output in &result.outputs {
            self.chunks.require(output.digest)?;
        }
        task.done = Some((result.clone(), token.to_owned()));
        let spec = task.spec.clone();
        for bake in self.live_bakes_of(key) {
            let entry = &mut self.bakes[bake];
            entry.tasks_run += 1;
            add_counters(&mut entry.counters, &result.counters);
            entry.note_outputs(&result.outputs);
            entry.stage(&spec.kind).last_commit_ms = Some(now_ms);
            if let Some(member) = entry.members.get_mut(&key) {
                member.done = true;
            }
            let (kind, label) = (spec.kind.clone(), spec.label.clone());
            let done = EventKind::TaskDone { key, kind, label, worker: lease.worker.clone() };
            self.event(bake, now_ms, done);
            self.apply_plan(bake, &result.plan, now_ms)?;
            self.finish_if_done(bake, now_ms);
        }
        Ok(CommitVerdict::Committed)
    }

    pub(super) fn release(&mut self, token: &str, now_ms: i64) -> bool {
        self.end_lease(token, now_ms).is_some()
    }

    pub(super) fn fail(&mut self, token: &str, blame: Blame, message: &str, now_ms: i64) -> FailVerdict {
        let Some(lease) = self.end_lease(token, now_ms) else { return FailVerdict::Stale };
        let message = rules::cut_message(message);
        match blame {
            Blame::Task => {
                let TaskSpec { label, kind, .. } = &self.tasks[&lease.key].spec;
                let failure = rules::task_fault_message(label, kind, &lease.worker, &message);
                self.give_up(&lease, &message, &failure, now_ms);
                FailVerdict::GivenUp
            }
            Blame::Worker => {
                let Some(attempts) = self.blame_worker(&lease, &message, now_ms) else {
                    return FailVerdict::GivenUp;
                };
                if let Some(task) = self.tasks.get_mut(&lease.key) {
                    task.not_before_ms = now_ms + rules::backoff_ms(attempts);
                }
                self.task_failed(&lease, &message, true, now_ms);
                FailVerdict::Retry
            }
        }
    }

    /// Counts an attempt against a worker: attempts so far, or none when the task was given up.
    fn blame_worker(&mut self, lease: &LeaseEntry, message: &str, now_ms: i64) -> Option<u32> {
        let task = self.tasks.get_mut(&lease.key)?;
        task.attempts += 1;
        task.blamed.insert(lease.worker.clone());
        let (attempts, workers) = (task.attempts, task.blamed.len() as u32);
        if !rules::is_given_up(attempts, workers) {
            return Some(attempts);
        }
        let TaskSpec { label, kind, .. } = &task.spec;
        let failure = rules::given_up_message(label, kind, attempts, workers, message);
        self.give_up(lease, message, &failure, now_ms);
        None
    }

    fn give_up(&mut self, lease: &LeaseEntry, message: &str, failure: &str, now_ms: i64) {
        self.task_failed(lease, message, false, now_ms);
        for bake in self.live_bakes_of(lease.key) {
            self.close(bake, BakeState::Failed, Some(failure.to_owned()), now_ms);
        }
    }

    fn task_failed(&mut self, lease: &LeaseEntry, message: &str, retry: bool, now_ms: i64) {
        let spec = self.tasks[&lease.key].spec.clone();
        for bake in self.live_bakes_of(lease.key) {
            let (kind, label) = (spec.kind.clone(), spec.label.clone());
            let (worker, message) = (lease.worker.clone(), message.to_owned());
            self.event(
                bake,
                now_ms,
                EventKind::TaskFailed { key: lease.key, kind, label, worker, message, retry },
            );
        }
    }

    pub(super) fn reap(&mut self, now_ms: i64) -> Reaped {
        let mut out: Vec<(i64, TaskKey, String)> = Vec::new();
        for (token, lease) in &self.leases {
            if lease.expires_ms <= now_ms {
                out.push((lease.expires_ms, lease.key, token.clone()));
            }
        }
        out.sort();
        let mut reaped = Reaped::default();
        for (_, key, token) in out {
            // Dropped with its bake meanwhile, or cancelled before: nobody is to blame.
            let Some(lease) = self.take_lease(&token).filter(|lease| !lease.cancelled) else { continue };
            reaped.expired += 1;
            for bake in self.live_bakes_of(key) {
                let worker = lease.worker.clone();
                self.event(bake, now_ms, EventKind::LeaseExpired { key, worker });
            }
            let message = rules::expiry_message(&lease.worker);
            if self.blame_worker(&lease, &message, now_ms).is_none() {
                reaped.given_up += 1;
            }
        }
        reaped
    }
}
