//! The farm in a database: SQLite for one machine, PostgreSQL for any number of servers.
//!
//! Every call is one transaction, written once for both databases. While a transaction that changes a bake runs, no
//! other one does, and no claim: on SQLite because of the file's own lock (and there is one writing connection in a process), on PostgreSQL because of a lock
//! ([`postgres`] says which and why). So each sees the farm as the one before left it, and the counts that callers see
//! are kept with each change, never recounted.
//!
//! **Trying again.** A transaction whose connection died before COMMIT was sent never happened, nor did one that the
//! database gave up to resolve a deadlock; both are run again here. When the connection dies during COMMIT its outcome
//! is unknown: the caller is told, and asks again with the same token or Idempotency-Key, which is safe.

mod alarms;
mod bakes;
mod batch;
mod bearers;
mod blocklist;
mod chunks;
mod claim;
mod codec;
mod conn;
mod evaluation;
mod faults;
mod forget;
mod leases;
mod ledger;
mod listing;
mod outcome;
mod outputs;
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
    Bake, BakeFilter, BakePage, BakeState, Blame, Blocklist, ClaimRequest, CommitVerdict, EventPage,
    HeartbeatAnswer, Lease, ResultPage, Worker,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use super::chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
use super::rules::FarmRules;
use super::{
    FailVerdict, FarmStore, KnownResult, Named, Reaped, Result, Stats, StoreError, Submission, Submitted,
};
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
    rules: FarmRules,
}

impl SqlStore {
    /// Opens the SQLite file at `path`, making or migrating it as needed.
    pub async fn open_sqlite(path: &Path, clock: Arc<dyn Clock>) -> Result<Self> {
        let database = Database::Sqlite(SqliteFile::open(path).await?, clock);
        Ok(Self { database, faults: None, commits: CommitQueue::default(), rules: FarmRules::default() })
    }

    /// Whether the SQLite file at `path` has the schema of this program, so that opening it changes nothing.
    pub async fn is_current_sqlite(path: &Path) -> Result<bool> {
        sqlite::is_current(path).await
    }

    /// Opens the PostgreSQL database at `url` (`postgres://…`), making or migrating its tables as needed.
    ///
    /// Without a clock the database's own time counts, as it must where several servers share it.
    pub async fn open_postgres(url: &str, clock: Option<Arc<dyn Clock>>) -> Result<Self> {
        let database = Database::Postgres(PostgresDatabase::open(url).await?, clock);
        Ok(Self { database, faults: None, commits: CommitQueue::default(), rules: FarmRules::default() })
    }

    /// Tells `faults` of every step from now on; for tests.
    #[must_use]
    pub fn with_faults(mut self, faults: Arc<dyn Faults>) -> Self {
        self.faults = Some(faults);
        self
    }

    /// Goes by these rules from now on.
    #[must_use]
    pub fn with_rules(self, rules: FarmRules) -> Self {
        Self { rules, ..self }
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
    ($store:ident, $kind:ident, $call:expr, |$conn:ident| $work:expr) => {{
        let mut tries = 0;
        loop {
            tries += 1;
            let worked = async {
                let mut held = $store.begin(Kind::$kind, $call).await?;
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
    /// Gives back every task of a worker whose process has certainly ended; no attempts are counted. Returns how many.
    pub async fn release_all(&self, worker: &str) -> Result<u64> {
        transact!(self, Write, "release_all", |conn| leases::release_all(conn, worker))
    }

    async fn commit_alone(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict> {
        transact!(self, Write, "commit", |conn| outcome::commit(conn, token, result))
    }

    /// Commits all in one transaction. If that fails and may be the fault of one of them, each in its own.
    async fn commit_batch(&self, batch: Vec<Waiting>) {
        if batch.len() > 1 {
            let verdicts: Result<_> =
                transact!(self, Write, "commit", |conn| outcome::commit_all(conn, &batch));
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

/// Makes the store of its calls. Most are a row each: the kind of the transaction, the call, and the work in it.
macro_rules! farm_store {
    (
        rows { $($kind:ident $call:ident($($argument:ident: $type:ty),*) -> $answer:ty = |$conn:ident| $work:expr;)+ }
        $($own:tt)*
    ) => {
        #[async_trait]
        impl FarmStore for SqlStore {
            $(async fn $call(&self, $($argument: $type),*) -> Result<$answer> {
                transact!(self, $kind, stringify!($call), |$conn| $work)
            })+
            $($own)*
        }
    };
}

farm_store! {
    rows {
        Write submit(submission: &Submission) -> Submitted = |conn| bakes::submit(conn, submission);
        Read reusable(plan: &[TaskSpec]) -> Vec<KnownResult> = |conn| forget::reusable(conn, plan);
        Write forget(keys: &[TaskKey]) -> () = |conn| forget::forget_all(conn, keys);
        Lease claim(request: &ClaimRequest) -> Vec<Lease> = |conn| claim::claim(conn, request);
        Read is_any_ready(kinds: &[String]) -> bool = |conn| claim::is_any_ready(conn, kinds);
        Lease heartbeat(token: &str, progress: f32) -> HeartbeatAnswer =
            |conn| leases::heartbeat(conn, token, progress);
        Write release(token: &str) -> bool = |conn| leases::release(conn, token);
        Lease extend_leases() -> u64 = |conn| leases::extend(conn);
        Read blocklist(bake: &str) -> Blocklist = |conn| blocklist::show(conn, bake);
        Write clear_blocklist(bake: &str, worker: Option<&str>) -> Blocklist =
            |conn| blocklist::clear(conn, bake, worker);
        Write pause(bake: &str) -> Bake = |conn| bakes::set_state(conn, bake, BakeState::Paused, "paused");
        Write resume(bake: &str) -> Bake = |conn| bakes::set_state(conn, bake, BakeState::Running, "resumed");
        Write cancel(bake: &str) -> Bake = |conn| bakes::cancel(conn, bake);
        Write reprioritise(bake: &str, priority: i32) -> Bake = |conn| bakes::reprioritise(conn, bake, priority);
        Read show(bake: &str) -> Bake = |conn| view::bake(conn, bake);
        Read list(filter: &BakeFilter, after: Option<u64>, limit: u32) -> BakePage =
            |conn| listing::page(conn, filter, after, limit);
        Read begin_with(id: &str, limit: u32) -> Vec<Named> = |conn| listing::begin_with(conn, id, limit);
        Read events_after(bake: &str, after: u64, limit: u32) -> EventPage =
            |conn| view::events_after(conn, bake, after, limit);
        Read results_after(bake: &str, kind: Option<&str>, after: u64, limit: u32) -> ResultPage =
            |conn| view::results_after(conn, bake, kind, after, limit);
        Read workers() -> Vec<Worker> = |conn| view::workers(conn);
        Write add_bearer(name: &str, hash: Digest, scopes: &BTreeSet<Scope>) -> Bearer =
            |conn| bearers::add(conn, name, hash, scopes);
        Write revoke_bearer(name: &str) -> Bearer = |conn| bearers::revoke(conn, name);
        Read bearers() -> Vec<Bearer> = |conn| bearers::all(conn);
        Read find_chunks(digests: &[Digest]) -> Vec<KeptChunk> = |conn| chunks::find(conn, digests);
        Lease keep_chunk(chunk: KeptChunk, replaces: Option<u64>, quota: Option<u64>) -> Kept =
            |conn| chunks::keep(conn, chunk, replaces, quota);
        Write set_evaluation(bake: &str, index: Digest, files: &BTreeSet<Digest>) -> () =
            |conn| evaluation::set(conn, bake, index, files);
        Write delete_bake(bake: &str) -> () = |conn| chunks::delete_bake(conn, bake);
        Write collect(rules: &CollectRules) -> Collected = |conn| chunks::collect(conn, rules);
        Write purge(names: &[ChunkName]) -> () = |conn| chunks::purge(conn, names);
        Write lose_chunk(name: ChunkName) -> u64 = |conn| chunks::lose(conn, name);
        Read chunk_rows(after: Option<Digest>, limit: u32) -> Vec<ChunkRow> =
            |conn| chunks::rows(conn, after, limit);
        Read orphans(names: &[ChunkName]) -> Vec<ChunkName> = |conn| chunks::orphans(conn, names);
        Write condemn_orphans(chunks: &[KeptChunk]) -> Vec<ChunkName> =
            |conn| chunks::condemn_orphans(conn, chunks);
        Read usage() -> Usage = |conn| chunks::usage(conn);
        Read stats() -> Stats = |conn| view::stats(conn);
        Write probe() -> () = |conn| view::probe(conn);
    }

    async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<FailVerdict> {
        transact!(self, Write, "fail", |conn| outcome::fail(conn, token, blame, message, self.rules))
    }

    async fn reap(&self) -> Result<Reaped> {
        transact!(self, Write, "reap", |conn| outcome::reap(conn, self.rules))
    }

    async fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict> {
        if result.plan.is_empty() {
            return self.commits.commit(token, result, |batch| self.commit_batch(batch)).await;
        }
        // Too big to stand in line, and it may be refused: it fails alone.
        self.commit_alone(token, result).await
    }

    async fn examine(&self) -> Result<()> {
        match &self.database {
            Database::Sqlite(file, _) => file.examine().await,
            // It checks its pages as it reads them.
            Database::Postgres(..) => Ok(()),
        }
    }

    async fn touch_chunk(&self, digest: Digest) -> Result<Option<KeptChunk>> {
        let looked: Result<_> = transact!(self, Read, "look_at_chunk", |conn| chunks::look(conn, digest));
        match looked? {
            None => Ok(None),
            // Asked for a moment ago: there is nothing to write.
            Some((kept, false)) => Ok(Some(kept)),
            Some((_, true)) => {
                transact!(self, Lease, "touch_chunk", |conn| chunks::touch(conn, digest))
            }
        }
    }
}
