//! The calls of a farm without HTTP: store, chunks and hints put together.

use std::sync::Arc;
use std::time::Duration;

use lightkiln_proto::api::{
    Bake, BakeState, Blame, ClaimAnswer, ClaimRequest, CommitVerdict, EventPage, HeartbeatAnswer, Lease,
    NewBake, ResultPage,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};
use lightkiln_proto::kinds::{BakeError, Kinds};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::counters::check_counters;
use crate::error::{Result, ServerError};
use crate::guard::Guard;
use crate::lookout::Lookout;
use crate::metrics::Metrics;
use crate::random::is_fencing_token;
use crate::storage::{Removed, Storage};
use crate::store::chunk::CollectRules;
use crate::store::rules::MAX_TASK_NAME_BYTES;
use crate::store::{FailVerdict, FarmStore, KnownResult, Reaped, StoreError, Submission};
use crate::wakeup::Wakeup;

/// Longest name of a bake, in characters.
pub const MAX_NAME_CHARS: usize = 200;
/// Longest Idempotency-Key and worker name, in characters.
pub const MAX_ID_CHARS: usize = 200;
/// Most labels of a worker or a bake.
pub const MAX_LABELS: usize = 16;
/// Longest label, in characters.
pub const MAX_LABEL_CHARS: usize = 64;
/// Seconds that one attempt may take.
pub const ATTEMPT_LIMIT_SECS: std::ops::RangeInclusive<u32> = 1..=604_800;
/// Most leases of one claim.
pub const MAX_LEASES: u32 = 64;
/// Most task kinds that one claim names.
pub const MAX_KINDS: usize = 64;
/// Longest kind of a task, in bytes.
pub const MAX_KIND_BYTES: usize = MAX_TASK_NAME_BYTES;
/// Lease lengths in seconds.
pub const TTL_SECS: std::ops::RangeInclusive<u32> = 5..=3600;
/// A claim that waits says by claiming again that its worker is still there.
const CLAIM_AGAIN_AFTER: Duration = Duration::from_secs(5);
/// Longest wait of a long poll, in seconds.
pub const MAX_WAIT_SECS: u32 = 60;

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
    /// Looks for work for claims that wait.
    lookout: Lookout,
    /// Held while a scene is put together.
    pub(crate) scene_parts: tokio::sync::Mutex<()>,
    /// A waiting call looks again this often, hint or not.
    pub poll_interval: Duration,
    /// Turns true when the server is to stop: waiting calls then answer at once.
    pub closing: watch::Receiver<bool>,
}

impl Farm {
    /// Puts the parts together; all counts start at 0.
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
        let lookout = Lookout::default();
        Self { kinds, guard, store, storage, wakeup, metrics, lookout, scene_parts, poll_interval, closing }
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
        let (mut mark, mut claimed) = (self.wakeup.mark(), Instant::now());
        let mut leases = self.store.claim(&request).await?;
        while leases.is_empty() && self.wait(mark, deadline).await {
            mark = self.wakeup.mark();
            if claimed.elapsed() >= CLAIM_AGAIN_AFTER
                || self.is_any_ready(&request.kinds, mark, deadline).await?
            {
                claimed = Instant::now();
                leases = self.store.claim(&request).await?;
            }
        }
        self.metrics.claims.inc_by(leases.len() as u64);
        if let Err(error) = self.fill_all_lengths(&mut leases).await {
            self.take_back(&leases).await;
            return Err(error);
        }
        Ok(ClaimAnswer { leases })
    }

    /// Whether anything of these kinds is ready; no if that is not known by the deadline or the end.
    async fn is_any_ready(&self, kinds: &[String], mark: u64, deadline: Instant) -> Result<bool, StoreError> {
        let mut closing = self.closing.clone();
        tokio::select! {
            seen = self.lookout.is_any_ready(&*self.store, kinds, mark) => seen,
            () = tokio::time::sleep_until(deadline) => Ok(false),
            _ = closing.wait_for(|closing| *closing) => Ok(false),
        }
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

    /// Waits for a hint, the poll interval, the deadline or the end; false when there is no more to wait for.
    pub async fn wait(&self, mark: u64, deadline: Instant) -> bool {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() || *self.closing.borrow() {
            return false;
        }
        let mut closing = self.closing.clone();
        tokio::select! {
            () = self.wakeup.wait(mark, left.min(self.poll_interval)) => true,
            // A closed channel means the same as its value.
            _ = closing.wait_for(|closing| *closing) => false,
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
        Ok(verdict)
    }

    async fn require_outputs(&self, result: &TaskResult) -> Result<()> {
        let there =
            self.storage.lengths(&result.outputs.iter().map(|output| output.digest).collect()).await?;
        for output in &result.outputs {
            let (name, digest, bytes) = (&output.name, output.digest, output.bytes);
            match there.get(&digest) {
                Some(length) if *length == bytes => (),
                Some(length) => {
                    let what = format!("output '{name}' says {bytes} bytes, chunk {digest} has {length}");
                    return Err(ServerError::bad_request(what));
                }
                None => return Err(ServerError::NoSuchOutput { name: name.clone(), digest }),
            }
        }
        Ok(())
    }

    /// Ends an attempt without a result.
    pub async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<()> {
        require_token(token)?;
        let verdict = self.store.fail(token, blame, message).await?;
        tracing::warn!(reason = message, "{}", failure_words(blame, verdict));
        if blame != Blame::Lost {
            self.metrics.failures.inc();
        } else if verdict != FailVerdict::Stale {
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
            if !page.events.is_empty() || page.bake.state.is_final() || !self.wait(mark, deadline).await {
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
        let mut after = after;
        loop {
            let mark = self.wakeup.mark();
            let page = self.store.results_after(bake, kind, after, limit).await?;
            after = page.next_after;
            if !page.results.is_empty() || page.bake.state.is_final() || !self.wait(mark, deadline).await {
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
        (FailVerdict::Stale, _) => "an attempt at a task failed after its lease was gone; nothing changes",
    }
}

fn check_needs(bake: &NewBake) -> Result<()> {
    check_labels("needs.labels", &bake.needs.labels)?;
    match bake.attempt_limit_secs {
        Some(secs) if !ATTEMPT_LIMIT_SECS.contains(&secs) => Err(ServerError::bad_request(format!(
            "attempt_limit_secs must be within {ATTEMPT_LIMIT_SECS:?}, not {secs}"
        ))),
        _ => Ok(()),
    }
}

fn check_labels(name: &str, labels: &[String]) -> Result<()> {
    if labels.len() > MAX_LABELS {
        return Err(ServerError::bad_request(format!(
            "{name} must be at most {MAX_LABELS}, not {}",
            labels.len()
        )));
    }
    labels.iter().try_for_each(|label| require_chars(name, label, 1, MAX_LABEL_CHARS))
}

fn check_claim(request: &ClaimRequest) -> Result<()> {
    require_chars("worker", &request.worker, 1, MAX_ID_CHARS)?;
    check_labels("labels", &request.labels)?;
    let limits = [
        ("max", (1..=MAX_LEASES).contains(&request.max), format!("1..={MAX_LEASES}")),
        ("ttl_secs", TTL_SECS.contains(&request.ttl_secs), format!("{TTL_SECS:?}")),
        ("wait_secs", request.wait_secs <= MAX_WAIT_SECS, format!("0..={MAX_WAIT_SECS}")),
        ("number of kinds", request.kinds.len() <= MAX_KINDS, format!("0..={MAX_KINDS}")),
    ];
    match limits.into_iter().find(|(_, is_within, _)| !is_within) {
        Some((name, _, range)) => Err(ServerError::bad_request(format!("{name} must be within {range}"))),
        None => Ok(()),
    }
}

fn require_chars(name: &str, text: &str, min: usize, max: usize) -> Result<()> {
    let count = text.chars().count();
    if (min..=max).contains(&count) {
        return Ok(());
    }
    Err(ServerError::bad_request(format!("{name} must have {min} to {max} characters, not {count}")))
}

fn require_token(token: &str) -> Result<()> {
    if is_fencing_token(token) { Ok(()) } else { Err(ServerError::NoSuchLease) }
}
