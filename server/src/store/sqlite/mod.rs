//! The farm in one SQLite file: WAL, `synchronous=FULL`, one writing connection, a few reading ones.
//!
//! Every call is one transaction. What a caller may rely on is flushed to the disk before it hears of it; only claims
//! and heartbeats are not: if the machine loses power their leases are lost, and the tasks run again. Counts that
//! callers see are kept with each change, never recounted.

mod bakes;
mod claim;
mod db;
mod forget;
mod leases;
mod ledger;
mod outcome;
mod plan;
mod view;

use std::path::Path;
use std::sync::Arc;

use async_trait::async_trait;
use lightkiln_proto::api::{
    Bake, BakePage, BakeState, Blame, ClaimRequest, CommitVerdict, EventPage, HeartbeatAnswer, Lease, Worker,
};
use lightkiln_proto::ids::TaskKey;
use lightkiln_proto::jobs::{TaskResult, TaskSpec};
use sqlx::{Sqlite, SqliteConnection, SqlitePool, Transaction};

use super::{FailVerdict, FarmStore, KnownResult, Reaped, Stats, StoreError, Submission, Submitted};
use crate::clock::Clock;

/// What every query runs on.
type Conn = SqliteConnection;

/// A farm in an SQLite file.
pub struct SqliteStore {
    writer: SqlitePool,
    readers: SqlitePool,
    clock: Arc<dyn Clock>,
}

impl SqliteStore {
    /// Opens the file at `path`, making or migrating it as needed.
    pub async fn open(path: &Path, clock: Arc<dyn Clock>) -> Result<Self, StoreError> {
        let writer = db::pool(path, 1, false).await?;
        db::migrate(&writer).await?;
        let readers = db::pool(path, db::READERS, true).await?;
        Ok(Self { writer, readers, clock })
    }

    /// Waits for running transactions and closes the file.
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }

    /// A transaction that is on the disk once it is committed, with all before it.
    async fn write(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.writer.begin_with("PRAGMA synchronous = FULL; BEGIN IMMEDIATE").await?)
    }

    /// A transaction that power loss may undo: half of a task's flushes are saved by it.
    async fn write_lease(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.writer.begin_with("PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE").await?)
    }

    async fn read(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.readers.begin().await?)
    }

    fn now_ms(&self) -> i64 {
        self.clock.now_ms()
    }
}

#[async_trait]
impl FarmStore for SqliteStore {
    async fn submit(&self, submission: &Submission) -> Result<Submitted, StoreError> {
        let mut tx = self.write().await?;
        let submitted = bakes::submit(&mut tx, submission, self.now_ms()).await?;
        tx.commit().await?;
        Ok(submitted)
    }

    async fn reusable(&self, plan: &[TaskSpec]) -> Result<Vec<KnownResult>, StoreError> {
        forget::reusable(&mut *self.read().await?, plan).await
    }

    async fn forget(&self, keys: &[TaskKey]) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        for key in keys {
            forget::forget(&mut tx, *key).await?;
        }
        Ok(tx.commit().await?)
    }

    async fn claim(&self, request: &ClaimRequest) -> Result<Vec<Lease>, StoreError> {
        let mut tx = self.write_lease().await?;
        let leases = claim::claim(&mut tx, request, self.now_ms()).await?;
        tx.commit().await?;
        Ok(leases)
    }

    async fn heartbeat(&self, token: &str, progress: f32) -> Result<HeartbeatAnswer, StoreError> {
        let mut tx = self.write_lease().await?;
        let answer = leases::heartbeat(&mut tx, token, progress, self.now_ms()).await?;
        tx.commit().await?;
        Ok(answer)
    }

    async fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict, StoreError> {
        let mut tx = self.write().await?;
        let verdict = outcome::commit(&mut tx, token, result, self.now_ms()).await?;
        tx.commit().await?;
        Ok(verdict)
    }

    async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<FailVerdict, StoreError> {
        let mut tx = self.write().await?;
        let verdict = outcome::fail(&mut tx, token, blame, message, self.now_ms()).await?;
        tx.commit().await?;
        Ok(verdict)
    }

    async fn release(&self, token: &str) -> Result<bool, StoreError> {
        let mut tx = self.write().await?;
        let released = leases::release(&mut tx, token, self.now_ms()).await?;
        tx.commit().await?;
        Ok(released)
    }

    async fn reap(&self) -> Result<Reaped, StoreError> {
        let mut tx = self.write().await?;
        let reaped = outcome::reap(&mut tx, self.now_ms()).await?;
        tx.commit().await?;
        Ok(reaped)
    }

    async fn pause(&self, bake: &str) -> Result<Bake, StoreError> {
        let mut tx = self.write().await?;
        let bake = bakes::set_state(&mut tx, bake, BakeState::Paused, "paused", self.now_ms()).await?;
        tx.commit().await?;
        Ok(bake)
    }

    async fn resume(&self, bake: &str) -> Result<Bake, StoreError> {
        let mut tx = self.write().await?;
        let bake = bakes::set_state(&mut tx, bake, BakeState::Running, "resumed", self.now_ms()).await?;
        tx.commit().await?;
        Ok(bake)
    }

    async fn cancel(&self, bake: &str) -> Result<Bake, StoreError> {
        let mut tx = self.write().await?;
        let bake = bakes::cancel(&mut tx, bake, self.now_ms()).await?;
        tx.commit().await?;
        Ok(bake)
    }

    async fn reprioritise(&self, bake: &str, priority: i32) -> Result<Bake, StoreError> {
        let mut tx = self.write().await?;
        let bake = bakes::reprioritise(&mut tx, bake, priority).await?;
        tx.commit().await?;
        Ok(bake)
    }

    async fn show(&self, bake: &str) -> Result<Bake, StoreError> {
        view::bake(&mut *self.read().await?, bake).await
    }

    async fn list(&self, after: Option<&str>, limit: u32) -> Result<BakePage, StoreError> {
        view::list(&mut *self.read().await?, after, limit).await
    }

    async fn events_after(&self, bake: &str, after: u64, limit: u32) -> Result<EventPage, StoreError> {
        view::events_after(&mut *self.read().await?, bake, after, limit).await
    }

    async fn workers(&self) -> Result<Vec<Worker>, StoreError> {
        view::workers(&mut *self.read().await?, self.now_ms()).await
    }

    async fn stats(&self) -> Result<Stats, StoreError> {
        view::stats(&mut *self.read().await?).await
    }

    async fn probe(&self) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        db::probe(&mut tx, self.now_ms()).await?;
        Ok(tx.commit().await?)
    }
}
