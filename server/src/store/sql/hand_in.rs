//! Ways of a result into the farm: together with others, in line for a bake that is locked for long, or by a change of the farm.

use std::collections::BTreeMap;

use lightkiln_proto::api::CommitVerdict;
use lightkiln_proto::jobs::TaskResult;

use super::batch::{Fate, Given, Verdict, Waiting};
use super::patience::{Locked, is_long_wait};
use super::{Kind, SqlStore, commit, may_try_again, outcome, plan, transact};
use crate::store::{PlanError, Result, StoreError};

impl SqlStore {
    /// Commits results without plans: those that can be in one transaction with others, the rest by themselves.
    pub(super) async fn commit_together(&self, commits: &[Given<'_>]) -> Vec<Verdict> {
        let mut fates = self.commits.commit(commits, |batch| self.commit_batch(batch)).await;
        // Wait for bakes that are locked, each in its own line.
        let mut locked: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
        for (index, fate) in fates.iter().enumerate() {
            if let Fate::Locked(bake) = fate {
                locked.entry(*bake).or_default().push(index);
            }
        }
        let waits = locked.into_iter().map(|(bake, indices)| async move {
            let of_bake: Vec<Given<'_>> = indices.iter().map(|index| commits[*index]).collect();
            let line = self.patience.line(bake);
            (indices, line.commit(&of_bake, |batch| self.commit_patiently(batch)).await)
        });
        for (indices, told) in futures::future::join_all(waits).await {
            for (index, fate) in indices.into_iter().zip(told) {
                fates[index] = fate;
            }
        }
        let alone = fates.iter().zip(commits).filter(|(fate, _)| !matches!(fate, Fate::Verdict(_)));
        let alone: Vec<Given<'_>> = alone.map(|(_, commit)| *commit).collect();
        let mut verdicts = self.commit_each_alone(&alone).await.into_iter();
        let told = |fate| match fate {
            Fate::Verdict(verdict) => verdict,
            Fate::Locked(_) | Fate::Alone => verdicts.next().unwrap_or(Ok(CommitVerdict::Stale)),
        };
        fates.into_iter().map(told).collect()
    }

    /// Commits a batch, but those whose bakes are locked for long.
    async fn commit_batch(&self, batch: Vec<Waiting>) {
        if !self.patience.is_wary() {
            let committed: Result<_> = transact!(self, CommitBriefly, "commit", |conn| {
                commit::commit_all(conn, &batch, Locked::AreWaitedFor)
            });
            match committed {
                Err(error) if is_long_wait(&error) => self.patience.note_long_wait(),
                committed => return answer(batch, committed),
            }
        }
        let committed: Result<_> =
            transact!(self, Commit, "commit", |conn| commit::commit_all(conn, &batch, Locked::AreLeft));
        answer(batch, committed);
    }

    /// Commits a batch for whose bakes it waits.
    async fn commit_patiently(&self, batch: Vec<Waiting>) {
        let _place = self.patience.commit().await;
        let committed: Result<_> =
            transact!(self, Commit, "commit", |conn| commit::commit_all(conn, &batch, Locked::AreWaitedFor));
        answer(batch, committed);
    }

    /// Commits results without plans by a change of the farm: all at once, or each by itself if one of them fails.
    async fn commit_each_alone(&self, commits: &[Given<'_>]) -> Vec<Verdict> {
        if commits.len() > 1 {
            let verdicts: Result<_> =
                transact!(self, Write, "commit", |conn| outcome::commit_each(conn, commits));
            if let Ok(verdicts) = verdicts {
                return verdicts.into_iter().map(Ok).collect();
            }
        }
        let mut verdicts = Vec::with_capacity(commits.len());
        for (token, result) in commits {
            verdicts.push(self.commit_alone(token, result, &Ok(())).await);
        }
        verdicts
    }

    /// Commits a result alone on the farm; `plan` says whether its plan is one.
    async fn commit_alone(&self, token: &str, result: &TaskResult, plan: &Result<(), PlanError>) -> Verdict {
        transact!(self, Write, "commit", |conn| outcome::commit(conn, token, result, plan))
    }

    /// Commits a result with a plan, beside others if all its tasks are new.
    pub(super) async fn commit_planned(&self, token: &str, result: &TaskResult) -> Verdict {
        let plan = plan::check(&result.plan).await;
        let place = self.patience.commit().await;
        let verdict: Result<_> =
            transact!(self, Commit, "commit", |conn| commit::commit_planned(conn, token, result, &plan));
        drop(place);
        match verdict? {
            Some(verdict) => Ok(verdict),
            None => self.commit_alone(token, result, &plan).await,
        }
    }
}

/// Answers a batch, whether its transaction happened or failed.
fn answer(batch: Vec<Waiting>, committed: Result<Vec<Fate>>) {
    let error = match committed {
        Ok(fates) => return batch.into_iter().zip(fates).for_each(|(waiting, fate)| waiting.answer(fate)),
        Err(error) => error,
    };
    match trouble_of_all(error) {
        // Each by itself would wait as long, and fail as well.
        Ok(trouble) => {
            batch.into_iter().for_each(|waiting| waiting.answer(Fate::Verdict(Err(trouble()))));
        }
        Err(error) => {
            tracing::debug!(%error, commits = batch.len(), "commits are tried one by one");
            batch.into_iter().for_each(|waiting| waiting.answer(Fate::Alone));
        }
    }
}

/// An error that is no commit's own fault, made anew for each of them; any other error comes back.
fn trouble_of_all(error: StoreError) -> Result<impl Fn() -> StoreError> {
    let (kind, source): (fn(_) -> StoreError, _) = match error {
        StoreError::Full(source) => (StoreError::Full, source),
        StoreError::Unavailable(source) => (StoreError::Unavailable, source),
        StoreError::Contended(source) => (StoreError::Contended, source),
        other => return Err(other),
    };
    let text = source.to_string();
    Ok(move || kind(text.clone().into()))
}
