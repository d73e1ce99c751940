//! Claims the next task without keeping a shutdown waiting for the server's long poll.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use lightkiln_http::{CallError, Level, ShutdownFlag};
use lightkiln_proto::api::{ClaimRequest, Lease};

use super::farm::Farm;

/// Longer than any claim takes; a claim ends by its own timeout first.
const PATIENCE: Duration = Duration::from_secs(600);

/// Time for which a worker that is to stop still waits for an answer that may be on its way.
const LAST_LOOK: Duration = Duration::from_millis(100);

/// State of a claim under way.
#[derive(Debug)]
enum Handoff {
    /// The worker waits for it.
    Waiting,
    /// The server answered.
    Answered(Box<Result<Vec<Lease>, CallError>>),
    /// The worker has gone: a task that comes now is given straight back.
    Abandoned,
}

/// Asks for tasks. None when there are none yet or the worker is to stop.
pub(super) fn claim(
    farm: &Arc<Farm>,
    request: ClaimRequest,
    shutdown: &ShutdownFlag,
) -> Result<Vec<Lease>, CallError> {
    let handoff = Arc::new(Mutex::new(Handoff::Waiting));
    let asker = (farm.clone(), handoff.clone(), shutdown.clone());
    std::thread::spawn(move || {
        let (farm, handoff, shutdown) = asker;
        let answer = farm.claim(&request).map(|answer| answer.leases);
        hand_over(&farm, &handoff, answer);
        shutdown.wake();
    });
    let is_answered = || !matches!(*lock(&handoff), Handoff::Waiting);
    if shutdown.wait(PATIENCE, |level| level > Level::Run || is_answered()) > Level::Run {
        shutdown.wait(LAST_LOOK, |_| is_answered());
    }
    let answer = match std::mem::replace(&mut *lock(&handoff), Handoff::Abandoned) {
        Handoff::Answered(answer) => (*answer)?,
        Handoff::Waiting | Handoff::Abandoned => Vec::new(),
    };
    if shutdown.level() > Level::Run {
        give_back(farm, answer);
        return Ok(Vec::new());
    }
    Ok(answer)
}

fn hand_over(farm: &Farm, handoff: &Mutex<Handoff>, answer: Result<Vec<Lease>, CallError>) {
    let mut state = lock(handoff);
    if matches!(*state, Handoff::Waiting) {
        *state = Handoff::Answered(Box::new(answer));
        return;
    }
    drop(state);
    give_back(farm, answer.unwrap_or_default());
}

/// Gives tasks back that nobody will begin.
pub(super) fn give_back(farm: &Farm, leases: impl IntoIterator<Item = Lease>) {
    for lease in leases {
        if let Err(error) = farm.release(&lease.token) {
            tracing::warn!(%error, "a task could not be given back; its lease will run out instead");
        }
    }
}

fn lock(handoff: &Mutex<Handoff>) -> MutexGuard<'_, Handoff> {
    handoff.lock().unwrap_or_else(PoisonError::into_inner)
}
