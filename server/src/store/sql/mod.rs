//! The farm in a database: SQLite for one machine, PostgreSQL for any number of servers.
//!
//! Every call is one transaction, written once for both databases. While a transaction that changes a bake runs, no
//! other one changes that bake: on SQLite because of the file's own lock (and there is one writing connection in a process),
//! on PostgreSQL because of the bake's ([`postgres`] says which changes run alone on the farm, and why the others need not).
//! So each sees the bake as the one before left it, and the counts that callers see are kept with each change, never recounted.
//!
//! **Trying again.** A transaction whose connection died before COMMIT was sent never happened, nor did one that the
//! database gave up to resolve a deadlock; both are run again here. When the connection dies during COMMIT its outcome
//! is unknown: the caller is told, and asks again with the same token or Idempotency-Key, which is safe.

mod alarms;
mod bakes;
mod batch;
mod bearers;
mod blocklist;
mod bulk;
mod chunks;
mod claim;
mod codec;
mod commit;
mod conn;
mod evaluation;
mod faults;
mod forget;
mod grant;
mod hand_in;
mod leases;
mod ledger;
mod listing;
mod look;
mod outcome;
mod outputs;
mod patience;
mod plan;
mod postgres;
mod present;
mod ready;
mod remake;
mod reruns;
mod sqlite;
mod view;

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use lightkiln_proto::api::{
    Bake, BakeFilter, BakePage, BakeState, Blame, Blocklist, ClaimRequest, CommitVerdict, EventPage,
    HeartbeatAnswer, Lease, ResultPage, Verdict, Worker,
};
use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{TaskResult, TaskSpec};

use super::chunk::{ChunkRow, CollectRules, Collected, Kept, KeptChunk, Usage};
use super::rules::FarmRules;
use super::{
    FailVerdict, FarmStore, KnownResult, Look, Named, Reaped, Result, Stats, StoreError, Submission,
    Submitted,
};
use crate::access::{Bearer, Scope};
use crate::chunks::ChunkName;
use crate::clock::Clock;
use batch::CommitQueue;
use conn::Conn;
use patience::{Locked, Patience, is_long_wait};
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
    /// Claims and uploads; the database's machine may forget them when it dies.
    Lease,
    /// The same, but it waits a moment only for rows that are locked.
    LeaseBriefly,
    /// Heartbeats: they wait for nobody but who changes the lease itself.
    Beat,
    /// Results: kept once the caller hears of them, and written beside others with the locks of their bakes.
    Commit,
    /// The same, but it waits a moment only for rows that are locked.
    CommitBriefly,
    /// Everything else: changes of the farm, one at a time, that are kept once the caller hears of them.
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
    patience: Patience,
    rules: FarmRules,
}

impl SqlStore {
    /// Opens the SQLite file at `path`, making or migrating it as needed.
    pub async fn open_sqlite(path: &Path, clock: Arc<dyn Clock>) -> Result<Self> {
        Ok(Self::over(Database::Sqlite(SqliteFile::open(path).await?, clock)))
    }

    /// Whether the SQLite file at `path` has the schema of this program, so that opening it changes nothing.
    pub async fn is_current_sqlite(path: &Path) -> Result<bool> {
        sqlite::is_current(path).await
    }

    /// Opens the PostgreSQL database at `url` (`postgres://…`), making or migrating its tables as needed.
    ///
    /// Without a clock the database's own time counts, as it must where several servers share it.
    pub async fn open_postgres(url: &str, clock: Option<Arc<dyn Clock>>) -> Result<Self> {
        Ok(Self::over(Database::Postgres(PostgresDatabase::open(url).await?, clock)))
    }

    fn over(database: Database) -> Self {
        let (commits, patience) = (CommitQueue::default(), Patience::default());
        Self { database, faults: None, commits, patience, rules: FarmRules::default() }
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
        Ok(Conn::new(tx, kind, now_ms, call, self.faults.clone()))
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
}

async fn collect(conn: &mut Conn, rules: &CollectRules) -> Result<Collected> {
    view::gather_counts(conn).await?;
    chunks::collect(conn, rules).await
}

use transact;

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
        Read reusable(plan: &[TaskSpec]) -> Vec<KnownResult> = |conn| forget::reusable(conn, plan);
        Write forget(keys: &[TaskKey]) -> () = |conn| forget::forget_all(conn, keys);
        Read look(bakes: &[String], enough: u64) -> Look = |conn| look::look(conn, bakes, enough);
        Beat note_present(workers: &[String]) -> () = |conn| look::note_present(conn, workers);
        Write release(token: &str) -> bool = |conn| leases::release(conn, token);
        Write extend_leases() -> u64 = |conn| leases::extend(conn);
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
        Write collect(rules: &CollectRules) -> Collected = |conn| collect(conn, rules);
        Write purge(names: &[ChunkName]) -> () = |conn| chunks::purge(conn, names);
        Write lose_chunk(name: ChunkName) -> u64 = |conn| chunks::lose(conn, name);
        Read chunk_rows(after: Option<Digest>, limit: u32) -> Vec<ChunkRow> =
            |conn| chunks::rows(conn, after, limit);
        Read orphans(names: &[ChunkName]) -> Vec<ChunkName> = |conn| chunks::orphans(conn, names);
        Write condemn_orphans(chunks: &[KeptChunk]) -> Vec<ChunkName> =
            |conn| chunks::condemn_orphans(conn, chunks);
        Read usage() -> Usage = |conn| chunks::usage(conn);
        Read stats() -> Stats = |conn| view::stats(conn);
        Commit probe() -> () = |conn| view::probe(conn);
    }

    async fn submit(&self, submission: &Submission) -> Result<Submitted> {
        let plan = plan::check(&submission.plan).await;
        transact!(self, Write, "submit", |conn| bakes::submit(conn, submission, &plan))
    }

    async fn fail(&self, token: &str, blame: Blame, message: &str) -> Result<FailVerdict> {
        transact!(self, Write, "fail", |conn| outcome::fail(conn, token, blame, message, self.rules))
    }

    async fn claim(&self, request: &ClaimRequest) -> Result<Vec<Lease>> {
        if !self.patience.is_wary() {
            let claimed: Result<_> = transact!(self, LeaseBriefly, "claim", |conn| {
                claim::claim(conn, request, Locked::AreWaitedFor)
            });
            match claimed {
                Err(error) if is_long_wait(&error) => self.patience.note_long_wait(),
                claimed => return claimed.map(|claimed| claimed.leases),
            }
        }
        let claimed: Result<claim::Claimed> =
            transact!(self, Lease, "claim", |conn| claim::claim(conn, request, Locked::AreLeft));
        let claimed = claimed?;
        if !claimed.leases.is_empty() || !claimed.has_left {
            return Ok(claimed.leases);
        }
        let _place = self.patience.claim().await;
        let claimed: Result<claim::Claimed> =
            transact!(self, Lease, "claim", |conn| claim::claim(conn, request, Locked::AreWaitedFor));
        Ok(claimed?.leases)
    }

    async fn heartbeat(&self, token: &str, progress: f32) -> Result<HeartbeatAnswer> {
        let kept: Result<_> = transact!(self, Beat, "heartbeat", |conn| leases::keep(conn, token, progress));
        if let Some(expires_ms) = kept? {
            return Ok(HeartbeatAnswer { verdict: Verdict::Keep, expires_ms });
        }
        transact!(self, Lease, "heartbeat", |conn| leases::heartbeat(conn, token, progress))
    }

    async fn commit(&self, token: &str, result: &TaskResult) -> Result<CommitVerdict> {
        let mut verdicts = self.commit_all(&[(token, result)]).await;
        verdicts.pop().unwrap_or(Ok(CommitVerdict::Stale))
    }

    async fn commit_all(&self, commits: &[(&str, &TaskResult)]) -> Vec<Result<CommitVerdict>> {
        // One with a plan is too big to stand in line, and it may be refused: it fails alone.
        let (plain, planned): (Vec<_>, Vec<_>) =
            commits.iter().copied().enumerate().partition(|(_, (_, result))| result.plan.is_empty());
        let lined: Vec<_> = plain.iter().map(|(_, commit)| *commit).collect();
        let verdicts = self.commit_together(&lined).await;
        let mut answers: Vec<_> = plain.into_iter().map(|(index, _)| index).zip(verdicts).collect();
        for (index, (token, result)) in planned {
            answers.push((index, self.commit_planned(token, result).await));
        }
        answers.sort_by_key(|(index, _)| *index);
        answers.into_iter().map(|(_, answer)| answer).collect()
    }

    async fn reap(&self) -> Result<Reaped> {
        // Look first: servers ask every second, and hold all others up for nothing if they lock the farm each time.
        let looked: Result<_> = transact!(self, Read, "look_for_due", |conn| leases::is_any_due(conn));
        if !looked? {
            return Ok(Reaped::default());
        }
        transact!(self, Write, "reap", |conn| outcome::reap(conn, self.rules))
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
