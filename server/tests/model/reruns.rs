//! Results of the model that are made once more on another machine.

use lightkiln_proto::api::{ClaimRequest, Lease};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::TaskResult;

use super::alarms::Given;
use super::farm::Farm;
use lightkiln_proto::api::BakeState;
use lightkiln_server::random;
use lightkiln_server::store::rules::{self, Abilities, MAX_GRACES};
use lightkiln_server::store::verify::{RERUN_LAPSES_MS, RERUN_TRIES, RERUNS_GIVEN_UP, is_chosen};
use lightkiln_server::store::{Maker, Opening};

/// A result that waits, or is being made once more.
#[derive(Clone)]
pub(super) struct Rerun {
    /// Id of the bake that chose it.
    bake: String,
    maker: Maker,
    /// Then it lapses.
    until_ms: i64,
    tries: u32,
    lease: Option<RerunLease>,
}

#[derive(Clone)]
struct RerunLease {
    token: String,
    worker: String,
    ttl_ms: i64,
    started_ms: i64,
    expires_ms: i64,
    deadline_ms: i64,
    graces: u32,
}

impl Farm {
    /// Lets a result wait if one of the live bakes that hold its task chooses it.
    pub(super) fn choose(&mut self, key: TaskKey, worker: &str, now_ms: i64) {
        let live = self.live_bakes_of(key);
        let chooses = |bake: &&usize| is_chosen(key, self.bakes[**bake].new.verify_share);
        let Some(bake) = live.iter().find(chooses) else { return };
        let bake = self.bakes[*bake].id.clone();
        let machine = self.workers.get(worker).map(|worker| worker.machine.clone()).unwrap_or_default();
        let maker = Maker { worker: worker.to_owned(), machine };
        let rerun = Rerun { bake, maker, until_ms: now_ms + RERUN_LAPSES_MS, tries: 0, lease: None };
        self.reruns.insert(key, rerun);
    }

    /// Removes the rerun of a task, if there is one.
    pub(super) fn end_rerun(&mut self, key: TaskKey) {
        self.reruns_over += u64::from(self.reruns.remove(&key).is_some());
    }

    /// Removes the reruns that a bake chose.
    pub(super) fn end_reruns_of(&mut self, bake: &str) {
        let before = self.reruns.len();
        self.reruns.retain(|_, rerun| rerun.bake != bake);
        self.reruns_over += (before - self.reruns.len()) as u64;
    }

    /// The opening of a rerun, if it waits.
    fn opening(&self, key: TaskKey, rerun: &Rerun, now_ms: i64) -> Option<Opening> {
        let bake = &self.bakes[self.index_of(&rerun.bake).ok()?];
        let waits = rerun.lease.is_none() && rerun.until_ms > now_ms && bake.state != BakeState::Paused;
        let (kind, needs) = (self.tasks.get(&key)?.spec.kind.clone(), bake.new.needs.clone());
        waits.then(|| Opening { kind, needs, ready: 1, room: None, maker: Some(rerun.maker.clone()) })
    }

    pub(super) fn rerun_openings(&self, now_ms: i64) -> Vec<Opening> {
        let mut openings: Vec<Opening> = Vec::new();
        for opening in self.reruns.iter().filter_map(|(key, rerun)| self.opening(*key, rerun, now_ms)) {
            let is_it = |known: &&mut Opening| Opening { ready: 1, ..(*known).clone() } == opening;
            match openings.iter_mut().find(is_it) {
                Some(known) => known.ready += 1,
                None => openings.push(opening),
            }
        }
        openings
    }

    /// Hands out the task whose result has waited longest, to a worker that may make it again.
    pub(super) fn claim_rerun(&mut self, request: &ClaimRequest, now_ms: i64) -> Option<Lease> {
        if request.max == 0 {
            return None;
        }
        let abilities = Abilities::of(request);
        let may_take = |opening: &Opening| {
            request.kinds.contains(&opening.kind)
                && abilities.suffice(&opening.needs)
                && opening.maker.as_ref().is_some_and(|maker| maker.may_be_verified_by(request))
        };
        let takes = |(key, rerun): &(&TaskKey, &Rerun)| {
            self.opening(**key, rerun, now_ms).is_some_and(|opening| may_take(&opening))
        };
        let mut able: Vec<(i64, TaskKey)> =
            self.reruns.iter().filter(takes).map(|(key, rerun)| (rerun.until_ms, *key)).collect();
        able.sort_unstable();
        for (_, key) in able.into_iter().take(RERUNS_GIVEN_UP) {
            if self.has_inputs(key) {
                return self.lease_rerun(key, request, now_ms);
            }
            self.end_rerun(key);
        }
        None
    }

    /// Whether all that a task reads is there.
    fn has_inputs(&self, key: TaskKey) -> bool {
        let spec = &self.tasks[&key].spec;
        let is_done = |key: &TaskKey| self.tasks.get(key).is_some_and(|task| task.done.is_some());
        let inputs = rules::resolve_inputs(spec, |key| self.outputs_of(key));
        rules::dependencies(spec).iter().all(is_done)
            && inputs.iter().all(|input| self.chunks.kept(input.digest).is_some())
    }

    fn lease_rerun(&mut self, key: TaskKey, request: &ClaimRequest, now_ms: i64) -> Option<Lease> {
        let task = self.tasks.get(&key)?.spec.clone();
        let inputs = rules::resolve_inputs(&task, |key| self.outputs_of(key));
        let bake = self.index_of(&self.reruns.get(&key)?.bake).ok()?;
        let deadline_ms = rules::deadline_ms(now_ms, self.bakes[bake].new.attempt_limit_secs);
        let (token, ttl_ms) = (random::fencing_token(), i64::from(request.ttl_secs) * 1000);
        let expires_ms = (now_ms + ttl_ms).min(deadline_ms);
        self.reruns.get_mut(&key)?.lease = Some(RerunLease {
            token: token.clone(),
            worker: request.worker.clone(),
            ttl_ms,
            started_ms: now_ms,
            expires_ms,
            deadline_ms,
            graces: 0,
        });
        let (bake, traceparent) = (self.bakes[bake].id.clone(), self.bakes[bake].traceparent.clone());
        Some(Lease { token, bake, task, inputs, alike: Vec::new(), expires_ms, traceparent })
    }

    /// The rerun of a lease that is good.
    fn rerun_of(&mut self, token: &str, now_ms: i64) -> Option<(TaskKey, &mut Rerun)> {
        let is_it = |lease: &RerunLease| lease.token == token && lease.expires_ms > now_ms;
        let mut reruns = self.reruns.iter_mut();
        reruns.find(|(_, rerun)| rerun.lease.as_ref().is_some_and(is_it)).map(|(key, rerun)| (*key, rerun))
    }

    /// Prolongs a lease that is good: its worker, and until when.
    pub(super) fn keep_rerun(&mut self, token: &str, now_ms: i64) -> Option<(String, i64)> {
        let (_, rerun) = self.rerun_of(token, now_ms)?;
        let lease = rerun.lease.as_mut()?;
        (lease.expires_ms, lease.graces) = ((now_ms + lease.ttl_ms).min(lease.deadline_ms), 0);
        Some((lease.worker.clone(), lease.expires_ms))
    }

    pub(super) fn commit_rerun(&mut self, token: &str, result: &TaskResult, now_ms: i64) -> bool {
        let Some((key, rerun)) = self.rerun_of(token, now_ms) else { return false };
        let worker = rerun.lease.take().map(|lease| lease.worker).unwrap_or_default();
        self.end_rerun(key);
        self.verified += 1;
        self.compare(key, &self.outputs_of(&key), &Given::of(token, &worker, result), now_ms);
        true
    }

    pub(super) fn fail_rerun(&mut self, token: &str, now_ms: i64) -> bool {
        let Some((key, rerun)) = self.rerun_of(token, now_ms) else { return false };
        (rerun.lease, rerun.tries) = (None, rerun.tries + 1);
        if rerun.tries >= RERUN_TRIES {
            self.end_rerun(key);
        }
        true
    }

    pub(super) fn release_rerun(&mut self, token: &str, now_ms: i64) -> bool {
        self.rerun_of(token, now_ms).is_some_and(|(_, rerun)| rerun.lease.take().is_some())
    }

    pub(super) fn extend_reruns(&mut self, now_ms: i64) -> u64 {
        let mut extended = 0;
        for lease in self.reruns.values_mut().filter_map(|rerun| rerun.lease.as_mut()) {
            let runs_out_soon = lease.expires_ms <= now_ms + lease.ttl_ms / 2;
            if runs_out_soon && lease.expires_ms < lease.deadline_ms && lease.graces < MAX_GRACES {
                lease.expires_ms = (now_ms + lease.ttl_ms).min(lease.deadline_ms);
                lease.graces += 1;
                extended += 1;
            }
        }
        extended
    }

    /// Ends attempts whose leases ran out, and gives up what waited too long; returns how many leases ran out.
    pub(super) fn reap_reruns(&mut self, now_ms: i64) -> u64 {
        let mut expired = 0;
        for (key, mut rerun) in std::mem::take(&mut self.reruns) {
            match &mut rerun.lease {
                None => rerun.until_ms = rerun.until_ms.min(now_ms + RERUN_LAPSES_MS),
                Some(lease) => {
                    if lease.started_ms > now_ms {
                        lease.deadline_ms -= lease.started_ms - now_ms;
                        lease.started_ms = now_ms;
                    }
                    if lease.expires_ms > now_ms + lease.ttl_ms {
                        lease.expires_ms = lease.deadline_ms.min(now_ms + lease.ttl_ms);
                    }
                    if lease.expires_ms <= now_ms {
                        (rerun.lease, rerun.tries) = (None, rerun.tries + 1);
                        expired += 1;
                    }
                }
            }
            let lapses = rerun.lease.is_none() && rerun.until_ms <= now_ms;
            if lapses || rerun.tries >= RERUN_TRIES {
                self.reruns_over += 1;
            } else {
                self.reruns.insert(key, rerun);
            }
        }
        expired
    }

    /// Labels of the tasks that a worker makes once more.
    pub(super) fn reruns_held_by(&self, worker: &str) -> impl Iterator<Item = String> {
        let is_held = move |rerun: &Rerun| rerun.lease.as_ref().is_some_and(|lease| lease.worker == worker);
        self.reruns
            .iter()
            .filter(move |(_, rerun)| is_held(rerun))
            .filter_map(|(key, _)| Some(self.tasks.get(key)?.spec.label.clone()))
    }
}
