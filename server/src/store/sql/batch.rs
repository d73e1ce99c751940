//! Commits that arrive while another one is being written share the next transaction: one lock and one flush for all.
//!
//! A caller that finds nobody writing writes for all who wait. When it goes away in the middle, its transaction never
//! happened or was not told of; the others notice and ask again, which is safe as each token commits once. Commits that need more than
//! the others come back to their callers: none waits in line for a bake that is locked for long, or for the whole farm.

use std::sync::{Mutex, PoisonError};

use lightkiln_proto::api::CommitVerdict;
use lightkiln_proto::jobs::TaskResult;
use tokio::sync::oneshot::error::TryRecvError;
use tokio::sync::oneshot::{Receiver, Sender, channel};

use crate::store::Result;

/// Most commits of one transaction. More → fewer flushes, and longer waits of those who come next.
const COMMITS_MAX: usize = 64;

pub(super) type Verdict = Result<CommitVerdict>;

/// A commit.
pub(super) type Given<'a> = (&'a str, &'a TaskResult);

/// Fate of a commit in a batch.
pub(super) enum Fate {
    Verdict(Verdict),
    /// Nothing yet: somebody has locked a bake that holds its task.
    Locked(i64),
    /// Nothing yet: it takes a change of the farm, or must be tried by itself.
    Alone,
}

/// A commit that waits for its transaction.
pub(super) struct Waiting {
    pub(super) token: String,
    pub(super) result: TaskResult,
    answer: Sender<Fate>,
}

impl Waiting {
    /// Tells the caller, if it still waits.
    pub(super) fn answer(self, fate: Fate) {
        let _ = self.answer.send(fate);
    }
}

/// The commits of one store, or those of one bake that is locked.
#[derive(Default)]
pub(super) struct CommitQueue {
    waiting: Mutex<Vec<Waiting>>,
    writer: tokio::sync::Mutex<()>,
}

impl CommitQueue {
    fn push(&self, commits: &[Given<'_>]) -> Vec<Receiver<Fate>> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let mut fates = Vec::with_capacity(commits.len());
        for (token, result) in commits {
            let (answer, fate) = channel();
            waiting.push(Waiting { token: (*token).to_owned(), result: (*result).clone(), answer });
            fates.push(fate);
        }
        fates
    }

    /// The oldest that wait.
    fn take(&self) -> Vec<Waiting> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let count = waiting.len().min(COMMITS_MAX);
        waiting.drain(..count).collect()
    }

    /// Commits results, together with others if there are any; `write` writes a batch and answers each.
    pub(super) async fn commit<F>(
        &self,
        commits: &[Given<'_>],
        write: impl Fn(Vec<Waiting>) -> F + Send,
    ) -> Vec<Fate>
    where
        F: Future<Output = ()> + Send,
    {
        let mut fates = Vec::with_capacity(commits.len());
        let mut waiting = self.push(commits);
        while fates.len() < commits.len() {
            let _writing = self.writer.lock().await;
            let next = fates.len();
            match waiting[next].try_recv() {
                Ok(fate) => fates.push(fate),
                // Its writer went away before the answer.
                Err(TryRecvError::Closed) => {
                    waiting.splice(next..=next, self.push(&commits[next..=next]));
                }
                Err(TryRecvError::Empty) => write(self.take()).await,
            }
        }
        fates
    }
}
