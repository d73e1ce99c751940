//! Bakes and tasks of the model: taking in, results, ends.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use lightkiln_proto::api::{Bake, BakeEvent, BakeState, EventKind};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, MAX_ALIKE, TaskSpec};

use super::chunks::Chunks;
use super::entries::{BakeEntry, ExpiredEntry, LeaseEntry, Task, WorkerEntry};
use super::reruns::Rerun;
use lightkiln_server::access::Bearer;
use lightkiln_server::random;
use lightkiln_server::store::rules::{self, add_counters, check_plan, is_same_task, named_artefacts};
use lightkiln_server::store::{KnownResult, PlanError, StoreError, Submission, Submitted, require_live};

/// Everything a farm knows.
#[derive(Clone, Default)]
pub(super) struct Farm {
    /// In order of submission.
    pub(super) bakes: Vec<BakeEntry>,
    pub(super) tasks: BTreeMap<TaskKey, Task>,
    /// By token. A lease whose task was dropped stays until it runs out, so that its holder can be told.
    pub(super) leases: BTreeMap<String, LeaseEntry>,
    /// By token.
    pub(super) expired: BTreeMap<String, ExpiredEntry>,
    /// Tokens of results that differed from another one of their task.
    pub(super) alarms: BTreeSet<String>,
    /// By name.
    pub(super) workers: BTreeMap<String, WorkerEntry>,
    /// By name.
    pub(super) bearers: BTreeMap<String, Bearer>,
    pub(super) chunks: Chunks,
    /// Since when tasks of live bakes, by the bake's id, could have been claimed.
    pub(super) ready_since_ms: BTreeMap<(String, TaskKey), i64>,
    /// Bakes that there ever were; numbers are not given out again.
    pub(super) submitted: u64,
    /// Tasks that there ever were.
    pub(super) numbered: u64,
    /// Results that are to be made once more, by their tasks.
    pub(super) reruns: BTreeMap<TaskKey, Rerun>,
    /// Those that are no more, however they ended, and results that were compared.
    pub(super) reruns_over: u64,
    pub(super) verified: u64,
    /// Tasks run and reused that the bakes' own counts no longer have.
    pub(super) gone_run: u64,
    pub(super) gone_reused: u64,
}

impl Farm {
    /// Runs `change`; when it fails, nothing has happened.
    pub(super) fn all_or_nothing<T>(
        &mut self,
        change: impl FnOnce(&mut Self) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let before = self.clone();
        let outcome = change(self);
        if outcome.is_err() {
            *self = before;
        }
        outcome
    }

    pub(super) fn index_of(&self, bake: &str) -> Result<usize, StoreError> {
        let found = self.bakes.iter().position(|entry| entry.id == bake);
        found.ok_or_else(|| StoreError::NoSuchBake { bake: bake.to_owned() })
    }

    /// Live bakes that hold `key`, oldest first.
    pub(super) fn live_bakes_of(&self, key: TaskKey) -> Vec<usize> {
        let wants = |bake: &BakeEntry| !bake.state.is_final() && bake.members.contains_key(&key);
        (0..self.bakes.len()).filter(|index| wants(&self.bakes[*index])).collect()
    }

    pub(super) fn event(&mut self, bake: usize, at_ms: i64, event: EventKind) {
        let events = &mut self.bakes[bake].events;
        events.push(BakeEvent { seq: events.len() as u64 + 1, at_ms, event });
    }

    pub(super) fn submit(&mut self, submission: &Submission, now_ms: i64) -> Result<Submitted, StoreError> {
        if let Some(key) = &submission.idempotency_key {
            let known = |entry: &BakeEntry| entry.idempotency_key.as_ref() == Some(key);
            if let Some(index) = self.bakes.iter().position(known) {
                if self.bakes[index].body_hash != submission.body_hash {
                    return Err(StoreError::IdempotencyConflict { key: key.clone() });
                }
                return Ok(Submitted { bake: self.view(index), is_new: false });
            }
        }
        check_plan(&submission.plan)?;
        self.chunks.require(submission.bake.scene)?;
        let index = self.bakes.len();
        self.submitted += 1;
        self.bakes.push(BakeEntry::new(submission, self.submitted, random::id(), now_ms));
        self.event(index, now_ms, EventKind::Submitted);
        self.apply_plan(index, &submission.plan, now_ms)?;
        self.finish_if_done(index, now_ms);
        Ok(Submitted { bake: self.view(index), is_new: true })
    }

    /// Adds tasks to a bake, the plans of those done already included, first in first out.
    pub(super) fn apply_plan(
        &mut self,
        bake: usize,
        plan: &[TaskSpec],
        now_ms: i64,
    ) -> Result<(), StoreError> {
        let mut queue: VecDeque<TaskSpec> = plan.iter().cloned().collect();
        let mut added = Vec::new();
        let mut missing = BTreeSet::new();
        let mut reused = 0;
        while let Some(spec) = queue.pop_front() {
            let key = spec.key;
            self.numbered += 1;
            let task = self.tasks.entry(key).or_insert_with(|| Task::new(spec.clone(), self.numbered));
            if !is_same_task(&task.spec, &spec) {
                return Err(PlanError::KeyClash { key }.into());
            }
            let entry = &mut self.bakes[bake];
            if entry.members.contains_key(&key) {
                continue;
            }
            entry.add_member(task, now_ms);
            for digest in named_artefacts(&task.spec) {
                if self.chunks.is_known(digest) {
                    entry.artefacts.insert(digest);
                }
                if task.done.is_none() && self.chunks.kept(digest).is_none() {
                    missing.insert(digest);
                }
            }
            if let Some((result, _)) = &task.done {
                entry.note_outputs(&result.outputs);
                add_counters(&mut entry.counters_reused, &result.counters);
                queue.extend(result.plan.iter().cloned());
                reused += 1;
            }
            added.push(key);
        }
        for key in &added {
            self.require_dependencies(bake, *key)?;
        }
        missing.first().map_or(Ok(()), |digest| self.chunks.require(*digest))?;
        if !added.is_empty() {
            self.event(bake, now_ms, EventKind::Planned { tasks: added.len() as u64, reused });
        }
        Ok(())
    }

    fn require_dependencies(&self, bake: usize, key: TaskKey) -> Result<(), PlanError> {
        let members = &self.bakes[bake].members;
        let needs = rules::dependencies(&self.tasks[&key].spec);
        match needs.into_iter().find(|needs| !members.contains_key(needs)) {
            Some(needs) => Err(PlanError::UnknownDependency { needs }),
            None => Ok(()),
        }
    }

    pub(super) fn finish_if_done(&mut self, bake: usize, now_ms: i64) {
        if self.bakes[bake].members.values().all(|member| member.done) {
            self.close(bake, BakeState::Done, None, now_ms);
        }
    }

    /// Ends a bake and drops tasks that nobody else wants.
    pub(super) fn close(&mut self, bake: usize, state: BakeState, failure: Option<String>, now_ms: i64) {
        let entry = &mut self.bakes[bake];
        entry.state = state;
        entry.failure = failure;
        entry.finished_ms = Some(now_ms);
        let open: Vec<TaskKey> =
            entry.members.iter().filter(|(_, member)| !member.done).map(|(key, _)| *key).collect();
        self.event(bake, now_ms, EventKind::State { state });
        if state != BakeState::Done {
            let id = self.bakes[bake].id.clone();
            self.end_reruns_of(&id);
        }
        for key in open {
            if let Some(member) = self.bakes[bake].members.get_mut(&key) {
                member.held = false;
            }
            if self.live_bakes_of(key).is_empty()
                && let Some(lease) = self.drop_task(key).and_then(|task| task.lease)
                && let Some(lease) = self.leases.get_mut(&lease)
            {
                lease.cancelled = true;
            }
        }
    }

    /// Removes a task, with its result if it has one; nobody holds it any more.
    pub(super) fn drop_task(&mut self, key: TaskKey) -> Option<Task> {
        for bake in &mut self.bakes {
            if let Some(member) = bake.members.get_mut(&key) {
                member.held = false;
            }
        }
        self.release_readers(key);
        self.end_rerun(key);
        self.expired.retain(|_, expired| expired.key != key);
        self.tasks.remove(&key)
    }

    pub(super) fn cancel(&mut self, bake: &str, now_ms: i64) -> Result<Bake, StoreError> {
        let index = self.index_of(bake)?;
        if self.bakes[index].state != BakeState::Cancelled {
            require_live(bake, self.bakes[index].state, "cancelled")?;
            self.close(index, BakeState::Cancelled, None, now_ms);
        }
        Ok(self.view(index))
    }

    /// Pauses or resumes.
    pub(super) fn set_state(
        &mut self,
        bake: &str,
        state: BakeState,
        action: &'static str,
        now_ms: i64,
    ) -> Result<Bake, StoreError> {
        let index = self.index_of(bake)?;
        require_live(bake, self.bakes[index].state, action)?;
        if self.bakes[index].state != state {
            self.bakes[index].state = state;
            if state == BakeState::Running {
                let resumed = self.ready_since_ms.iter_mut().filter(|((id, _), _)| id == bake);
                resumed.for_each(|(_, since_ms)| *since_ms = now_ms);
            }
            self.event(index, now_ms, EventKind::State { state });
        }
        Ok(self.view(index))
    }

    pub(super) fn reusable(&self, plan: &[TaskSpec]) -> Vec<KnownResult> {
        let mut seen = BTreeSet::new();
        let mut known = Vec::new();
        let mut queue: VecDeque<&TaskSpec> = plan.iter().collect();
        while let Some(spec) = queue.pop_front() {
            let result = self.tasks.get(&spec.key).and_then(|task| task.done.as_ref());
            if let Some((result, _)) = result
                && seen.insert(spec.key)
            {
                known.push((spec.key, result.clone()));
                queue.extend(&result.plan);
            }
        }
        KnownResult::all(known)
    }

    pub(super) fn forget(&mut self, key: TaskKey, now_ms: i64) {
        let wanted_by = self.live_bakes_of(key);
        if self.tasks.get(&key).is_none_or(|task| task.done.is_none()) {
            return;
        }
        for bake in self.bakes.iter_mut().filter(|bake| bake.state.is_final()) {
            if let Some(member) = bake.members.get_mut(&key).filter(|member| member.held) {
                (member.held, member.lost) = (false, true);
            }
        }
        if wanted_by.is_empty() {
            self.drop_task(key);
            return;
        }
        self.hold_readers(key);
        self.end_rerun(key);
        self.expired.retain(|_, expired| expired.key != key);
        let Some(task) = self.tasks.get_mut(&key) else { return };
        let outputs_before = task.done.take().map(|(result, _)| result.outputs).unwrap_or_default();
        *task =
            Task { makers: task.makers.clone(), outputs_before, ..Task::new(task.spec.clone(), task.number) };
        let (kind, label) = (task.spec.kind.clone(), task.spec.label.clone());
        for bake in wanted_by {
            let lost = EventKind::ResultLost { key, kind: kind.clone(), label: label.clone() };
            self.event(bake, now_ms, lost);
            if let Some(member) = self.bakes[bake].members.get_mut(&key) {
                self.gone_reused += u64::from(member.reused);
                (member.done, member.reused, member.place) = (false, false, None);
            }
        }
    }

    /// Lets tasks that name an output of `maker`, whose result is about to be forgotten, wait for it, unless it waits for
    /// them or one of their live bakes does not hold it. Attempts under way at them have lost an input.
    fn hold_readers(&mut self, maker: TaskKey) {
        let outputs = self.outputs_of(&maker);
        let digests: BTreeSet<Digest> = outputs.iter().map(|output| output.digest).collect();
        let holders: Vec<usize> = self.live_bakes_of(maker);
        let needed = self.all_needed_by(maker);
        for bake in holders.iter().filter(|bake| !self.bakes[**bake].artefacts.is_disjoint(&digests)) {
            for key in self.bakes[*bake].members.keys().filter(|key| !needed.contains(*key)) {
                if self.live_bakes_of(*key).iter().all(|bake| holders.contains(bake))
                    && let Some(task) = self.tasks.get_mut(key)
                    && named_artefacts(&task.spec).any(|digest| digests.contains(&digest))
                {
                    task.makers.insert(maker);
                }
            }
        }
        for lease in self.leases.values_mut() {
            let task = self.tasks.get(&lease.key);
            lease.input_lost |= task.is_some_and(|task| task.needs().contains(&maker));
        }
    }

    /// Lets nobody wait for `maker` but its dependants.
    pub(super) fn release_readers(&mut self, maker: TaskKey) {
        for task in self.tasks.values_mut() {
            task.makers.remove(&maker);
        }
    }

    pub(super) fn outputs_of(&self, key: &TaskKey) -> Vec<Artefact> {
        let done = self.tasks.get(key).and_then(|task| task.done.as_ref());
        done.map(|(result, _)| result.outputs.clone()).unwrap_or_default()
    }

    /// Outputs of the newest done tasks that have a name in common with a task.
    pub(super) fn outputs_of_alike(&self, spec: &TaskSpec) -> Vec<Vec<Artefact>> {
        let is_alike = |task: &&Task| spec.alike.is_some() && task.spec.alike == spec.alike;
        let mut done: Vec<_> =
            self.tasks.values().filter(is_alike).filter(|task| task.done.is_some()).collect();
        done.sort_by_key(|task| std::cmp::Reverse(task.number));
        done.iter().take(MAX_ALIKE).map(|task| self.outputs_of(&task.spec.key)).collect()
    }

    /// A task, and all that it waits for if nothing is done.
    fn all_needed_by(&self, key: TaskKey) -> BTreeSet<TaskKey> {
        let (mut needed, mut open) = (BTreeSet::new(), vec![key]);
        while let Some(key) = open.pop() {
            if let Some(task) = self.tasks.get(&key)
                && needed.insert(key)
            {
                open.extend(task.needs());
            }
        }
        needed
    }

    /// Why a bake cannot go on: one of its open tasks names an output that `key`, run again, has not given again.
    pub(super) fn failure_by_making(&self, bake: usize, key: TaskKey, before: &[Artefact]) -> Option<String> {
        let now = self.outputs_of(&key);
        let open = self.bakes[bake].members.iter().filter(|(_, member)| !member.done);
        let named: BTreeSet<Digest> = open
            .filter_map(|(key, _)| self.tasks.get(key))
            .flat_map(|task| named_artefacts(&task.spec))
            .collect();
        let is_lost = |output: &&Artefact| self.chunks.kept(output.digest).is_none();
        let gone = rules::outputs_gone(before, &now)
            .filter(is_lost)
            .find(|output| named.contains(&output.digest))?;
        let TaskSpec { label, kind, .. } = &self.tasks[&key].spec;
        Some(rules::made_otherwise_message(label, kind, gone))
    }
}
