//! Commits that share a transaction.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use async_trait::async_trait;
use lightkiln_proto::api::{CommitVerdict, Lease};
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_server::store::{FarmStore, FaultPoint, Faults, SqlStore, StoreError};

use crate::clock::ManualClock;
use crate::crash::{crashed, open_file};
use crate::support::{in_time, request, result, submission, task};

/// Incidents of one of the transactions.
#[derive(Clone, Copy, PartialEq)]
enum Fate {
    Commits,
    StopsForEver,
    Fails,
}

/// Counts the transactions of commits; the second one meets a fate.
struct Transactions {
    count: AtomicU32,
    second: Fate,
}

#[async_trait]
impl Faults for Transactions {
    async fn at(&self, point: FaultPoint) -> Result<(), StoreError> {
        let ends_a_commit = point.call == "commit" && point.before == "COMMIT";
        if ends_a_commit && self.count.fetch_add(1, Ordering::SeqCst) + 1 == 2 {
            match self.second {
                Fate::Commits => (),
                Fate::StopsForEver => std::future::pending().await,
                Fate::Fails => return Err(crashed()),
            }
        }
        Ok(())
    }
}

async fn leased(second: Fate) -> (tempfile::TempDir, SqlStore, Arc<Transactions>, Vec<Lease>) {
    let folder = tempfile::tempdir().unwrap();
    let transactions = Arc::new(Transactions { count: AtomicU32::new(0), second });
    let store =
        open_file(folder.path(), &Arc::new(ManualClock::at(0))).await.with_faults(transactions.clone());
    let tasks: Vec<TaskSpec> = (0..30).map(|i| task(&format!("{i}"), &[])).collect();
    store.submit(&submission("bake", &tasks)).await.unwrap();
    let leases = store.claim(&request("w", 30)).await.unwrap();
    assert_eq!(leases.len(), 30);
    (folder, store, transactions, leases)
}

#[tokio::test]
async fn commits_that_wait_share_a_transaction() {
    let (_folder, store, transactions, leases) = leased(Fate::Commits).await;
    let results: Vec<_> = leases.iter().map(|lease| (lease, result(lease, &[]))).collect();
    let commits = results.iter().map(|(lease, result)| store.commit(&lease.token, result));
    for verdict in in_time(futures::future::join_all(commits)).await {
        assert_eq!(verdict.unwrap(), CommitVerdict::Committed);
    }
    assert_eq!(transactions.count.load(Ordering::SeqCst), 2, "the first, and all that came meanwhile");
}

#[tokio::test]
async fn caller_that_leaves_while_it_writes_for_others_takes_none_with_it() {
    let (_folder, store, transactions, leases) = leased(Fate::StopsForEver).await;
    let results: Vec<_> = leases.iter().map(|lease| (lease, result(lease, &[]))).collect();
    let mut commits: Vec<_> =
        results.iter().map(|(lease, result)| store.commit(&lease.token, result)).collect();
    let mut first_is_done = false;
    // The first writes for itself alone. Then the second writes for all others, and never comes back.
    while transactions.count.load(Ordering::SeqCst) < 2 {
        for (number, commit) in commits.iter_mut().enumerate() {
            if transactions.count.load(Ordering::SeqCst) < 2 && (number > 0 || !first_is_done) {
                match futures::poll!(commit) {
                    std::task::Poll::Ready(verdict) => {
                        assert_eq!((number, verdict.unwrap()), (0, CommitVerdict::Committed));
                        first_is_done = true;
                    }
                    std::task::Poll::Pending => (),
                }
            }
        }
        tokio::task::yield_now().await;
    }
    drop(commits.drain(..2));
    for verdict in in_time(futures::future::join_all(commits)).await {
        assert_eq!(verdict.unwrap(), CommitVerdict::Committed);
    }
    assert_eq!(store.stats().await.unwrap().tasks_run, 29);
}

#[tokio::test]
async fn commits_that_fail_together_are_all_told_and_may_ask_again() {
    let (_folder, store, transactions, leases) = leased(Fate::Fails).await;
    let results: Vec<_> = leases.iter().map(|lease| (lease, result(lease, &[]))).collect();
    let commit_all = || {
        let commits = results.iter().map(|(lease, result)| store.commit(&lease.token, result));
        in_time(futures::future::join_all(commits))
    };
    let mut verdicts = commit_all().await.into_iter();
    assert_eq!(verdicts.next().unwrap().unwrap(), CommitVerdict::Committed);
    for verdict in verdicts {
        assert!(matches!(verdict, Err(StoreError::Unavailable(_))), "{verdict:?}");
    }
    assert_eq!(transactions.count.load(Ordering::SeqCst), 2, "none was tried by itself");
    let mut verdicts = commit_all().await.into_iter();
    assert_eq!(verdicts.next().unwrap().unwrap(), CommitVerdict::AlreadyCommitted);
    for verdict in verdicts {
        assert_eq!(verdict.unwrap(), CommitVerdict::Committed);
    }
}
