//! Views of the model for callers: everything is counted afresh.

use std::collections::BTreeMap;

use lightkiln_proto::api::{
    Bake, BakeFilter, BakePage, BakeResult, BakeState, EventPage, ResultPage, StageCount, Worker,
};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::TaskSpec;

use super::entries::{BakeEntry, Member, Stage};
use super::farm::Farm;
use lightkiln_server::store::limits;
use lightkiln_server::store::rules::{WORKER_LISTED_MS, results_on_page};
use lightkiln_server::store::{Demand, Named, Stats, StoreError, TaskCount, TaskState};

impl Farm {
    pub(super) fn view(&self, index: usize) -> Bake {
        let entry = &self.bakes[index];
        let done = entry.state == BakeState::Done;
        Bake {
            id: entry.id.clone(),
            name: entry.new.name.clone(),
            kind: entry.new.kind.clone(),
            scene: entry.new.scene,
            settings: entry.new.settings.clone(),
            priority: entry.new.priority,
            needs: entry.new.needs.clone(),
            limits: entry.new.limits,
            verify_share: entry.new.verify_share,
            state: entry.state,
            stages: entry.stages.iter().map(|stage| self.stage_count(entry, stage)).collect(),
            tasks_run: entry.tasks_run,
            tasks_reused: reused(entry),
            results_lost: entry.members.values().filter(|member| member.lost).count() as u64,
            attempts_failed: entry.attempts_failed,
            attempts_lost: entry.attempts_lost,
            alarms: entry.alarms,
            owner: entry.owner.clone(),
            failure: entry.failure.clone(),
            manifest: entry.manifest.filter(|_| done),
            report: entry.report.filter(|_| done),
            evaluation: entry.evaluation.as_ref().map(|(index, _)| *index),
            created_ms: entry.created_ms,
            finished_ms: entry.finished_ms,
            counters: entry.counters.clone(),
            counters_reused: entry.counters_reused.clone(),
        }
    }

    fn stage_count(&self, bake: &BakeEntry, stage: &Stage) -> StageCount {
        let elapsed_ms = match (stage.first_claim_ms, stage.last_commit_ms) {
            (Some(first), Some(last)) => u64::try_from(last - first).unwrap_or(0),
            _ => 0,
        };
        let kind = stage.kind.clone();
        let (total, done, reused, leased, cost_total, cost_done) = (0, 0, 0, 0, 0, 0);
        let mut count = StageCount { kind, total, done, reused, leased, cost_total, cost_done, elapsed_ms };
        for (key, member) in bake.members.iter().filter(|(_, member)| member.kind == stage.kind) {
            count.total += 1;
            count.cost_total += member.cost;
            count.reused += u64::from(member.reused);
            if member.done {
                count.done += 1;
                count.cost_done += member.cost;
            } else if !bake.state.is_final() && self.is_leased(key) {
                count.leased += 1;
            }
        }
        count
    }

    pub(super) fn is_leased(&self, key: &TaskKey) -> bool {
        self.tasks.get(key).is_some_and(|task| task.lease.is_some())
    }

    pub(super) fn list(&self, filter: &BakeFilter, after: Option<u64>, limit: u32) -> BakePage {
        let is_before = |bake: &BakeEntry| after.is_none_or(|after| bake.seq < after);
        let taken = (0..self.bakes.len()).rev().filter(|index| {
            let bake = &self.bakes[*index];
            is_before(bake) && takes(filter, bake)
        });
        let mut indices: Vec<usize> = taken.take(limit as usize + 1).collect();
        let has_more = indices.len() > limit as usize;
        indices.truncate(limit as usize);
        let next = indices.last().filter(|_| has_more).map(|index| self.bakes[*index].seq);
        BakePage { bakes: indices.into_iter().map(|index| self.view(index)).collect(), next }
    }

    pub(super) fn begin_with(&self, id: &str, limit: u32) -> Vec<Named> {
        let alike = self.bakes.iter().filter(|bake| bake.id.starts_with(id));
        let named =
            |bake: &BakeEntry| Named { id: bake.id.clone(), name: bake.new.name.clone(), state: bake.state };
        let mut found: Vec<Named> = alike.map(named).collect();
        found.sort_by(|a, b| a.id.cmp(&b.id));
        found.truncate(limit as usize);
        found
    }

    pub(super) fn events_after(&self, bake: &str, after: u64, limit: u32) -> Result<EventPage, StoreError> {
        let index = self.index_of(bake)?;
        let later = self.bakes[index].events.iter().filter(|event| event.seq > after);
        Ok(EventPage { events: later.take(limit as usize).cloned().collect(), bake: self.view(index) })
    }

    pub(super) fn results_after(
        &self,
        bake: &str,
        kind: Option<&str>,
        after: u64,
        limit: u32,
    ) -> Result<ResultPage, StoreError> {
        let index = self.index_of(bake)?;
        let held = self.bakes[index].members.iter().filter(|(_, member)| member.held);
        let later = held.filter(|(_, member)| kind.is_none_or(|kind| kind == member.kind));
        let result = |(key, member): (&TaskKey, &Member)| {
            let place = member.place.filter(|place| *place > after)?;
            let TaskSpec { kind, label, .. } = self.tasks.get(key)?.spec.clone();
            Some(BakeResult { place, key: *key, kind, label, outputs: self.outputs_of(key) })
        };
        let mut results: Vec<BakeResult> = later.filter_map(result).collect();
        results.sort_by_key(|result| result.place);
        let count = results.len();
        results.truncate(limit as usize);
        let bytes = |result: &BakeResult| serde_json::json!(result.outputs).to_string().len() as u64;
        results.truncate(results_on_page(results.iter().map(bytes)));
        let is_full = results.len() < count || results.len() == limit as usize;
        let last = results.last().map(|result| result.place).filter(|_| is_full);
        let next_after = last.unwrap_or(self.bakes[index].places).max(after);
        Ok(ResultPage { results, next_after, bake: self.view(index) })
    }

    pub(super) fn workers(&self, now_ms: i64) -> Vec<Worker> {
        let lately = self.workers.iter().filter(|(_, worker)| worker.seen_ms > now_ms - WORKER_LISTED_MS);
        let view = |(name, worker): (&String, &super::entries::WorkerEntry)| Worker {
            name: name.clone(),
            kinds: worker.abilities.kinds.clone(),
            threads: worker.abilities.threads,
            memory_mib: worker.abilities.memory_mib,
            labels: worker.abilities.labels.clone(),
            seen_ms: worker.seen_ms,
            holds: self.holds(name),
        };
        lately.map(view).collect()
    }

    fn holds(&self, worker: &str) -> Vec<String> {
        let held = self.leases.values().filter(|lease| lease.worker == worker && !lease.cancelled);
        let mut labels: Vec<String> =
            held.filter_map(|lease| Some(self.tasks.get(&lease.key)?.spec.label.clone())).collect();
        labels.extend(self.reruns_held_by(worker));
        labels.sort();
        labels
    }

    /// Notes which tasks became ready since the last call, and forgets those that are not any more.
    pub(super) fn note_ready(&mut self, now_ms: i64) {
        let mut ready = BTreeMap::new();
        for bake in self.bakes.iter().filter(|bake| !bake.state.is_final()) {
            let open = bake.members.iter().filter(|(_, member)| !member.done);
            for (key, task) in open.filter_map(|(key, _)| Some((key, self.tasks.get(key)?))) {
                if self.state_of(task) == TaskState::Ready {
                    let place = (bake.id.clone(), *key);
                    let since_ms = self.ready_since_ms.get(&place).copied().unwrap_or(now_ms);
                    ready.insert(place, since_ms);
                }
            }
        }
        self.ready_since_ms = ready;
    }

    /// Ready tasks of a bake and the longest wait of one, by kind.
    fn ready_by_kind(&self, bake: &BakeEntry, now_ms: i64) -> BTreeMap<String, (u64, u64)> {
        let mut ready = BTreeMap::new();
        let open = bake.members.iter().filter(|(_, member)| !member.done);
        for (key, task) in open.filter_map(|(key, _)| Some((key, self.tasks.get(key)?))) {
            let since_ms = self.ready_since_ms.get(&(bake.id.clone(), *key));
            let Some(since_ms) = since_ms.filter(|_| self.state_of(task) == TaskState::Ready) else {
                continue;
            };
            let waited_ms = u64::try_from(now_ms - task.not_before_ms.max(*since_ms)).unwrap_or(0);
            let entry = ready.entry(task.spec.kind.clone()).or_insert((0, 0));
            *entry = (entry.0 + 1, waited_ms.max(entry.1));
        }
        ready
    }

    pub(super) fn stats(&self, now_ms: i64) -> Stats {
        let mut counts = BTreeMap::new();
        for task in self.tasks.values() {
            *counts.entry((task.spec.kind.clone(), self.state_of(task))).or_insert(0) += 1;
        }
        let tasks = counts.into_iter().map(|((kind, state), count)| TaskCount { kind, state, count });
        let mut demand = BTreeMap::new();
        for bake in self.bakes.iter().filter(|bake| bake.state == BakeState::Running) {
            let mut left = self.room_of(bake).map(|room| room.others);
            for (kind, (ready, waited_ms)) in self.ready_by_kind(bake, now_ms) {
                let ready = limits::take_room(&mut left, ready);
                if ready > 0 {
                    let needs = bake.new.needs.clone();
                    let entry = demand.entry((kind.clone(), serde_json::json!(needs).to_string()));
                    let entry = entry.or_insert(Demand { kind, needs, ready: 0, waited_ms });
                    entry.ready += ready;
                    entry.waited_ms = entry.waited_ms.max(waited_ms);
                }
            }
        }
        Stats {
            demand: demand.into_values().collect(),
            tasks: tasks.collect(),
            bakes_live: self.bakes.iter().filter(|bake| !bake.state.is_final()).count() as u64,
            bakes_total: self.bakes.len() as u64,
            tasks_run: self.gone_run + self.bakes.iter().map(|bake| bake.tasks_run).sum::<u64>(),
            tasks_reused: self.gone_reused + self.bakes.iter().map(reused).sum::<u64>(),
            alarms: self.alarms.len() as u64,
            verified: self.verified,
            reruns_waiting: self.reruns.len() as u64,
            reruns_lapsed: self.reruns_over - self.verified,
        }
    }
}

fn takes(filter: &BakeFilter, bake: &BakeEntry) -> bool {
    let has_state = filter.states.is_empty() || filter.states.contains(&bake.state);
    let has_name = bake.new.name.to_ascii_lowercase().contains(&filter.name.to_ascii_lowercase());
    has_state && has_name && filter.since_ms.is_none_or(|since_ms| bake.created_ms >= since_ms)
}

fn reused(bake: &BakeEntry) -> u64 {
    bake.members.values().filter(|member| member.reused).count() as u64
}
