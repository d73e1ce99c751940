//! The calls of a farm without HTTP: store, chunks and hints put together.

use std::sync::Arc;
use std::time::Duration;

use lightkiln_proto::api::{
    Bake, BakeState, Blame, ClaimAnswer, ClaimRequest, CommitVerdict, EventPage, HeartbeatAnswer, Lease,
    MAX_COMMITS, NewBake, ResultPage,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_proto::kinds::{BakeError, Kinds};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::error::{Result, ServerError};
use crate::guard::Guard;
use crate::lookout::{Lookout, News};
use crate::metrics::Metrics;
use crate::request_checks::{check_claim, check_needs, check_share, require_chars, require_token};
use crate::result_checks::{check_counters, require_lengths};
use crate::storage::{Removed, Storage};
use crate::store::chunk::CollectRules;
use crate::store::{FailVerdict, FarmStore, KnownResult, Reaped, StoreError, Submission};
use crate::wakeup::Wakeup;

pub use crate::request_checks::{
    ATTEMPT_LIMIT_SECS, MAX_ID_CHARS, MAX_KIND_BYTES, MAX_KINDS, MAX_LABEL_CHARS, MAX_LABELS, MAX_LEASES,
    MAX_NAME_CHARS, MAX_WAIT_SECS, TTL_SECS,
};

/// The parts of a farm.
pub struct Farm {
    /// The queue.
    pub store: Arc<dyn FarmStore>,
    /// The bytes.
    pub storage: Storage,
    /// Hints between calls.
    pub wakeup: Arc<dyn Wakeup>,
    /// Kinds of bake that are taken in.
    kinds: Kinds,
    /// Checks of tokens.
    pub guard: Guard,
    /// Counts since start.
    pub(crate) metrics: Metrics,
    /// Looks for work and news for calls that wait.
    lookout: Lookout,
    /// Held while a scene is put together.
    pub(crate) scene_parts: tokio::sync::Mutex<()>,
    /// Turns true when the server is to stop: waiting calls then answer at once.
    pub closing: watch::Receiver<bool>,
}

impl Farm {
    /// Puts the parts together; all counts start at 0. For calls that wait the store is looked at every `poll_interval`, hint
    /// or not.
    pub fn new(
        store: Arc<dyn FarmStore>,
        storage: Storage,
        wakeup: Arc<dyn Wakeup>,
        kinds: Kinds,
        poll_interval: Duration,
        closing: watch::Receiver<bool>,
    ) -> Self {
        let guard = Guard::new(store.clone());
        let metrics = Metrics::new(storage.lost().clone());
        let scene_parts = tokio::sync::Mutex::default();
        let lookout = Lookout::new(store.clone(), wakeup.clone(), poll_interval);
        Self { kinds, guard, store, storage, wakeup, metrics, lookout, scene_parts, closing }
    }

    /// Takes a bake in. The scene must be there, and results to be reused must still have their bytes.
    /// `traceparent` names the trace that the submission belongs to, `owner` the bearer that submits.
    pub async fn submit(
        &self,
        mut bake: NewBake,
        idempotency_key: Option<String>,
        traceparent: Option<String>,
        owner: Option<String>,
    ) -> Result<Bake> {
        require_chars("name", &bake.name, 0, MAX_NAME_CHARS)?;
        if let Some(key) = &idempotency_key {
            require_chars("Idempotency-Key", key, 1, MAX_ID_CHARS)?;
        }
        check_needs(&bake)?;
        check_share(bake.verify_share)?;
        let kind = self.kinds.named(&bake.kind)?;
        kind.name().clone_into(&mut bake.kind);
        let plan = kind.first_tasks(bake.scene, &bake.settings).map_err(BakeError::from)?;
        let scene = bake.scene;
        if self.storage.length(scene).await?.is_none() {
            return Err(ServerError::NoSuchScene { scene });
        }
        self.forget_lost_results(&plan).await?;
        let body = serde_json::to_vec(&bake).map_err(|error| ServerError::bad_request(error.to_string()))?;
        let body_hash = Digest::of(&body);
        let submission = Submission { idempotency_key, body_hash, traceparent, owner, bake, plan };
        let submitted = self.store.submit(&submission).await.map_err(|error| match error {
            // It went between the look and the submission.
            StoreError::MissingChunk { digest } if digest == scene => ServerError::NoSuchScene { scene },
            error => error.into(),
        })?;
        if submitted.is_new {
            self.metrics.submissions.inc();
            self.wakeup.hint();
        }
        Ok(submitted.bake)
    }

    /// Forgets results that `plan` would reuse but whose bytes are gone, so that their tasks run again. So do those that
    /// planned tasks for bytes that are gone: they plan them anew once the makers of these bytes have run.
    async fn forget_lost_results(&self, plan: &[TaskSpec]) -> Result<()> {
        if plan.is_empty() {
            return Ok(());
        }
        // A forgotten result may have planned tasks, or been planned by one, whose results were whole a moment ago.
        loop {
            let keys = self.lost_results(plan).await?;
            if keys.is_empty() {
                return Ok(());
            }
            tracing::warn!(results = keys.len(), "results lost their bytes; their tasks will run again");
            self.metrics.forgotten_results.inc_by(keys.len() as u64);
            self.store.forget(&keys).await?;
        }
    }

    async fn lost_results(&self, plan: &[TaskSpec]) -> Result<Vec<TaskKey>> {
        let known = self.store.reusable(plan).await?;
        let outputs = known.iter().flat_map(|result| &result.outputs).map(|output| output.digest);
        let named = known.iter().flat_map(|result| &result.named).copied();
        let there = self.storage.lengths(&outputs.chain(named).collect()).await?;
        let has_lost = |result: &&KnownResult| {
            result.outputs.iter().any(|output| there.get(&output.digest) != Some(&output.bytes))
                || result.named.iter().any(|named| !there.contains_key(named))
        };
        Ok(known.iter().filter(has_lost).map(|result| result.key).collect())
    }

    /// Hands out tasks, waiting for some if asked to.
    pub async fn claim(&self, request: ClaimRequest) -> Result<ClaimAnswer> {
        check_claim(&request)?;
        let deadline = Instant::now() + Duration::from_secs(request.wait_secs.into());
        let mut leases = loop {
            let mark = self.wakeup.mark();
            let leases = self.store.claim(&request).await?;
            if !leases.is_empty() || self.wait(self.lookout.work(&request, mark), deadline).await.is_none() {
                break leases;
            }
        };
        self.metrics.claims.inc_by(leases.len() as u64);
        if let Err(error) = self.fill_all_lengths(&mut leases).await {
            self.take_back(&leases).await;
            return Err(error);
        }
        Ok(ClaimAnswer { leases })
    }

    /// Ends leases that nobody will hear of. Those that cannot be ended run out; no attempt is counted for them.
    async fn take_back(&self, leases: &[Lease]) {
        for lease in leases {
            if let Err(error) = self.store.release(&lease.token).await {
                tracing::warn!(%error, label = lease.task.label, "a task handed to nobody waits for its lease to run out");
            }
        }
        self.wakeup.hint();
    }

    async fn fill_all_lengths(&self, leases: &mut [Lease]) -> Result<()> {
        for lease in leases {
            self.fill_lengths(&lease.task, &mut lease.inputs).await?;
        }
        Ok(())
    }

    /// The store does not know how long plain artefacts are.
    async fn fill_lengths(
        &self,
        task: &TaskSpec,
        inputs: &mut [lightkiln_proto::jobs::Artefact],
    ) -> Result<()> {
        if !task.inputs.iter().any(|input| matches!(input, TaskInput::Artefact { .. })) {
            return Ok(());
        }
        let unknown: Vec<Digest> =
            inputs.iter().filter(|input| input.bytes == 0).map(|input| input.digest).collect();
        let known = self.store.find_chunks(&unknown).await?;
        for input in inputs.iter_mut().filter(|input| input.bytes == 0) {
            let known = known.iter().find(|chunk| chunk.name.digest == input.digest);
            input.bytes = match known {
                Some(chunk) => chunk.bytes,
                None => self.storage.length(input.digest).await?.unwrap_or(0),
            };
        }
        Ok(())
    }

    /// Waits for something; nothing at the deadline or the server's end.
    async fn wait<T>(&self, something: impl Future<Output = T>, deadline: Instant) -> Option<T> {
        if deadline <= Instant::now() || *self.closing.borrow() {
            return None;
        }
        let mut closing = self.closing.clone();
        tokio::select! {
            something = something => Some(something),
            () = tokio::time::sleep_until(deadline) => None,
            // A closed channel means the same as its value.
            _ = closing.wait_for(|closing| *closing) => None,
        }
    }

    /// Prolongs a lease.
    pub async fn heartbeat(&self, token: &str, progress: f32) -> Result<HeartbeatAnswer> {
        require_token(token)?;
        if !(0.0..=1.0).contains(&progress) {
            return Err(ServerError::bad_request(format!("progress must be within 0..=1, not {progress}")));
        }
        Ok(self.store.heartbeat(token, progress).await?)
    }

    /// Takes a result in. Its outputs must have been uploaded.
    pub async fn commit(&self, token: &str, result: TaskResult) -> Result<CommitVerdict> {
        require_token(token)?;
        check_counters(&result)?;
        self.require_outputs(&result).await?;
        self.forget_lost_results(&result.plan).await?;
        let verdict = self.store.commit(token, &result).await?;
        self.note(verdict);
        Ok(verdict)
    }

    /// Takes several results in, each by itself; those without plans share a transaction.
    pub async fn commit_all(&self, commits: Vec<(String, TaskResult)>) -> Result<Vec<Result<CommitVerdict>>> {
        if commits.len() > MAX_COMMITS {
            let what = format!("at most {MAX_COMMITS} results are handed in at once, not {}", commits.len());
            return Err(ServerError::bad_request(what));
        }
        // One look for the outputs of all.
        let outputs = commits.iter().flat_map(|(_, result)| &result.outputs).map(|output| output.digest);
        let there = self.storage.lengths(&outputs.collect()).await?;
        let mut outcomes = Vec::with_capacity(commits.len());
        for (token, result) in &commits {
            let checked = require_token(token)
                .and_then(|()| check_counters(result))
                .and_then(|()| require_lengths(result, &there));
            outcomes.push(match checked {
                Ok(()) => self.forget_lost_results(&result.plan).await,
                Err(error) => Err(error),
            });
        }
        let good = commits.iter().zip(&outcomes).filter(|(_, outcome)| outcome.is_ok());
        let good: Vec<(&str, &TaskResult)> =
            good.map(|((token, result), _)| (token.as_str(), result)).collect();
        let mut verdicts = self.store.commit_all(&good).await.into_iter();
        let answered = outcomes.into_iter().map(|outcome| {
            outcome?;
            Ok(verdicts.next().unwrap_or(Ok(CommitVerdict::Stale))?)
        });
        let answered: Vec<Result<CommitVerdict>> = answered.collect();
        answered.iter().flatten().for_each(|verdict| self.note(*verdict));
        Ok(answered)
    }

    /// Counts what became of a result, and tells those who wait.
    fn note(&self, verdict: CommitVerdict) {
        match verdict {
            CommitVerdict::Committed => {
                self.metrics.commits.inc();
                self.wakeup.hint();
            }
            CommitVerdict::AlreadyCommitted => (),
            CommitVerdict::Stale => {
                self.metrics.stale_commits.inc();
                tracing::warn!("a result came after its lease was gone and was refused");
            }
        }
    }

    async fn require_outputs(&self, result: &TaskResult) -> Result<()> {
        let outputs = result.outputs.iter().map(|output| output.digest);
        require_lengths(result, &self.storage.lengths(&outputs.collect()).await?)
    }

    /// Ends an attempt without a result.
    pub async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<()> {
        require_token(token)?;
        let verdict = self.store.fail(token, blame, message).await?;
        tracing::warn!(reason = message, "{}", failure_words(blame, verdict));
        if blame != Blame::Lost {
            self.metrics.failures.inc();
        } else if matches!(verdict, FailVerdict::Retry | FailVerdict::GivenUp) {
            self.metrics.lost_workers.inc();
        }
        self.wakeup.hint();
        Ok(())
    }

    /// Gives a task back.
    pub async fn release(&self, token: &str) -> Result<()> {
        require_token(token)?;
        if self.store.release(token).await? {
            self.metrics.releases.inc();
            self.wakeup.hint();
        }
        Ok(())
    }

    /// Gives leases their whole length again: nobody could be heard for a while.
    pub async fn extend_leases(&self) -> Result<()> {
        let extended = self.store.extend_leases().await?;
        if extended > 0 {
            tracing::info!(extended, "leases run on, as their holders could not be heard for a while");
        }
        Ok(())
    }

    /// Ends leases that have run out.
    pub async fn reap(&self) -> Result<()> {
        let reaped = self.store.reap().await?;
        if reaped.expired > 0 {
            let Reaped { expired, lost, given_up } = reaped;
            tracing::warn!(expired, lost, given_up, "leases ran out");
            self.metrics.expiries.inc_by(expired);
            self.metrics.lost_workers.inc_by(lost);
            self.wakeup.hint();
        }
        Ok(())
    }

    /// Calls that this process refused as the disk or the quota was full.
    pub fn full_refusals(&self) -> u64 {
        self.metrics.full_refusals.get()
    }

    /// Deletes old bakes, and the bytes that nobody needs any more.
    pub async fn collect(&self, rules: &CollectRules) -> Result<Removed> {
        let removed = self.storage.collect(rules).await?;
        if removed.bakes > 0 || removed.chunks > 0 {
            tracing::info!(bakes = removed.bakes, chunks = removed.chunks, "cleared away");
            self.metrics.deleted_bakes.inc_by(removed.bakes);
            self.metrics.removed_chunks.inc_by(removed.chunks);
        }
        Ok(removed)
    }

    /// Changes a bake through one of the store's calls.
    pub async fn change<T>(
        &self,
        change: impl Future<Output = Result<T, crate::store::StoreError>>,
    ) -> Result<T> {
        let changed = change.await?;
        self.wakeup.hint();
        Ok(changed)
    }

    /// Events after `after`, waiting for one if there is none and the bake goes on.
    pub async fn events(&self, bake: &str, after: u64, limit: u32, deadline: Instant) -> Result<EventPage> {
        loop {
            let mark = self.wakeup.mark();
            let page = self.store.events_after(bake, after, limit).await?;
            if !page.events.is_empty() || page.bake.state.is_final() {
                return Ok(page);
            }
            let news = self.lookout.news(bake, News::Event(after), mark);
            if self.wait(news, deadline).await.is_none() {
                return Ok(page);
            }
        }
    }

    /// Results behind place `after`, waiting for one if there is none and the bake goes on.
    pub async fn results(
        &self,
        bake: &str,
        kind: Option<&str>,
        after: u64,
        limit: u32,
        deadline: Instant,
    ) -> Result<ResultPage> {
        // Results of other kinds are passed by and by.
        let mut after = after;
        loop {
            let mark = self.wakeup.mark();
            let page = self.store.results_after(bake, kind, after, limit).await?;
            after = page.next_after;
            if !page.results.is_empty() || page.bake.state.is_final() {
                return Ok(page);
            }
            let news = self.lookout.news(bake, News::Result(after), mark);
            if self.wait(news, deadline).await.is_none() {
                return Ok(page);
            }
        }
    }

    /// Digest of a result of a finished bake.
    pub async fn result_of(
        &self,
        bake: &str,
        what: &'static str,
        pick: impl Fn(&Bake) -> Option<Digest>,
    ) -> Result<Digest> {
        let shown = self.store.show(bake).await?;
        pick(&shown).ok_or_else(|| {
            let why = match shown.state {
                BakeState::Running | BakeState::Paused => "it is not done yet",
                BakeState::Done => "its tasks gave none",
                BakeState::Failed => "it failed",
                BakeState::Cancelled => "it was cancelled",
            };
            ServerError::NoResult { bake: bake.to_owned(), what, why: why.to_owned() }
        })
    }
}

/// An attempt that ended without a result, in words for the log.
fn failure_words(blame: Blame, verdict: FailVerdict) -> &'static str {
    match (verdict, blame) {
        (FailVerdict::GivenUp, Blame::Task) => {
            "a task cannot be done from what its bake was given; the bake has failed"
        }
        (FailVerdict::GivenUp, Blame::Worker) => {
            "a task failed too often; the bakes that want it have failed"
        }
        (FailVerdict::GivenUp, Blame::Lost) => {
            "workers were lost with a task too often; the bakes that want it have failed"
        }
        (FailVerdict::Retry, Blame::Lost) => "a worker was lost with a task; it will be tried again",
        (FailVerdict::Retry, _) => "an attempt at a task failed; it will be tried again",
        (FailVerdict::Rerun, _) => "a result could not be made once more to be verified; it stays as it is",
        (FailVerdict::Stale, _) => "an attempt at a task failed after its lease was gone; nothing changes",
    }
}
