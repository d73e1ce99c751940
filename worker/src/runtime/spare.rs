//! Leases that came with one claim, and that no thread of the worker has begun: each of those who have no task takes one.
//!
//! They are in the seat's notes from their arrival: a process that ends without a word leaves all of them to the next one.

use std::collections::VecDeque;
use std::error::Error;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::time::Duration;

use lightkiln_http::{CallError, FOREVER, Level, ShutdownFlag, retry};
use lightkiln_proto::api::{ClaimRequest, Lease};

use super::claim::claim;
use super::shift::Shift;
use super::watch::{LastWords, tell};
use super::{Worker, WorkerError};

/// Most leases of one claim.
const LEASES_MAX: usize = 64;

/// An answer to a thread that asks for a task.
pub(super) enum Next {
    Task(Box<Lease>),
    /// There is none yet.
    Nothing,
    /// The worker begins none any more.
    Over,
}

impl Worker {
    /// The next task for the thread whose turn it is: a spare one, or the first of those that a claim brings.
    pub(super) fn next_task(
        &self,
        spare: &mut VecDeque<Lease>,
        shutdown: &ShutdownFlag,
        shift: &Shift,
    ) -> Result<Next, WorkerError> {
        // Look again: it may have taken long to come here.
        if shutdown.level() > Level::Run || shift.is_full() {
            return Ok(Next::Over);
        }
        // Leases that came when there was room go back when there is none: their tasks need not wait for it.
        if !self.has_room() {
            self.give_back_untried(spare.drain(..), shutdown);
        }
        if spare.is_empty() {
            if !self.wait_for_room(shutdown)? {
                return Ok(Next::Over);
            }
            match self.claim(shutdown, shift) {
                Ok(leases) => spare.extend(leases),
                Err(CallError::Stopped) => return Ok(Next::Over),
                Err(error) => return Err(WorkerError::Refused(error)),
            }
        }
        Ok(spare.pop_front().map_or(Next::Nothing, |lease| Next::Task(Box::new(lease))))
    }

    /// Claims tasks, and notes them.
    fn claim(&self, shutdown: &ShutdownFlag, shift: &Shift) -> Result<Vec<Lease>, CallError> {
        let is_over = |level| level > Level::Run;
        let pause = |error: &CallError, wait: Duration| {
            let (error, wait_secs) = (error as &dyn Error, wait.as_secs_f64());
            tracing::warn!(error, wait_secs, "no task could be claimed; trying again");
            shift.note_silence();
            if is_over(shutdown.wait(wait, is_over)) { Err(CallError::Stopped) } else { Ok(()) }
        };
        let leases = retry(FOREVER, || claim(&self.farm, self.claim_request(shift), shutdown), pause)?;
        if let Some(seat) = self.config.seat.as_ref().filter(|_| !leases.is_empty()) {
            let held = leases.iter().map(|lease| (lease.token.as_str(), lease.task.label.as_str()));
            seat.hold(&self.config.server_url, held);
        }
        Ok(leases)
    }

    pub(super) fn claim_request(&self, shift: &Shift) -> ClaimRequest {
        // As many as there are threads without a task, and as may begin.
        let wanted = self.idle.load(Ordering::Acquire).min(self.places()).clamp(1, LEASES_MAX);
        ClaimRequest {
            worker: self.config.name.clone(),
            kinds: self.runner.kinds(),
            threads: u32::try_from(self.threads.all()).unwrap_or(u32::MAX),
            memory_mib: self.config.memory_mib,
            labels: self.config.labels.clone(),
            machine: self.config.machine.clone(),
            max: shift.at_most(wanted as u32),
            ttl_secs: self.config.lease_secs,
            wait_secs: shift.wait_secs(self.config.claim_wait_secs),
        }
    }

    /// Gives tasks back that were not begun: they count no attempt.
    pub(super) fn give_back_untried(&self, leases: impl IntoIterator<Item = Lease>, shutdown: &ShutdownFlag) {
        // For all together: a worker that is to end waits once for a server that is away.
        let patience = LastWords::lasting(shutdown, Duration::from_secs(self.config.lease_secs.into()));
        for lease in leases {
            tracing::info!(kind = lease.task.kind, label = lease.task.label, "given back untried");
            let token = lease.token.clone();
            tell("release", &self.farm, &patience, move |farm| farm.release(&token));
            if let Some(seat) = &self.config.seat {
                seat.let_go(&lease.token);
            }
        }
    }

    /// Gives back all that no thread will begin, as one has ended.
    pub(super) fn give_back_spare(&self, shutdown: &ShutdownFlag) {
        let spare = std::mem::take(&mut *self.claiming.lock().unwrap_or_else(PoisonError::into_inner));
        self.give_back_untried(spare, shutdown);
    }
}
