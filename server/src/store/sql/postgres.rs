//! A PostgreSQL database, 15 or newer, that any number of servers share.
//!
//! **Who excludes whom.** Calls that change bakes lock the empty table `turnstile` in EXCLUSIVE mode, claims and
//! heartbeats in ROW SHARE mode, reads not at all:
//!
//! | | change | claim, heartbeat | read |
//! |---|---|---|---|
//! | change (submit, commit, fail, release, reap, cancel, …) | wait | wait | – |
//! | claim, heartbeat | wait | beside each other | – |
//! | read | – | – | – |
//!
//! So there is one change at a time on the whole farm, as on SQLite, and every statement of it sees all changes before
//! it: READ COMMITTED takes a new snapshot for each statement, the first one after the lock was granted. (SERIALIZABLE
//! would take its snapshot before, and fail.) Bakes share tasks, and a commit unlocks the tasks of all of them: an
//! order of row locks that excludes lost wake-ups is hard to keep true, this one is plain. Its cost is small: a
//! change takes a few milliseconds, a task seconds, and the changes that wait in one process share a transaction.
//!
//! **Claims** run beside each other. Each locks the rows of the tasks that it takes with SKIP LOCKED and looks at their
//! state again under the lock; the counts of stages are locked in one order. Claims wait for nothing else of each
//! other, so no two of them can wait in a ring; a change waits only for the turnstile, which it takes first.
//!
//! **Reads** take one REPEATABLE READ snapshot, so that events and the bake beside them belong together.
//!
//! **A server that is stopped in the middle** holds the turnstile until `idle_in_transaction_session_timeout` ends its
//! session; one that dies loses it with its connection. In both cases the transaction never happened.
//!
//! **Time** is the database's: servers' clocks may disagree, and a lease is granted by one server and judged by
//! another. It is read once the lock is granted, so changes and their times have the same order. Tests give a clock.
//!
//! **Flushing.** Claims and heartbeats commit with `synchronous_commit = off`: if the database's machine dies, their
//! leases are lost and the tasks run again. All else is flushed before the caller hears of it.

use std::str::FromStr;
use std::time::Duration;

use sqlx::postgres::{PgConnectOptions, PgConnection, PgDatabaseError, PgPool, PgPoolOptions};
use sqlx::{ConnectOptions, Executor, Row as _};

use super::conn::Tx;
use super::{Class, Kind, too_new};
use crate::store::{Result, StoreError};

/// Connections for changes, claims and heartbeats.
const WRITERS: u32 = 8;
/// Connections for reads, so that they never wait behind changes.
const READERS: u32 = 4;
/// Wait for a free connection before giving up.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(30);
/// Lowest version that is tested.
const VERSION_MIN: i32 = 150_000;
/// Steps of the schema, from one version to the next.
const MIGRATIONS: [&str; 15] = [
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
];

/// Settings of every connection. Shorter timeouts → a server that hangs holds the others up for less, and a slow
/// machine's calls are cut off sooner.
const SESSION: [(&str, &str); 8] = [
    ("idle_in_transaction_session_timeout", "5s"),
    ("lock_timeout", "20s"),
    ("statement_timeout", "60s"),
    ("client_connection_check_interval", "2s"),
    ("tcp_user_timeout", "10s"),
    // Tables grow by thousands of rows within one transaction: no plan made for small ones may scan them all.
    ("enable_seqscan", "off"),
    // Nor may one sort all ready tasks for the sake of the first: there is an index in that order. A claim among 10,000
    // tasks that nobody has analysed yet takes 0.1 ms instead of 30.
    ("enable_sort", "off"),
    ("jit", "off"),
];

/// An open database.
pub(super) struct PostgresDatabase {
    writers: PgPool,
    readers: PgPool,
}

impl PostgresDatabase {
    pub(super) async fn open(url: &str) -> Result<Self> {
        let options = PgConnectOptions::from_str(url)?
            .application_name("lightkiln")
            .options(SESSION)
            .disable_statement_logging();
        migrate(&mut options.connect().await?).await?;
        let writers = pool(WRITERS).connect_with(options.clone()).await?;
        Ok(Self { writers, readers: pool(READERS).connect_with(options).await? })
    }

    /// A transaction, and the database's time, once it has its lock.
    pub(super) async fn begin(&self, kind: Kind) -> Result<(Tx, i64)> {
        // The time comes with the answer to the lock: a round trip less.
        let (pool, begin, lock) = match kind {
            Kind::Read => (
                &self.readers,
                "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY",
                "SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)",
            ),
            Kind::Lease => (
                &self.writers,
                "BEGIN ISOLATION LEVEL READ COMMITTED",
                "SET LOCAL synchronous_commit = off; LOCK TABLE turnstile IN ROW SHARE MODE;
                 SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)",
            ),
            Kind::Write => (
                &self.writers,
                "BEGIN ISOLATION LEVEL READ COMMITTED",
                "LOCK TABLE turnstile IN EXCLUSIVE MODE;
                 SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)",
            ),
        };
        // Begins, then locks. In one step, a caller that goes away while it waits for the lock, or a lock that takes too
        // long, would leave the pool a connection in a transaction that nobody ends: it would hold the lock, or refuse
        // every statement, until the database ended its session.
        let mut tx = pool.begin_with(begin).await?;
        let now_ms = sqlx::raw_sql(lock).fetch_one(&mut *tx).await?.try_get(0)?;
        Ok((Tx::Postgres(tx), now_ms))
    }

    /// Waits for running transactions and closes all connections.
    pub(super) async fn close(&self) {
        self.readers.close().await;
        self.writers.close().await;
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
