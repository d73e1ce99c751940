//! Results of one task of the model that differ.

use lightkiln_proto::api::EventKind;
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::{Artefact, TaskResult, TaskSpec};

use super::farm::Farm;
use lightkiln_server::store::rules::{self, Difference, MAX_ALARMS_TOLD};

/// Outputs that an attempt gave, or would have given.
#[derive(Clone)]
pub(super) struct Given {
    pub(super) token: String,
    pub(super) worker: String,
    pub(super) outputs: Vec<Artefact>,
}

impl Given {
    pub(super) fn of(token: &str, worker: &str, result: &TaskResult) -> Self {
        Self { token: token.to_owned(), worker: worker.to_owned(), outputs: result.outputs.clone() }
    }
}

impl Farm {
    /// Tells every bake that holds the task of a result that is not as that which counts, once.
    pub(super) fn compare(&mut self, key: TaskKey, kept: &[Artefact], given: &Given, now_ms: i64) {
        let Some(difference) = rules::difference(kept, &given.outputs) else { return };
        if !self.alarms.insert(given.token.clone()) {
            return;
        }
        let TaskSpec { kind, label, .. } = self.tasks[&key].spec.clone();
        let (worker, Difference { name: output, kept, found }) = (given.worker.clone(), difference);
        let event = EventKind::ResultDiffers { key, kind, label, worker, output, kept, found };
        let holds = |index: &usize| self.bakes[*index].members.get(&key).is_some_and(|member| member.held);
        for bake in (0..self.bakes.len()).filter(holds).collect::<Vec<_>>() {
            self.bakes[bake].alarms += 1;
            if self.bakes[bake].alarms <= MAX_ALARMS_TOLD.into() {
                self.event(bake, now_ms, event.clone());
            }
        }
    }

    /// Compares a result whose lease was gone with the one that counts, or keeps it until there is one.
    pub(super) fn witness(&mut self, token: &str, result: &TaskResult, now_ms: i64) {
        let held =
            self.leases.get(token).filter(|lease| !lease.cancelled).map(|lease| (lease.key, &lease.worker));
        let expired = self.expired.get(token).map(|expired| (expired.key, &expired.worker));
        let Some((key, worker)) = held.or(expired) else { return };
        let given = Given::of(token, worker, result);
        let Some(task) = self.tasks.get_mut(&key) else { return };
        if task.done.is_some() {
            self.compare(key, &self.outputs_of(&key), &given, now_ms);
        } else if task.witnesses.iter().all(|known| known.token != token) {
            task.witnesses.push(given);
        }
    }
}
