//! Ends of the model's attempts without a result: release, failure, expiry; and clocks that were set back.

use lightkiln_proto::api::{BakeLimits, BakeState, Blame, EventKind};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::TaskSpec;

use super::entries::{ExpiredEntry, LeaseEntry};
use super::farm::Farm;
use lightkiln_server::store::limits;
use lightkiln_server::store::rules::{self, FarmRules, MAX_EXPIRED, MAX_PARDONS, WAIT_MAX_MS};
use lightkiln_server::store::{FailVerdict, LeaseState, Reaped};

impl Farm {
    pub(super) fn release(&mut self, token: &str, now_ms: i64) -> bool {
        if self.release_rerun(token, now_ms) {
            return true;
        }
        self.hear_late(token, now_ms);
        let Some(lease) = self.end_lease(token, now_ms) else { return false };
        let key = lease.key;
        for bake in self.live_bakes_of(key) {
            let TaskSpec { kind, label, .. } = self.tasks[&key].spec.clone();
            let (worker, elapsed_ms) = (lease.worker.clone(), lease.elapsed_ms(now_ms));
            self.event(bake, now_ms, EventKind::TaskReleased { key, kind, label, worker, elapsed_ms });
        }
        true
    }

    pub(super) fn fail(
        &mut self,
        token: &str,
        blame: Blame,
        message: &str,
        (rules, now_ms): (FarmRules, i64),
    ) -> FailVerdict {
        if self.fail_rerun(token, now_ms) {
            return FailVerdict::Rerun;
        }
        let Some(lease) = self.end_lease(token, now_ms) else { return FailVerdict::Stale };
        let message = rules::cut_message(message);
        let wait_ms = match blame {
            Blame::Task => {
                let TaskSpec { label, kind, .. } = &self.tasks[&lease.key].spec;
                let failure = rules::task_fault_message(label, kind, &lease.worker, &message);
                self.count_attempt(lease.key, blame);
                self.give_up(&lease, (blame, &message), &failure, now_ms);
                None
            }
            Blame::Worker if lease.input_lost => Some(0),
            Blame::Worker => self.blame_worker(&lease, &message, now_ms),
            Blame::Lost if lease.state == LeaseState::Granted => Some(0),
            Blame::Lost => self.count_loss(&lease, &message, (rules, now_ms)),
        };
        let Some(wait_ms) = wait_ms else { return FailVerdict::GivenUp };
        self.task_failed(&lease, (blame, &message), Some(wait_ms), now_ms);
        FailVerdict::Retry
    }

    fn count_attempt(&mut self, key: TaskKey, blame: Blame) {
        for bake in self.live_bakes_of(key) {
            let bake = &mut self.bakes[bake];
            match blame {
                Blame::Lost => bake.attempts_lost += 1,
                Blame::Task | Blame::Worker => bake.attempts_failed += 1,
            }
        }
    }

    /// Counts a worker that was lost with a task: the wait before the next try, or none when the task was given up.
    fn count_loss(
        &mut self,
        lease: &LeaseEntry,
        message: &str,
        (rules, now_ms): (FarmRules, i64),
    ) -> Option<i64> {
        self.count_attempt(lease.key, Blame::Lost);
        let wanted = self.limits_of(lease.key);
        let task = self.tasks.get_mut(&lease.key)?;
        task.losses += 1;
        task.lost_with.insert(lease.worker.clone());
        if !limits::is_lost_too_often(&wanted, task.losses, &rules) {
            let wait_ms = rules::lost_wait_ms(lease.key, task.losses);
            task.not_before_ms = now_ms + wait_ms;
            return Some(wait_ms);
        }
        let TaskSpec { label, kind, .. } = &task.spec;
        let failure = rules::lost_message(label, kind, task.losses, message);
        self.give_up(lease, (Blame::Lost, message), &failure, now_ms);
        None
    }

    /// Counts an attempt against a worker: the wait before the next try, or none when the task was given up.
    fn blame_worker(&mut self, lease: &LeaseEntry, message: &str, now_ms: i64) -> Option<i64> {
        self.count_attempt(lease.key, Blame::Worker);
        let wanted = self.limits_of(lease.key);
        let task = self.tasks.get_mut(&lease.key)?;
        task.attempts += 1;
        task.blamed.insert(lease.worker.clone());
        let (attempts, workers) = (task.attempts, task.blamed.len() as u32);
        if !limits::is_given_up(&wanted, attempts, workers) {
            let wait_ms = rules::retry_wait_ms(lease.key, attempts);
            task.not_before_ms = now_ms + wait_ms;
            return Some(wait_ms);
        }
        let TaskSpec { label, kind, .. } = &task.spec;
        let failure = rules::given_up_message(label, kind, attempts, workers, message);
        self.give_up(lease, (Blame::Worker, message), &failure, now_ms);
        None
    }

    /// Limits of the live bakes that hold a task.
    fn limits_of(&self, key: TaskKey) -> Vec<BakeLimits> {
        self.live_bakes_of(key).into_iter().map(|bake| self.bakes[bake].new.limits).collect()
    }

    fn give_up(&mut self, lease: &LeaseEntry, why: (Blame, &str), failure: &str, now_ms: i64) {
        self.task_failed(lease, why, None, now_ms);
        for bake in self.live_bakes_of(lease.key) {
            self.close(bake, BakeState::Failed, Some(failure.to_owned()), now_ms);
        }
    }

    fn task_failed(
        &mut self,
        lease: &LeaseEntry,
        (blame, message): (Blame, &str),
        wait_ms: Option<i64>,
        now_ms: i64,
    ) {
        let TaskSpec { kind, label, .. } = self.tasks[&lease.key].spec.clone();
        let failed = EventKind::TaskFailed {
            key: lease.key,
            kind,
            label,
            worker: lease.worker.clone(),
            message: message.to_owned(),
            retry: wait_ms.is_some(),
            blame,
            attempt: lease.attempt,
            elapsed_ms: lease.elapsed_ms(now_ms),
            wait_ms: wait_ms.and_then(|wait_ms| u64::try_from(wait_ms).ok()).unwrap_or(0),
        };
        for bake in self.live_bakes_of(lease.key) {
            self.event(bake, now_ms, failed.clone());
        }
    }

    /// Lets nothing lie further ahead than it could if it began now: a clock that was set back made it.
    fn heed_clock(&mut self, now_ms: i64) {
        for lease in self.leases.values_mut() {
            if lease.started_ms > now_ms {
                lease.deadline_ms -= lease.started_ms - now_ms;
                lease.started_ms = now_ms;
            }
            if lease.expires_ms > now_ms + lease.ttl_ms {
                lease.expires_ms = lease.deadline_ms.min(now_ms + lease.ttl_ms);
            }
        }
        let ready: Vec<TaskKey> = self.ready_since_ms.keys().map(|(_, key)| *key).collect();
        for key in ready {
            if let Some(task) = self.tasks.get_mut(&key)
                && task.not_before_ms > now_ms + WAIT_MAX_MS
            {
                task.not_before_ms = now_ms;
            }
        }
        for worker in self.workers.values_mut() {
            worker.seen_ms = worker.seen_ms.min(now_ms);
        }
    }

    pub(super) fn reap(&mut self, rules: FarmRules, now_ms: i64) -> Reaped {
        self.heed_clock(now_ms);
        let mut out: Vec<(i64, TaskKey, String)> = Vec::new();
        for (token, lease) in &self.leases {
            if lease.expires_ms <= now_ms {
                out.push((lease.expires_ms, lease.key, token.clone()));
            }
        }
        out.sort();
        let mut reaped = Reaped { expired: self.reap_reruns(now_ms), ..Reaped::default() };
        for (_, key, token) in out {
            // Dropped with its bake meanwhile, or cancelled before: nobody is to blame.
            let Some(lease) = self.take_lease(&token).filter(|lease| !lease.cancelled) else { continue };
            reaped.expired += 1;
            let took_too_long = lease.expires_ms >= lease.deadline_ms;
            for bake in self.live_bakes_of(key) {
                let TaskSpec { kind, label, .. } = self.tasks[&key].spec.clone();
                let (worker, attempt) = (lease.worker.clone(), lease.attempt);
                let elapsed_ms = lease.elapsed_ms(now_ms);
                let expired =
                    EventKind::LeaseExpired { key, kind, label, worker, attempt, elapsed_ms, took_too_long };
                self.event(bake, now_ms, expired);
            }
            let Some(task) = self.tasks.get_mut(&key) else { continue };
            let is_pardoned = lease.state == LeaseState::Late && task.pardons < MAX_PARDONS;
            task.pardons += u32::from(is_pardoned);
            let is_lost = lease.state != LeaseState::Granted && !is_pardoned && !took_too_long;
            let is_first = !task.lost_with.contains(&lease.worker);
            let expired = ExpiredEntry { key, worker: lease.worker.clone(), counted: is_lost, is_first };
            let remembered = self.expired.values().filter(|expired| expired.key == key).count();
            if is_lost || remembered < MAX_EXPIRED as usize {
                self.expired.insert(token, expired);
            }
            let wait_ms = if is_lost {
                reaped.lost += 1;
                self.count_loss(&lease, &rules::expiry_message(&lease.worker), (rules, now_ms))
            } else if lease.state == LeaseState::Granted || is_pardoned {
                Some(0)
            } else {
                self.blame_worker(&lease, &rules::limit_message(&lease.worker), now_ms)
            };
            reaped.given_up += u64::from(wait_ms.is_none());
        }
        reaped
    }
}
