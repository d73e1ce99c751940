//! Leases of the model: claim, heartbeat, commit, fail, release, expiry.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use lightkiln_proto::api::{
    BakeState, BlockedWorker, Blocklist, ClaimRequest, CommitVerdict, EventKind, HeartbeatAnswer, Lease,
    Verdict,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use super::alarms::Given;
use super::entries::{BakeEntry, LeaseEntry, Member, Task, WorkerEntry};
use super::farm::Farm;
use lightkiln_server::random;
use lightkiln_server::store::limits;
use lightkiln_server::store::rules::{
    self, Abilities, BLOCK_TASKS, CLAIM_WINDOW, Contender, MAX_GRACES, MAX_PARDONS, WORKER_PRESENT_MS,
    WORKER_SEEN_GRAIN_MS, add_counters, next_contender,
};
use lightkiln_server::store::{LeaseState, Look, Opening, Room, Standing, StoreError, TaskState};

impl LeaseEntry {
    /// How long the attempt has taken.
    pub(super) fn elapsed_ms(&self, now_ms: i64) -> u64 {
        u64::try_from(now_ms - self.started_ms).unwrap_or(0)
    }
}

impl Farm {
    pub(super) fn claim(&mut self, request: &ClaimRequest, now_ms: i64) -> Result<Vec<Lease>, StoreError> {
        self.see_worker(request, now_ms);
        let mut leases = Vec::new();
        let abilities = Abilities::of(request);
        let (bakes, mut after) = (self.bakes_in_claim_order(&abilities, request, now_ms), 0);
        while leases.len() < request.max as usize && after < bakes.len() {
            let window = &bakes[after..bakes.len().min(after + CLAIM_WINDOW)];
            after += window.len();
            let scene = self.workers.get(&request.worker).and_then(|worker| worker.scene);
            let mut contenders: Vec<Contender<usize>> =
                window.iter().map(|bake| self.contender(*bake, scene)).collect();
            while leases.len() < request.max as usize
                && let Some(index) = next_contender(&contenders)
            {
                let bake = contenders[index].bake;
                match self.best_ready(bake, request, now_ms) {
                    Some(key) => {
                        leases.push(self.lease(bake, key, request, now_ms)?);
                        contenders[index].leased += 1;
                    }
                    None => drop(contenders.remove(index)),
                }
            }
        }
        if leases.is_empty() {
            leases.extend(self.claim_rerun(request, now_ms));
        }
        Ok(leases)
    }

    /// Running bakes with ready tasks that such a worker may take.
    fn bakes_in_claim_order(&self, abilities: &Abilities, request: &ClaimRequest, now_ms: i64) -> Vec<usize> {
        let is_open = |index: &usize| {
            let bake = &self.bakes[*index];
            let mut tasks = bake.members.keys().filter_map(|key| self.tasks.get(key));
            bake.state == BakeState::Running
                && abilities.suffice(&bake.new.needs)
                && self
                    .room_of(bake)
                    .is_none_or(|room| room.others > 0 || room.holders.contains(&request.worker))
                && tasks.any(|task| self.is_due(task, &request.kinds, now_ms))
                && !self.is_blocked(*index, request, now_ms)
        };
        let mut bakes: Vec<usize> = (0..self.bakes.len()).filter(is_open).collect();
        bakes.sort_by_key(|index| (Reverse(self.bakes[*index].new.priority), *index));
        bakes
    }

    /// Workers that a bake with a limit of them has room for.
    pub(super) fn room_of(&self, bake: &BakeEntry) -> Option<Room> {
        let held = self.leases.values().filter(|lease| lease.bake == bake.id);
        let holders: BTreeSet<String> = held.map(|lease| lease.worker.clone()).collect();
        let others = limits::room_for_workers(bake.new.limits.max_workers, holders.len() as u64)?;
        Some(Room { holders, others })
    }

    fn contender(&self, bake: usize, scene: Option<Digest>) -> Contender<usize> {
        let entry = &self.bakes[bake];
        let under_way = |(key, member): &(&TaskKey, &Member)| !member.done && self.is_leased(key);
        Contender {
            bake,
            priority: entry.new.priority.into(),
            leased: entry.members.iter().filter(under_way).count() as i64,
            is_local: scene == Some(entry.new.scene),
        }
    }

    /// A worker that failed at many tasks of a bake gets none of it, if one that did not is present.
    fn is_blocked(&self, bake: usize, request: &ClaimRequest, now_ms: i64) -> bool {
        let needs = &self.bakes[bake].new.needs;
        self.failures(bake, &request.worker) >= BLOCK_TASKS
            && self.workers.iter().any(|(name, other)| {
                *name != request.worker
                    && other.seen_ms > now_ms - WORKER_PRESENT_MS
                    && other.abilities.can_replace(request, needs)
                    && self.failures(bake, name) < BLOCK_TASKS
            })
    }

    /// Tasks of a bake at which a worker failed.
    fn failures(&self, bake: usize, worker: &str) -> u64 {
        let held = self.bakes[bake].members.iter().filter(|(_, member)| member.held);
        let tasks = held.filter_map(|(key, _)| self.tasks.get(key));
        tasks.filter(|task| task.blamed.contains(worker)).count() as u64
    }

    pub(super) fn blocklist(&self, bake: usize) -> Blocklist {
        let held = self.bakes[bake].members.iter().filter(|(_, member)| member.held);
        let names: BTreeSet<&String> =
            held.filter_map(|(key, _)| self.tasks.get(key)).flat_map(|task| &task.blamed).collect();
        let blocked = |worker: &String| {
            let tasks = self.failures(bake, worker);
            BlockedWorker { worker: worker.clone(), tasks, is_blocked: tasks >= BLOCK_TASKS }
        };
        Blocklist { workers: names.into_iter().map(blocked).collect() }
    }

    pub(super) fn clear_blocklist(&mut self, bake: usize, worker: Option<&str>) {
        for (key, member) in &self.bakes[bake].members {
            if let Some(task) = self.tasks.get_mut(key).filter(|_| member.held) {
                task.blamed.retain(|blamed| worker.is_some_and(|worker| worker != blamed));
            }
        }
    }

    pub(super) fn extend_leases(&mut self, now_ms: i64) -> u64 {
        let mut extended = 0;
        for lease in self.leases.values_mut().filter(|lease| !lease.cancelled) {
            let until = (now_ms + lease.ttl_ms).min(lease.deadline_ms);
            let runs_out_soon = lease.expires_ms <= now_ms + lease.ttl_ms / 2;
            if runs_out_soon && lease.expires_ms < until && lease.graces < MAX_GRACES {
                lease.expires_ms = until;
                lease.graces += 1;
                extended += 1;
            }
        }
        extended + self.extend_reruns(now_ms)
    }

    fn see_worker(&mut self, request: &ClaimRequest, now_ms: i64) {
        let machine = request.machine.clone();
        let fresh = WorkerEntry { abilities: Abilities::of(request), machine, seen_ms: now_ms, scene: None };
        let worker = self.workers.entry(request.worker.clone()).or_insert_with(|| fresh.clone());
        let is_noted = worker.abilities == fresh.abilities && worker.machine == fresh.machine;
        if !is_noted || now_ms - worker.seen_ms >= WORKER_SEEN_GRAIN_MS {
            (worker.abilities, worker.seen_ms) = (fresh.abilities, worker.seen_ms.max(now_ms));
            worker.machine = fresh.machine;
        }
    }

    pub(super) fn state_of(&self, task: &Task) -> TaskState {
        let is_done = |key: &TaskKey| self.tasks.get(key).is_some_and(|task| task.done.is_some());
        if task.done.is_some() {
            TaskState::Done
        } else if task.lease.is_some() {
            TaskState::Leased
        } else if rules::dependencies(&task.spec).iter().all(is_done) && task.makers.is_empty() {
            TaskState::Ready
        } else {
            TaskState::Waiting
        }
    }

    /// The first task of a bake in claim order.
    fn best_ready(&self, bake: usize, request: &ClaimRequest, now_ms: i64) -> Option<TaskKey> {
        let open = self.bakes[bake].members.iter().filter(|(_, member)| !member.done);
        let tasks = open.filter_map(|(key, _)| self.tasks.get(key));
        let claimable = tasks.filter(|task| {
            self.is_due(task, &request.kinds, now_ms)
                && !self.is_left_to_others(bake, task, &request.worker, now_ms)
        });
        let cost_of = |key: TaskKey| self.tasks.get(&key).map(|task| task.spec.cost);
        let cost =
            |task: &Task| rules::claim_cost(task.spec.cost, task.spec.dependencies().filter_map(cost_of));
        let best = claimable.min_by_key(|task| (Reverse(cost(task)), task.spec.key))?;
        Some(best.spec.key)
    }

    pub(super) fn look(&self, bakes: &[String], now_ms: i64) -> Look {
        let mut openings: Vec<Opening> = Vec::new();
        for bake in self.bakes.iter().filter(|bake| bake.state == BakeState::Running) {
            let open = bake.members.iter().filter(|(_, member)| !member.done);
            let tasks = open.filter_map(|(key, _)| self.tasks.get(key));
            // A bake with a limit of workers has openings of its own.
            let room = self.room_of(bake);
            let first = if room.is_some() { openings.len() } else { 0 };
            for task in tasks.filter(|task| self.is_due(task, std::slice::from_ref(&task.spec.kind), now_ms))
            {
                let (kind, needs, room) = (task.spec.kind.clone(), bake.new.needs.clone(), room.clone());
                let mut known = openings[first..].iter_mut();
                let is_it = |known: &&mut Opening| {
                    known.kind == kind && known.needs == needs && known.room.is_some() == room.is_some()
                };
                match known.find(is_it) {
                    Some(known) => known.ready += 1,
                    None => openings.push(Opening { kind, needs, ready: 1, room, maker: None }),
                }
            }
        }
        openings.extend(self.rerun_openings(now_ms));
        let asked = self.bakes.iter().filter(|bake| bakes.contains(&bake.id));
        let standing = |bake: &BakeEntry| Standing {
            bake: bake.id.clone(),
            is_final: bake.state.is_final(),
            last_event: bake.events.len() as u64,
            last_place: bake.places,
        };
        Look { openings, standings: asked.map(standing).collect() }
    }

    pub(super) fn note_present(&mut self, workers: &[String], now_ms: i64) {
        for name in workers {
            if let Some(worker) = self.workers.get_mut(name) {
                worker.seen_ms = worker.seen_ms.max(now_ms);
            }
        }
    }

    fn is_due(&self, task: &Task, kinds: &[String], now_ms: i64) -> bool {
        kinds.contains(&task.spec.kind)
            && task.not_before_ms <= now_ms
            && self.state_of(task) == TaskState::Ready
    }

    /// A worker that failed at a task leaves it to others, if one that could do it and has not failed is present.
    fn is_left_to_others(&self, bake: usize, task: &Task, worker: &str, now_ms: i64) -> bool {
        task.blamed.contains(worker)
            && self.workers.iter().any(|(name, other)| {
                !task.blamed.contains(name)
                    && other.seen_ms > now_ms - WORKER_PRESENT_MS
                    && other.abilities.kinds.contains(&task.spec.kind)
                    && other.abilities.suffice(&self.bakes[bake].new.needs)
            })
    }

    fn lease(
        &mut self,
        bake: usize,
        key: TaskKey,
        request: &ClaimRequest,
        now_ms: i64,
    ) -> Result<Lease, StoreError> {
        let token = random::fencing_token();
        let ttl_ms = i64::from(request.ttl_secs) * 1000;
        let deadline_ms = rules::deadline_ms(now_ms, self.bakes[bake].new.attempt_limit_secs);
        let expires_ms = (now_ms + ttl_ms).min(deadline_ms);
        for bake in self.live_bakes_of(key) {
            let kind = self.tasks[&key].spec.kind.clone();
            self.bakes[bake].stage(&kind).first_claim_ms.get_or_insert(now_ms);
        }
        let worker = request.worker.clone();
        let attempt = self.tasks[&key].attempts + self.tasks[&key].losses + 1;
        for bake in self.live_bakes_of(key) {
            let TaskSpec { kind, label, .. } = self.tasks[&key].spec.clone();
            let worker = worker.clone();
            self.event(bake, now_ms, EventKind::TaskStarted { key, kind, label, worker, attempt });
        }
        if let Some(worker) = self.workers.get_mut(&worker) {
            worker.scene = Some(self.bakes[bake].new.scene);
        }
        let lease = LeaseEntry {
            key,
            bake: self.bakes[bake].id.clone(),
            worker,
            ttl_ms,
            started_ms: now_ms,
            expires_ms,
            deadline_ms,
            cancelled: false,
            state: LeaseState::Granted,
            input_lost: false,
            attempt,
            graces: 0,
        };
        self.leases.insert(token.clone(), lease);
        if let Some(task) = self.tasks.get_mut(&key) {
            task.lease = Some(token.clone());
        }
        let task = self.tasks[&key].spec.clone();
        let inputs = rules::resolve_inputs(&task, |key| self.outputs_of(key));
        let BakeEntry { id, traceparent, .. } = &self.bakes[bake];
        let (bake, traceparent) = (id.clone(), traceparent.clone());
        let alike = self.outputs_of_alike(&task);
        Ok(Lease { token, bake, task, inputs, alike, expires_ms, traceparent })
    }

    pub(super) fn heartbeat(&mut self, token: &str, _progress: f32, now_ms: i64) -> HeartbeatAnswer {
        if let Some((worker, expires_ms)) = self.keep_rerun(token, now_ms) {
            self.see_holder(&worker, now_ms);
            return HeartbeatAnswer { verdict: Verdict::Keep, expires_ms };
        }
        self.hear_late(token, now_ms);
        let Some(lease) = self.leases.get_mut(token) else {
            return HeartbeatAnswer { verdict: Verdict::Lost, expires_ms: now_ms };
        };
        let mut verdict = Verdict::Keep;
        if lease.cancelled {
            verdict = Verdict::Cancel;
        } else if lease.expires_ms <= now_ms {
            verdict = Verdict::Lost;
        } else {
            lease.expires_ms = (now_ms + lease.ttl_ms).min(lease.deadline_ms);
            (lease.state, lease.graces) = (LeaseState::Held, 0);
        }
        let (worker, expires_ms) = (lease.worker.clone(), lease.expires_ms);
        self.see_holder(&worker, now_ms);
        HeartbeatAnswer { verdict, expires_ms }
    }

    fn see_holder(&mut self, worker: &str, now_ms: i64) {
        if let Some(worker) = self.workers.get_mut(worker)
            && now_ms - worker.seen_ms >= WORKER_SEEN_GRAIN_MS
        {
            worker.seen_ms = now_ms;
        }
    }

    /// A holder whose lease has run out turns out to be alive: its loss is given back, once, and not for ever.
    pub(super) fn hear_late(&mut self, token: &str, now_ms: i64) {
        if let Some(lease) = self.leases.get_mut(token)
            && lease.state == LeaseState::Held
            && lease.expires_ms <= now_ms
            && lease.expires_ms < lease.deadline_ms
        {
            lease.state = LeaseState::Late;
        }
        let Some(expired) = self.expired.get_mut(token).filter(|expired| expired.counted) else { return };
        expired.counted = false;
        let expired = expired.clone();
        if let Some(task) = self.tasks.get_mut(&expired.key)
            && task.done.is_none()
            && task.losses > 0
            && task.pardons < MAX_PARDONS
        {
            (task.losses, task.pardons) = (task.losses - 1, task.pardons + 1);
            if expired.is_first {
                task.lost_with.remove(&expired.worker);
            }
        }
    }

    /// Takes the lease away if it is still good. A cancelled one goes too, but gives nothing.
    pub(super) fn end_lease(&mut self, token: &str, now_ms: i64) -> Option<LeaseEntry> {
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

    pub(super) fn take_lease(&mut self, token: &str) -> Option<LeaseEntry> {
        let lease = self.leases.remove(token)?;
        if let Some(task) = self.tasks.get_mut(&lease.key)
            && !lease.cancelled
        {
            task.lease = None;
        }
        Some(lease)
    }

    /// Those of some results that are taken in before the others, as they need nothing of the farm: none if one of them is refused.
    pub(super) fn commits_first(&self, commits: &[(&str, &TaskResult)], now_ms: i64) -> Vec<usize> {
        let mut first: Vec<usize> = Vec::new();
        for (index, (token, result)) in commits.iter().enumerate() {
            let lease = self.leases.get(*token).filter(|lease| !lease.cancelled && lease.expires_ms > now_ms);
            let Some(task) = lease.and_then(|lease| self.tasks.get(&lease.key)) else { continue };
            let key = &task.spec.key;
            let is_missed =
                self.bakes.iter().any(|bake| bake.members.get(key).is_some_and(|member| member.lost));
            let is_again = first.iter().any(|earlier| commits[*earlier].0 == *token);
            if is_missed || is_again || !task.outputs_before.is_empty() || !task.witnesses.is_empty() {
                continue;
            }
            if result.outputs.iter().any(|output| self.chunks.require(output.digest).is_err()) {
                return Vec::new();
            }
            first.push(index);
        }
        first
    }

    pub(super) fn commit(
        &mut self,
        token: &str,
        result: &TaskResult,
        now_ms: i64,
    ) -> Result<CommitVerdict, StoreError> {
        let by_token = |task: &&Task| task.done.as_ref().is_some_and(|(_, by)| by == token);
        if let Some(task) = self.tasks.values().find(by_token) {
            let (key, worker) = (task.spec.key, task.done_by.clone());
            self.compare(key, &self.outputs_of(&key), &Given::of(token, &worker, result), now_ms);
            return Ok(CommitVerdict::AlreadyCommitted);
        }
        if self.commit_rerun(token, result, now_ms) {
            return Ok(CommitVerdict::Committed);
        }
        rules::check_plan(&result.plan)?;
        let is_good = |lease: &LeaseEntry| !lease.cancelled && lease.expires_ms > now_ms;
        if self.leases.get(token).is_some_and(is_good) {
            result.outputs.iter().try_for_each(|output| self.chunks.require(output.digest))?;
        }
        self.hear_late(token, now_ms);
        let Some(lease) = self.end_lease(token, now_ms) else {
            self.witness(token, result, now_ms);
            return Ok(CommitVerdict::Stale);
        };
        let key = lease.key;
        let Some(task) = self.tasks.get_mut(&key) else { return Ok(CommitVerdict::Stale) };
        task.done = Some((result.clone(), token.to_owned()));
        task.done_by.clone_from(&lease.worker);
        let before = std::mem::take(&mut task.outputs_before);
        let mut witnesses = std::mem::take(&mut task.witnesses);
        witnesses.sort_by_key(|given| rules::order_of_witness(&given.worker, &given.outputs));
        let (spec, attempt) = (task.spec.clone(), lease.attempt);
        self.release_readers(key);
        for bake in &mut self.bakes {
            if bake.members.get(&key).is_some_and(|member| member.lost) {
                let place = Some(bake.next_place());
                if let Some(member) = bake.members.get_mut(&key) {
                    (member.held, member.lost, member.place) = (true, false, place);
                }
            }
        }
        if !before.is_empty() {
            self.compare(key, &before, &Given::of(token, &lease.worker, result), now_ms);
        }
        for given in witnesses {
            self.compare(key, &result.outputs, &given, now_ms);
        }
        self.choose(key, &lease.worker, now_ms);
        for bake in self.live_bakes_of(key) {
            let entry = &mut self.bakes[bake];
            entry.tasks_run += 1;
            add_counters(&mut entry.counters, &result.counters);
            entry.note_outputs(&result.outputs);
            entry.stage(&spec.kind).last_commit_ms = Some(now_ms);
            let place = Some(entry.next_place());
            if let Some(member) = entry.members.get_mut(&key) {
                (member.done, member.place) = (true, place);
            }
            let (kind, label, worker) = (spec.kind.clone(), spec.label.clone(), lease.worker.clone());
            let elapsed_ms = lease.elapsed_ms(now_ms);
            let note = result.note.clone();
            let done = EventKind::TaskDone { key, kind, label, worker, attempt, elapsed_ms, note };
            self.event(bake, now_ms, done);
            if let Some(failure) = self.failure_by_making(bake, key, &before) {
                self.close(bake, BakeState::Failed, Some(failure), now_ms);
                continue;
            }
            self.apply_plan(bake, &result.plan, now_ms)?;
            self.finish_if_done(bake, now_ms);
        }
        Ok(CommitVerdict::Committed)
    }
}
