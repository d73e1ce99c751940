//! The farm in a database: SQLite for one server, PostgreSQL for any number of them.
//!
//! Every call is one transaction, written once for both databases. While a transaction that changes a bake runs, no
//! other one does, and no claim: on SQLite because there is one writing connection, on PostgreSQL because of a lock
//! ([`postgres`] says which and why). So each sees the farm as the one before left it, and the counts that callers see
//! are kept with each change, never recounted.
//!
//! **Trying again.** A transaction whose connection died before COMMIT was sent never happened, nor did one that the
//! database gave up to resolve a deadlock; both are run again here. When the connection dies during COMMIT its outcome
//! is unknown: the caller is told, and asks again with the same token or Idempotency-Key, which is safe.

mod bakes;
mod batch;
mod bearers;
mod blocklist;
mod chunks;
mod claim;
mod codec;
mod conn;
mod faults;
mod forget;
mod leases;
mod ledger;
mod outcome;
mod plan;
mod postgres;
mod ready;
mod remake;
mod sqlite;
mod view;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use lightkiln_proto::api::{
    Bake, BakePage, BakeState, Blame, Blocklist, ClaimRequest, CommitVerdict, EventPage, HeartbeatAnswer,
    Lease, Worker,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use super::chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
use super::{FailVerdict, FarmStore, KnownResult, Reaped, Result, Stats, StoreError, Submission, Submitted};
use crate::access::{Bearer, Scope};
use crate::chunks::ChunkName;
use crate::clock::Clock;
use batch::{CommitQueue, Waiting};
use conn::Conn;
use postgres::PostgresDatabase;
use sqlite::SqliteFile;

pub use faults::{FaultPoint, Faults};

/// Most times that one call is tried.
const TRIES_MAX: u32 = 5;
/// Wait before the second try; doubles with each.
const FIRST_WAIT: Duration = Duration::from_millis(20);

/// Kinds of transactions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Sees one moment of the farm.
    Read,
    /// Claims and heartbeats; the database's machine may forget them when it dies.
    Lease,
    /// Everything else: changes that are kept once the caller hears of them.
    Write,
}

enum Database {
    Sqlite(SqliteFile, Arc<dyn Clock>),
    /// Without a clock the database's own time counts.
    Postgres(PostgresDatabase, Option<Arc<dyn Clock>>),
}

/// A farm in a database.
pub struct SqlStore {
    database: Database,
    faults: Option<Arc<dyn Faults>>,
    commits: CommitQueue,
}

impl SqlStore {
    /// Opens the SQLite file at `path`, making or migrating it as needed.
    pub async fn open_sqlite(path: &Path, clock: Arc<dyn Clock>) -> Result<Self> {
        let database = Database::Sqlite(SqliteFile::open(path).await?, clock);
        Ok(Self { database, faults: None, commits: CommitQueue::default() })
    }

    /// Opens the PostgreSQL database at `url` (`postgres://…`), making or migrating its tables as needed.
    ///
    /// Without a clock the database's own time counts, as it must where several servers share it.
    pub async fn open_postgres(url: &str, clock: Option<Arc<dyn Clock>>) -> Result<Self> {
        let database = Database::Postgres(PostgresDatabase::open(url).await?, clock);
        Ok(Self { database, faults: None, commits: CommitQueue::default() })
    }

    /// Tells `faults` of every step from now on; for tests.
    #[must_use]
    pub fn with_faults(mut self, faults: Arc<dyn Faults>) -> Self {
        self.faults = Some(faults);
        self
    }

    /// Waits for running transactions and closes all connections.
    pub async fn close(&self) {
        match &self.database {
            Database::Sqlite(file, _) => file.close().await,
            Database::Postgres(database, _) => database.close().await,
        }
    }

    async fn begin(&self, kind: Kind, call: &'static str) -> Result<Conn> {
        let (tx, now_ms) = match &self.database {
            Database::Sqlite(file, clock) => {
                let tx = file.begin(kind).await?;
                (tx, clock.now_ms())
            }
            Database::Postgres(database, clock) => {
                let (tx, now_ms) = database.begin(kind).await?;
                (tx, clock.as_ref().map_or(now_ms, |clock| clock.now_ms()))
            }
        };
        Ok(Conn::new(tx, now_ms, call, self.faults.clone()))
    }
}

/// Whether a call that failed before its COMMIT may be tried again; waits a little if so.
async fn may_try_again(error: &StoreError, tries: u32) -> bool {
    let passes = matches!(error, StoreError::Contended(_)) || is_lost_connection(error);
    if !passes || tries >= TRIES_MAX {
        return false;
    }
    tracing::debug!(%error, tries, "a transaction is tried again");
    tokio::time::sleep(FIRST_WAIT * (1 << (tries - 1))).await;
    true
}

/// Whether the connection is gone, so that another one may do better.
fn is_lost_connection(error: &StoreError) -> bool {
    let StoreError::Unavailable(source) = error else { return false };
    match source.downcast_ref::<sqlx::Error>() {
        Some(sqlx::Error::Io(_) | sqlx::Error::Protocol(_)) => true,
        // Ended by an administrator, a crash, a shutdown or a timeout between two statements.
        Some(sqlx::Error::Database(error)) => {
            error.code().is_some_and(|code| ["57P01", "57P02", "57P03", "25P03"].contains(&&*code))
        }
        _ => false,
    }
}

/// A database that a newer program has changed.
fn too_new(found: i64, known: usize) -> StoreError {
    let what =
        format!("the database has schema version {found}, this program knows {known}; use a newer program");
    StoreError::Corrupt { what, source: None }
}

/// Classes of a database's errors.
enum Class {
    /// No room.
    Full,
    /// Later, perhaps.
    Unavailable,
    /// The database let another transaction through instead.
    Contended,
    /// A bug, or a damaged database.
    Broken,
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        use sqlx::Error::{Configuration, Io, PoolClosed, PoolTimedOut, Protocol, Tls, WorkerCrashed};
        let class = match &error {
            sqlx::Error::Database(database) => {
                let sqlite = database.try_downcast_ref().map(sqlite::class_of);
                sqlite
                    .or_else(|| database.try_downcast_ref().map(postgres::class_of))
                    .unwrap_or(Class::Broken)
            }
            Io(_) | Protocol(_) | Tls(_) | PoolTimedOut | PoolClosed | WorkerCrashed | Configuration(_) => {
                Class::Unavailable
            }
            _ => Class::Broken,
        };
        match class {
            Class::Full => Self::Full(error.into()),
            Class::Unavailable => Self::Unavailable(error.into()),
            Class::Contended => Self::Contended(error.into()),
            Class::Broken => Self::Corrupt { what: "a query failed".into(), source: Some(error.into()) },
        }
    }
}

/// Runs `$work` in a transaction of its own, again if that is safe and may help.
macro_rules! transact {
    ($store:ident, $kind:ident, $call:literal, |$conn:ident, $now_ms:ident| $work:expr) => {{
        let mut tries = 0;
        loop {
            tries += 1;
            let worked = async {
                let mut held = $store.begin(Kind::$kind, $call).await?;
                let $now_ms = held.now_ms;
                let $conn = &mut held;
                let value = $work.await?;
                Ok::<_, StoreError>((held, value))
            };
            let error = match worked.await {
                Err(error) => error,
                Ok((held, value)) => match held.commit().await {
                    Ok(()) => break Ok(value),
                    Err(error @ StoreError::Contended(_)) => error,
                    Err(error) => break Err(error),
                },
            };
            if !may_try_again(&error, tries).await {
                break Err(error);
            }
        }
    }};
}

impl SqlStore {
    async fn commit_alone(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict> {
        transact!(self, Write, "commit", |conn, now_ms| outcome::commit(conn, token, result, now_ms))
    }

    /// Commits all in one transaction. If that fails and may be the fault of one of them, each in its own.
    async fn commit_batch(&self, batch: Vec<Waiting>) {
        if batch.len() > 1 {
            let verdicts: Result<_> =
                transact!(self, Write, "commit", |conn, now_ms| outcome::commit_all(conn, &batch, now_ms));
            match verdicts {
                Ok(verdicts) => {
                    let answered = batch.into_iter().zip(verdicts);
                    return answered.for_each(|(waiting, verdict)| waiting.answer(Ok(verdict)));
                }
                Err(error) => match batch::trouble_of_all(error) {
                    // Each by itself would wait as long, and fail as well.
                    Ok(trouble) => {
                        return batch.into_iter().for_each(|waiting| waiting.answer(Err(trouble())));
                    }
                    Err(error) => {
                        tracing::warn!(%error, commits = batch.len(), "commits are tried one by one");
                    }
                },
            }
        }
        for waiting in batch {
            let verdict = self.commit_alone(&waiting.token, &waiting.result).await;
            waiting.answer(verdict);
        }
    }
}

#[async_trait]
impl FarmStore for SqlStore {
    async fn submit(&self, submission: &Submission) -> Result<Submitted> {
        transact!(self, Write, "submit", |conn, now_ms| bakes::submit(conn, submission, now_ms))
    }

    async fn reusable(&self, plan: &[TaskSpec]) -> Result<Vec<KnownResult>> {
        transact!(self, Read, "reusable", |conn, _now_ms| forget::reusable(conn, plan))
    }

    async fn forget(&self, keys: &[TaskKey]) -> Result<()> {
        transact!(self, Write, "forget", |conn, now_ms| forget::forget_all(conn, keys, now_ms))
    }

    async fn claim(&self, request: &ClaimRequest) -> Result<Vec<Lease>> {
        transact!(self, Lease, "claim", |conn, now_ms| claim::claim(conn, request, now_ms))
    }

    async fn is_any_ready(&self, kinds: &[String]) -> Result<bool> {
        transact!(self, Read, "is_any_ready", |conn, now_ms| claim::is_any_ready(conn, kinds, now_ms))
    }

    async fn heartbeat(&self, token: &str, progress: f32) -> Result<HeartbeatAnswer> {
        transact!(self, Lease, "heartbeat", |conn, now_ms| leases::heartbeat(conn, token, progress, now_ms))
    }

    async fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict> {
        if result.plan.is_empty() {
            return self.commits.commit(token, result, |batch| self.commit_batch(batch)).await;
        }
        // Too big to stand in line, and it may be refused: it fails alone.
        self.commit_alone(token, result).await
    }

    async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<FailVerdict> {
        transact!(self, Write, "fail", |conn, now_ms| outcome::fail(conn, token, blame, message, now_ms))
    }

    async fn release(&self, token: &str) -> Result<bool> {
        transact!(self, Write, "release", |conn, now_ms| leases::release(conn, token, now_ms))
    }

    async fn extend_leases(&self) -> Result<u64> {
        transact!(self, Lease, "extend_leases", |conn, now_ms| leases::extend(conn, now_ms))
    }

    async fn blocklist(&self, bake: &str) -> Result<Blocklist> {
        transact!(self, Read, "blocklist", |conn, _now_ms| blocklist::show(conn, bake))
    }

    async fn clear_blocklist(&self, bake: &str, worker: Option<&str>) -> Result<Blocklist> {
        transact!(self, Write, "clear_blocklist", |conn, _now_ms| blocklist::clear(conn, bake, worker))
    }

    async fn reap(&self) -> Result<Reaped> {
        transact!(self, Write, "reap", |conn, now_ms| outcome::reap(conn, now_ms))
    }

    async fn pause(&self, bake: &str) -> Result<Bake> {
        let (state, action) = (BakeState::Paused, "paused");
        transact!(self, Write, "pause", |conn, now_ms| bakes::set_state(conn, bake, state, action, now_ms))
    }

    async fn resume(&self, bake: &str) -> Result<Bake> {
        let (state, action) = (BakeState::Running, "resumed");
        transact!(self, Write, "resume", |conn, now_ms| bakes::set_state(conn, bake, state, action, now_ms))
    }

    async fn cancel(&self, bake: &str) -> Result<Bake> {
        transact!(self, Write, "cancel", |conn, now_ms| bakes::cancel(conn, bake, now_ms))
    }

    async fn reprioritise(&self, bake: &str, priority: i32) -> Result<Bake> {
        transact!(self, Write, "reprioritise", |conn, _now_ms| bakes::reprioritise(conn, bake, priority))
    }

    async fn show(&self, bake: &str) -> Result<Bake> {
        transact!(self, Read, "show", |conn, _now_ms| view::bake(conn, bake))
    }

    async fn list(&self, after: Option<u64>, limit: u32) -> Result<BakePage> {
        transact!(self, Read, "list", |conn, _now_ms| view::list(conn, after, limit))
    }

    async fn events_after(&self, bake: &str, after: u64, limit: u32) -> Result<EventPage> {
        transact!(self, Read, "events_after", |conn, _now_ms| view::events_after(conn, bake, after, limit))
    }

    async fn workers(&self) -> Result<Vec<Worker>> {
        transact!(self, Read, "workers", |conn, now_ms| view::workers(conn, now_ms))
    }

    async fn add_bearer(&self, name: &str, hash: Digest, scopes: &BTreeSet<Scope>) -> Result<Bearer> {
        transact!(self, Write, "add_bearer", |conn, now_ms| bearers::add(conn, name, hash, scopes, now_ms))
    }

    async fn revoke_bearer(&self, name: &str) -> Result<Bearer> {
        transact!(self, Write, "revoke_bearer", |conn, now_ms| bearers::revoke(conn, name, now_ms))
    }

    async fn bearers(&self) -> Result<Vec<Bearer>> {
        transact!(self, Read, "bearers", |conn, _now_ms| bearers::all(conn))
    }

    async fn find_chunks(&self, digests: &[Digest]) -> Result<Vec<KeptChunk>> {
        transact!(self, Read, "find_chunks", |conn, _now_ms| chunks::find(conn, digests))
    }

    async fn touch_chunk(&self, digest: Digest) -> Result<Option<KeptChunk>> {
        let looked: Result<_> =
            transact!(self, Read, "look_at_chunk", |conn, now_ms| chunks::look(conn, digest, now_ms));
        match looked? {
            None => Ok(None),
            // Asked for a moment ago: there is nothing to write.
            Some((kept, false)) => Ok(Some(kept)),
            Some((_, true)) => {
                transact!(self, Lease, "touch_chunk", |conn, now_ms| chunks::touch(conn, digest, now_ms))
            }
        }
    }

    async fn keep_chunk(&self, chunk: KeptChunk, replaces: Option<u64>, quota: Option<u64>) -> Result<Kept> {
        transact!(self, Lease, "keep_chunk", |conn, now_ms| chunks::keep(
            conn, chunk, replaces, quota, now_ms
        ))
    }

    async fn delete_bake(&self, bake: &str) -> Result<()> {
        transact!(self, Write, "delete_bake", |conn, _now_ms| chunks::delete_bake(conn, bake))
    }

    async fn collect(&self, rules: &CollectRules) -> Result<Collected> {
        transact!(self, Write, "collect", |conn, now_ms| chunks::collect(conn, rules, now_ms))
    }

    async fn purge(&self, names: &[ChunkName]) -> Result<()> {
        transact!(self, Write, "purge", |conn, _now_ms| chunks::purge(conn, names))
    }

    async fn lose_chunk(&self, name: ChunkName) -> Result<u64> {
        transact!(self, Write, "lose_chunk", |conn, now_ms| chunks::lose(conn, name, now_ms))
    }

    async fn chunk_rows(&self, after: Option<Digest>, limit: u32) -> Result<Vec<ChunkRow>> {
        transact!(self, Read, "chunk_rows", |conn, _now_ms| chunks::rows(conn, after, limit))
    }

    async fn orphans(&self, names: &[ChunkName]) -> Result<Vec<ChunkName>> {
        transact!(self, Read, "orphans", |conn, _now_ms| chunks::orphans(conn, names))
    }

    async fn condemn_orphans(&self, chunks: &[KeptChunk]) -> Result<Vec<ChunkName>> {
        transact!(self, Write, "condemn_orphans", |conn, _now_ms| chunks::condemn_orphans(conn, chunks))
    }

    async fn usage(&self) -> Result<Usage> {
        transact!(self, Read, "usage", |conn, _now_ms| chunks::usage(conn))
    }

    async fn stats(&self) -> Result<Stats> {
        transact!(self, Read, "stats", |conn, now_ms| view::stats(conn, now_ms))
    }

    async fn probe(&self) -> Result<()> {
        transact!(self, Write, "probe", |conn, now_ms| view::probe(conn, now_ms))
    }
}
