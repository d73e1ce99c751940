//! The plain model of a farm: maps in memory, everything recounted when asked for.
//!
//! It says how the stores in databases must behave, in the fewest words. It keeps nothing when the process ends.

mod alarms;
mod chunks;
mod ends;
mod entries;
mod farm;
mod leases;
mod reruns;
mod view;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use async_trait::async_trait;
use lightkiln_proto::api::{
    Bake, BakeFilter, BakePage, BakeState, Blame, Blocklist, ClaimRequest, CommitVerdict, EventPage,
    HeartbeatAnswer, Lease, ResultPage, Worker,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use farm::Farm;
use lightkiln_server::access::{Bearer, Scope};
use lightkiln_server::chunks::ChunkName;
use lightkiln_server::clock::Clock;
use lightkiln_server::store::chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
use lightkiln_server::store::{
    FailVerdict, FarmRules, FarmStore, KnownResult, Look, Named, Reaped, Stats, StoreError, Submission,
    Submitted, require_live, same_bearer,
};

/// A farm in memory.
pub struct MemoryStore {
    farm: Mutex<Farm>,
    clock: Arc<dyn Clock>,
    rules: FarmRules,
}

impl MemoryStore {
    /// An empty farm.
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        Self { farm: Mutex::default(), clock, rules: FarmRules::default() }
    }

    fn farm(&self) -> MutexGuard<'_, Farm> {
        // A panic while the lock was held is a bug that a test shows; the maps themselves stay readable.
        self.farm.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now_ms(&self) -> i64 {
        self.clock.now_ms()
    }

    /// Changes the farm, and notes tasks that became ready by it.
    fn change<T>(&self, change: impl FnOnce(&mut Farm, i64) -> T) -> T {
        let (mut farm, now_ms) = (self.farm(), self.now_ms());
        let changed = change(&mut farm, now_ms);
        farm.note_ready(now_ms);
        changed
    }
}

#[async_trait]
impl FarmStore for MemoryStore {
    async fn submit(&self, submission: &Submission) -> Result<Submitted, StoreError> {
        self.change(|farm, now_ms| farm.all_or_nothing(|farm| farm.submit(submission, now_ms)))
    }

    async fn reusable(&self, plan: &[TaskSpec]) -> Result<Vec<KnownResult>, StoreError> {
        Ok(self.farm().reusable(plan))
    }

    async fn forget(&self, keys: &[TaskKey]) -> Result<(), StoreError> {
        self.change(|farm, now_ms| keys.iter().for_each(|key| farm.forget(*key, now_ms)));
        Ok(())
    }

    async fn claim(&self, request: &ClaimRequest) -> Result<Vec<Lease>, StoreError> {
        self.change(|farm, now_ms| farm.claim(request, now_ms))
    }

    async fn look(&self, bakes: &[String], _enough: u64) -> Result<Look, StoreError> {
        Ok(self.farm().look(bakes, self.now_ms()))
    }

    async fn note_present(&self, workers: &[String]) -> Result<(), StoreError> {
        self.farm().note_present(workers, self.now_ms());
        Ok(())
    }

    async fn heartbeat(&self, token: &str, progress: f32) -> Result<HeartbeatAnswer, StoreError> {
        Ok(self.farm().heartbeat(token, progress, self.now_ms()))
    }

    async fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict, StoreError> {
        self.change(|farm, now_ms| {
            if result.plan.is_empty() {
                return farm.commit(token, result, now_ms);
            }
            farm.all_or_nothing(|farm| farm.commit(token, result, now_ms))
        })
    }

    async fn commit_all(&self, commits: &[(&str, &TaskResult)]) -> Vec<Result<CommitVerdict, StoreError>> {
        let first = self.farm().commits_first(commits, self.now_ms());
        let others = (0..commits.len()).filter(|index| !first.contains(index));
        let mut verdicts = Vec::with_capacity(commits.len());
        for index in first.iter().copied().chain(others) {
            let (token, result) = commits[index];
            verdicts.push((index, self.commit(token, result).await));
        }
        verdicts.sort_by_key(|(index, _)| *index);
        verdicts.into_iter().map(|(_, verdict)| verdict).collect()
    }

    async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<FailVerdict, StoreError> {
        Ok(self.change(|farm, now_ms| farm.fail(token, blame, message, (self.rules, now_ms))))
    }

    async fn release(&self, token: &str) -> Result<bool, StoreError> {
        Ok(self.change(|farm, now_ms| farm.release(token, now_ms)))
    }

    async fn extend_leases(&self) -> Result<u64, StoreError> {
        Ok(self.farm().extend_leases(self.now_ms()))
    }

    async fn blocklist(&self, bake: &str) -> Result<Blocklist, StoreError> {
        let farm = self.farm();
        Ok(farm.blocklist(farm.index_of(bake)?))
    }

    async fn clear_blocklist(&self, bake: &str, worker: Option<&str>) -> Result<Blocklist, StoreError> {
        let mut farm = self.farm();
        let index = farm.index_of(bake)?;
        farm.clear_blocklist(index, worker);
        Ok(farm.blocklist(index))
    }

    async fn reap(&self) -> Result<Reaped, StoreError> {
        Ok(self.change(|farm, now_ms| farm.reap(self.rules, now_ms)))
    }

    async fn pause(&self, bake: &str) -> Result<Bake, StoreError> {
        self.change(|farm, now_ms| farm.set_state(bake, BakeState::Paused, "paused", now_ms))
    }

    async fn resume(&self, bake: &str) -> Result<Bake, StoreError> {
        self.change(|farm, now_ms| farm.set_state(bake, BakeState::Running, "resumed", now_ms))
    }

    async fn cancel(&self, bake: &str) -> Result<Bake, StoreError> {
        self.change(|farm, now_ms| farm.cancel(bake, now_ms))
    }

    async fn reprioritise(&self, bake: &str, priority: i32) -> Result<Bake, StoreError> {
        let mut farm = self.farm();
        let index = farm.index_of(bake)?;
        require_live(bake, farm.bakes[index].state, "given another priority")?;
        farm.bakes[index].new.priority = priority;
        Ok(farm.view(index))
    }

    async fn show(&self, bake: &str) -> Result<Bake, StoreError> {
        let farm = self.farm();
        Ok(farm.view(farm.index_of(bake)?))
    }

    async fn list(
        &self,
        filter: &BakeFilter,
        after: Option<u64>,
        limit: u32,
    ) -> Result<BakePage, StoreError> {
        Ok(self.farm().list(filter, after, limit))
    }

    async fn begin_with(&self, id: &str, limit: u32) -> Result<Vec<Named>, StoreError> {
        Ok(self.farm().begin_with(id, limit))
    }

    async fn events_after(&self, bake: &str, after: u64, limit: u32) -> Result<EventPage, StoreError> {
        self.farm().events_after(bake, after, limit)
    }

    async fn results_after(
        &self,
        bake: &str,
        kind: Option<&str>,
        after: u64,
        limit: u32,
    ) -> Result<ResultPage, StoreError> {
        self.farm().results_after(bake, kind, after, limit)
    }

    async fn workers(&self) -> Result<Vec<Worker>, StoreError> {
        Ok(self.farm().workers(self.now_ms()))
    }

    async fn add_bearer(
        &self,
        name: &str,
        hash: Digest,
        scopes: &BTreeSet<Scope>,
    ) -> Result<Bearer, StoreError> {
        let mut farm = self.farm();
        if let Some(found) = farm.bearers.get(name) {
            return same_bearer(found.clone(), hash);
        }
        let (name, scopes) = (name.to_owned(), scopes.clone());
        let bearer = Bearer { name, hash, scopes, created_ms: self.now_ms(), revoked_ms: None };
        farm.bearers.insert(bearer.name.clone(), bearer.clone());
        Ok(bearer)
    }

    async fn revoke_bearer(&self, name: &str) -> Result<Bearer, StoreError> {
        let mut farm = self.farm();
        let bearer = farm.bearers.get_mut(name);
        let bearer = bearer.ok_or_else(|| StoreError::NoSuchBearer { name: name.to_owned() })?;
        bearer.revoked_ms.get_or_insert(self.now_ms());
        Ok(bearer.clone())
    }

    async fn bearers(&self) -> Result<Vec<Bearer>, StoreError> {
        Ok(self.farm().bearers.values().cloned().collect())
    }

    async fn find_chunks(&self, digests: &[Digest]) -> Result<Vec<KeptChunk>, StoreError> {
        let farm = self.farm();
        Ok(digests.iter().filter_map(|digest| farm.chunks.kept(*digest)).collect())
    }

    async fn touch_chunk(&self, digest: Digest) -> Result<Option<KeptChunk>, StoreError> {
        Ok(self.farm().chunks.touch(digest, self.now_ms()))
    }

    async fn keep_chunk(
        &self,
        chunk: KeptChunk,
        replaces: Option<u64>,
        quota: Option<u64>,
    ) -> Result<Kept, StoreError> {
        self.farm().chunks.keep(chunk, replaces, quota, self.now_ms())
    }

    async fn set_evaluation(
        &self,
        bake: &str,
        index: Digest,
        files: &BTreeSet<Digest>,
    ) -> Result<(), StoreError> {
        self.farm().set_evaluation(bake, index, files)
    }

    async fn delete_bake(&self, bake: &str) -> Result<(), StoreError> {
        self.change(|farm, _| farm.delete_bake(bake))
    }

    async fn collect(&self, rules: &CollectRules) -> Result<Collected, StoreError> {
        Ok(self.change(|farm, now_ms| farm.collect(rules, now_ms)))
    }

    async fn purge(&self, names: &[ChunkName]) -> Result<(), StoreError> {
        self.farm().chunks.purge(names);
        Ok(())
    }

    async fn lose_chunk(&self, name: ChunkName) -> Result<u64, StoreError> {
        Ok(self.change(|farm, now_ms| farm.lose_chunk(name, now_ms)))
    }

    async fn chunk_rows(&self, after: Option<Digest>, limit: u32) -> Result<Vec<ChunkRow>, StoreError> {
        Ok(self.farm().chunk_rows(after, limit))
    }

    async fn orphans(&self, names: &[ChunkName]) -> Result<Vec<ChunkName>, StoreError> {
        Ok(self.farm().chunks.orphans(names))
    }

    async fn condemn_orphans(&self, chunks: &[KeptChunk]) -> Result<Vec<ChunkName>, StoreError> {
        Ok(self.farm().chunks.condemn_orphans(chunks))
    }

    async fn usage(&self) -> Result<Usage, StoreError> {
        Ok(self.farm().chunks.usage())
    }

    async fn stats(&self) -> Result<Stats, StoreError> {
        Ok(self.farm().stats(self.now_ms()))
    }

    async fn probe(&self) -> Result<(), StoreError> {
        Ok(())
    }
}
