//! A PostgreSQL database, 15 or newer, that any number of servers share.
//!
//! **Who excludes whom.** Three kinds of transactions change something. A *change of the farm* (submission, failure, release,
//! reaping, cancelling, forgetting, deleting, …) locks the empty table `turnstile` in EXCLUSIVE mode: it runs alone. A
//! *commit* and a *claim* (with them uploads) lock it in ROW SHARE mode, so that they run beside each other, and lock the rows that
//! they change. A *heartbeat* locks its lease alone, and only if nobody else has; unless the lease has ended. Reads lock nothing.
//!
//! | | change of the farm | commit | claim, upload | heartbeat | read |
//! |---|---|---|---|---|---|
//! | change of the farm | wait | wait | wait | by lease | – |
//! | commit | wait | by bake | by bake | by lease | – |
//! | claim, upload | wait | by bake | by bake | – | – |
//! | heartbeat | – | – | – | – | – |
//! | read | – | – | – | – | – |
//!
//! Every statement sees all changes before it: READ COMMITTED takes a new snapshot for each, the first one after the lock
//! was granted. (SERIALIZABLE would take its snapshot before, and fail.)
//!
//! **What the lock of a bake's row guards**, for whoever holds it beside others: its counts, counters and stages; the
//! numbers of its events and the places of its results, which so have neither gaps nor twins, and are seen in order; its
//! ready rows. Bakes share tasks, so a commit locks all live bakes that hold its tasks. That is enough, as
//! - the bakes that hold a task change in changes of the farm alone, or are joined by one that only the adding transaction
//!   sees: a plan that names a task which the farm has is taken in by a change of the farm. So nobody joins a task
//!   while it is committed;
//! - a bake that holds a task holds all that it depends on: two commits that unlock one dependant share its bakes, and so
//!   its wake-up is not lost. Readers of an artefact that is made again are the exception, and such a commit is a change of
//!   the farm;
//! - a task is dropped in a change of the farm alone, and so is any bake ended otherwise than by its last commit;
//! - a task that is ready or waiting has no lease, so that commits and claims never want the same task.
//!
//! **Order of locks**: turnstile, the claiming worker, leases by token with their tasks, ready tasks (never waited for: SKIP
//! LOCKED; nor are workers that were heard), bakes by number, chunks by digest, waiting tasks, keys of new ones. A commit locks its own
//! tasks before its bakes. A heartbeat waits for nobody.
//! Reruns: a claim that took no task locks one (SKIP LOCKED), and who ends one counts it last of all, in the farm's totals.
//! Nobody takes one after a later one that another may hold, so none wait in a ring; if one should, the database ends it, and
//! the call is run again. Counts of the whole farm are kept in a part for each session, which waits for nobody.
//!
//! **Two plans with one new key** at the same time: the index on keys lets one of them wait for the other and then refuses
//! it; it is run again, finds the task, and becomes a change of the farm.
//!
//! **Claims** lock the rows of the tasks that they take with SKIP LOCKED and look at their state again under the lock; rows of tasks that a
//! claim looked at and did not take are let go. Shares of bakes are weighed before their rows are locked: claims at the same moment may
//! give one bake a task more than its share.
//!
//! **Reads** take one REPEATABLE READ snapshot, so that events and the bake beside them belong together.
//!
//! **Bakes that are locked for long** hold up their own callers: [`patience`](super::patience) says how the others pass them.
//!
//! **A server that is stopped in the middle** holds its locks until `idle_in_transaction_session_timeout` ends its
//! session, later in the middle of a long plan ([`take_time`](super::bulk::take_time)); one that dies loses them with its
//! connection. In both cases the transaction never happened.
//!
//! **Time** is the database's: servers' clocks may disagree, and a lease is granted by one server and judged by
//! another. It is read once the turnstile is passed. Tests give a clock.
//!
//! **Flushing.** Claims and heartbeats commit with `synchronous_commit = off`: if the database's machine dies, their
//! leases are lost and the tasks run again. All else is flushed before the caller hears of it.

use std::str::FromStr;
use std::time::Duration;

use sqlx::postgres::{PgConnectOptions, PgConnection, PgDatabaseError, PgPool, PgPoolOptions};
use sqlx::{ConnectOptions, Executor, Row as _};

use super::conn::Tx;
use super::patience::is_long_wait;
use super::{Class, Kind, too_new};
use crate::store::{Result, StoreError};

/// Connections for changes and claims.
const WRITERS: u32 = 8;
/// Connections for heartbeats: no lease runs out while claims, commits and changes of the farm wait for each other.
const BEATS: u32 = 2;
/// Connections for reads, so that they never wait behind changes.
const READERS: u32 = 4;
/// Wait for a free connection before giving up.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(30);
/// Most times that a step of the schema is tried.
const MIGRATION_TRIES: u32 = 10;
/// Lowest version that is tested.
const VERSION_MIN: i32 = 150_000;
/// Steps of the schema, from one version to the next.
const MIGRATIONS: [&str; 19] = [
    include_str!("schema/postgres_1.sql"),
    include_str!("schema/postgres_2.sql"),
    include_str!("schema/postgres_3.sql"),
    include_str!("schema/postgres_4.sql"),
    include_str!("schema/postgres_5.sql"),
    include_str!("schema/postgres_6.sql"),
    include_str!("schema/postgres_7.sql"),
    include_str!("schema/postgres_8.sql"),
    include_str!("schema/postgres_9.sql"),
    include_str!("schema/postgres_10.sql"),
    include_str!("schema/postgres_11.sql"),
    include_str!("schema/postgres_12.sql"),
    include_str!("schema/postgres_13.sql"),
    include_str!("schema/postgres_14.sql"),
    include_str!("schema/postgres_15.sql"),
    include_str!("schema/postgres_16.sql"),
    include_str!("schema/postgres_17.sql"),
    include_str!("schema/postgres_18.sql"),
    include_str!("schema/postgres_19.sql"),
];

/// Settings of every connection. Shorter timeouts → a server that hangs holds the others up for less, and a slow
/// machine's calls are cut off sooner.
const SESSION: [(&str, &str); 12] = [
    ("idle_in_transaction_session_timeout", "5s"),
    ("lock_timeout", "20s"),
    ("statement_timeout", "60s"),
    ("client_connection_check_interval", "2s"),
    ("tcp_user_timeout", "10s"),
    // One plan for each statement, whatever its values and however old the statistics: a walk of indexes in nested loops,
    // driven by the short list that it was given. Tables grow by thousands of rows within one transaction, and a plan
    // made for small ones, or for the rows that a list seems to have, may read all of a bake's ready tasks for the first.
    ("plan_cache_mode", "force_generic_plan"),
    ("enable_seqscan", "off"),
    // Nor may one sort all ready tasks for the sake of the first, as it may where the table was empty when it was analysed.
    ("enable_sort", "off"),
    ("enable_bitmapscan", "off"),
    ("enable_hashjoin", "off"),
    ("enable_mergejoin", "off"),
    ("jit", "off"),
];

const CHANGE: &str = "BEGIN ISOLATION LEVEL READ COMMITTED";

/// Waits for rows that are locked a moment only. Longer → a bake that is locked for long holds others up for longer; shorter → calls
/// in line for a busy bake lose their places.
macro_rules! brief {
    () => {
        "SET LOCAL lock_timeout = '100ms';"
    };
}

/// The database's time, after some statements.
macro_rules! clock {
    ($($before:expr),*) => {
        concat!($($before,)* "SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)")
    };
}

/// An open database.
pub(super) struct PostgresDatabase {
    writers: PgPool,
    beats: PgPool,
    readers: PgPool,
}

impl PostgresDatabase {
    pub(super) async fn open(url: &str) -> Result<Self> {
        let options = PgConnectOptions::from_str(url)?
            .application_name("lightkiln")
            .options(SESSION)
            .disable_statement_logging();
        let mut tries = 1;
        // Servers of a former version may be at work, and read tables in another order than a step changes them.
        while let Err(error) = migrate(&mut options.connect().await?).await {
            let passes = matches!(error, StoreError::Contended(_)) || is_long_wait(&error);
            if !passes || tries == MIGRATION_TRIES {
                return Err(error);
            }
            tracing::warn!(%error, "the database's schema could not be changed yet; trying again");
            tries += 1;
        }
        let writers = pool(WRITERS).connect_with(options.clone()).await?;
        let beats = pool(BEATS).connect_with(options.clone()).await?;
        Ok(Self { writers, beats, readers: pool(READERS).connect_with(options).await? })
    }

    /// A transaction, and the database's time, once it has its lock.
    pub(super) async fn begin(&self, kind: Kind) -> Result<(Tx, i64)> {
        // The time comes with the answer to the lock: a round trip less.
        let (pool, begin, lock) = match kind {
            Kind::Read => (&self.readers, "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY", clock!()),
            Kind::Beat => (&self.beats, CHANGE, clock!("SET LOCAL synchronous_commit = off;")),
            Kind::Lease => (
                &self.writers,
                CHANGE,
                clock!("SET LOCAL synchronous_commit = off; LOCK TABLE turnstile IN ROW SHARE MODE;"),
            ),
            Kind::LeaseBriefly => (
                &self.writers,
                CHANGE,
                clock!(
                    "SET LOCAL synchronous_commit = off; LOCK TABLE turnstile IN ROW SHARE MODE;",
                    brief!()
                ),
            ),
            Kind::Commit => (&self.writers, CHANGE, clock!("LOCK TABLE turnstile IN ROW SHARE MODE;")),
            Kind::CommitBriefly => {
                (&self.writers, CHANGE, clock!("LOCK TABLE turnstile IN ROW SHARE MODE;", brief!()))
            }
            Kind::Write => (&self.writers, CHANGE, clock!("LOCK TABLE turnstile IN EXCLUSIVE MODE;")),
        };
        // Begins, then locks. In one step, a caller that goes away while it waits for the lock, or a lock that takes too
        // long, would leave the pool a connection in a transaction that nobody ends: it would hold the lock, or refuse
        // every statement, until the database ended its session.
        let mut tx = pool.begin_with(begin).await?;
        let locked = sqlx::raw_sql(lock).fetch_one(&mut *tx).await;
        let now_ms = locked.map_err(no_lock)?.try_get(0)?;
        Ok((Tx::Postgres(tx), now_ms))
    }

    /// Waits for running transactions and closes all connections.
    pub(super) async fn close(&self) {
        self.readers.close().await;
        self.beats.close().await;
        self.writers.close().await;
    }
}

/// The error of a call that did not get the farm's lock; one that waited too long for a row is of another kind.
fn no_lock(error: sqlx::Error) -> StoreError {
    match &error {
        sqlx::Error::Database(database) if database.code().is_some_and(|code| code == "55P03") => {
            StoreError::Unavailable(format!("the farm's lock was not free in time: {error}").into())
        }
        _ => error.into(),
    }
}

fn pool(connections: u32) -> PgPoolOptions {
    PgPoolOptions::new()
        .max_connections(connections)
        .acquire_timeout(ACQUIRE_TIMEOUT)
        // A connection that died is noticed by the first statement, and the call tried again on another.
        .test_before_acquire(false)
        .after_connect(|connection, _| Box::pin(require_primary(connection)))
}

/// Refuses a standby: it would answer reads with stale rows. After a failover the old primary's
/// connections die, and new ones come through here.
async fn require_primary(connection: &mut PgConnection) -> Result<(), sqlx::Error> {
    let standby: bool = sqlx::query_scalar("SELECT pg_is_in_recovery()").fetch_one(connection).await?;
    if standby {
        let what = "the database is a standby; give the address of the primary";
        return Err(sqlx::Error::Io(std::io::Error::other(what)));
    }
    Ok(())
}

/// Brings the database to the schema of this version; servers that start together do so one after the other.
async fn migrate(connection: &mut PgConnection) -> Result<()> {
    require_primary(connection).await?;
    let version: i32 = sqlx::query_scalar("SELECT current_setting('server_version_num')::int")
        .fetch_one(&mut *connection)
        .await?;
    if version < VERSION_MIN {
        let what = format!("PostgreSQL {} is too old; use 15 or newer", version / 10_000);
        return Err(StoreError::Corrupt { what, source: None });
    }
    let mut tx = sqlx::Connection::begin(connection).await?;
    // Any number will do, as long as all versions of this program take the same.
    tx.execute("SELECT pg_advisory_xact_lock(7410741074107410)").await?;
    tx.execute("CREATE TABLE IF NOT EXISTS schema_version (version BIGINT NOT NULL)").await?;
    let found: Option<i64> =
        sqlx::query_scalar("SELECT max(version) FROM schema_version").fetch_one(&mut *tx).await?;
    let version = found.unwrap_or(0);
    let done = usize::try_from(version).ok().filter(|done| *done <= MIGRATIONS.len());
    let Some(done) = done else { return Err(too_new(version, MIGRATIONS.len())) };
    for (index, migration) in MIGRATIONS.iter().enumerate().skip(done) {
        sqlx::raw_sql(*migration).execute(&mut *tx).await?;
        let version = i64::try_from(index + 1).unwrap_or(i64::MAX);
        sqlx::query("INSERT INTO schema_version (version) VALUES ($1)")
            .bind(version)
            .execute(&mut *tx)
            .await?;
    }
    Ok(tx.commit().await?)
}

/// The class of an error of PostgreSQL, by its SQLSTATE.
pub(super) fn class_of(error: &PgDatabaseError) -> Class {
    match error.code() {
        // Serialization failure, deadlock.
        "40001" | "40P01" => Class::Contended,
        // A task that another plan made at the same time. No other row is made by two at once.
        "23505" if error.constraint() == Some("tasks_key_key") => Class::Contended,
        // The disk is full.
        "53100" => Class::Full,
        // A standby; timeouts of transactions, locks and statements.
        "25006" | "25P03" | "55P03" | "57014" => Class::Unavailable,
        // No connection, wrong password, no such database, no resources, ended from outside, system errors.
        code if ["08", "28", "3D", "53", "57", "58"].iter().any(|class| code.starts_with(class)) => {
            Class::Unavailable
        }
        _ => Class::Broken,
    }
}
