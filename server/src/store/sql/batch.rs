//! Commits that arrive while another one is being written share the next transaction: one lock and one flush for all.
//!
//! A caller that finds nobody writing writes for all who wait. When it goes away in the middle, its transaction never
//! happened or was not told of; the others notice and ask again, which is safe as each token commits once.

use std::sync::{Mutex, PoisonError};

use lightkiln_proto::api::CommitVerdict;
use lightkiln_proto::jobs::TaskResult;
use tokio::sync::oneshot::error::TryRecvError;
use tokio::sync::oneshot::{Receiver, Sender, channel};

use crate::store::{Result, StoreError};

/// Most commits of one transaction. More → fewer flushes, and longer waits of those who come next.
const COMMITS_MAX: usize = 64;

type Verdict = Result<CommitVerdict>;

/// A commit that waits for its transaction.
pub(super) struct Waiting {
    pub(super) token: String,
    pub(super) result: TaskResult,
    answer: Sender<Verdict>,
}

impl Waiting {
    /// Tells the caller, if it still waits.
    pub(super) fn answer(self, verdict: Verdict) {
        let _ = self.answer.send(verdict);
    }
}

/// The commits of one store.
#[derive(Default)]
pub(super) struct CommitQueue {
    waiting: Mutex<Vec<Waiting>>,
    writer: tokio::sync::Mutex<()>,
}

impl CommitQueue {
    fn push(&self, token: &str, result: &TaskResult) -> Receiver<Verdict> {
        let (answer, verdict) = channel();
        let (token, result) = (token.to_owned(), result.clone());
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.push(Waiting { token, result, answer });
        verdict
    }

    /// The oldest that wait.
    fn take(&self) -> Vec<Waiting> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let count = waiting.len().min(COMMITS_MAX);
        waiting.drain(..count).collect()
    }

    /// Commits one result, together with others if there are any; `write` writes a batch and answers each.
    pub(super) async fn commit<F>(
        &self,
        token: &str,
        result: &TaskResult,
        write: impl Fn(Vec<Waiting>) -> F + Send,
    ) -> Verdict
    where
        F: Future<Output = ()> + Send,
    {
        let mut verdict = self.push(token, result);
        loop {
            let _writing = self.writer.lock().await;
            match verdict.try_recv() {
                Ok(verdict) => return verdict,
                // Its writer went away before the answer.
                Err(TryRecvError::Closed) => verdict = self.push(token, result),
                Err(TryRecvError::Empty) => write(self.take()).await,
            }
        }
    }
}

/// An error that is no commit's own fault, made anew for each of them; any other error comes back.
pub(super) fn trouble_of_all(error: StoreError) -> Result<impl Fn() -> StoreError> {
    let (kind, source): (fn(_) -> StoreError, _) = match error {
        StoreError::Full(source) => (StoreError::Full, source),
        StoreError::Unavailable(source) => (StoreError::Unavailable, source),
        StoreError::Contended(source) => (StoreError::Contended, source),
        other => return Err(other),
    };
    let text = source.to_string();
    Ok(move || kind(text.clone().into()))
}
