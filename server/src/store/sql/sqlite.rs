//! One SQLite file: WAL, one writing connection in each process that has it open, a few reading ones.
//!
//! Changes are flushed to the disk before their callers hear of them (`synchronous=FULL`). Claims and heartbeats
//! are not: if the machine loses power their leases are lost, and the tasks run again; half of a task's flushes are
//! saved by it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use sqlx::error::DatabaseError as _;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteError, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, SqliteConnection, SqlitePool};

use super::conn::Tx;
use super::{Class, Kind, too_new};
use crate::store::{Result, StoreError};

/// Reading connections.
const READERS: u32 = 4;
/// Wait for a lock held by another process (another bake's, a backup's) before giving up.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Wait for a free connection before giving up.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(30);
/// Steps of the schema, from one `user_version` to the next.
const MIGRATIONS: [&str; 18] = [
    include_str!("schema/sqlite_1.sql"),
    include_str!("schema/sqlite_2.sql"),
    include_str!("schema/sqlite_3.sql"),
    include_str!("schema/sqlite_4.sql"),
    include_str!("schema/sqlite_5.sql"),
    include_str!("schema/sqlite_6.sql"),
    include_str!("schema/sqlite_7.sql"),
    include_str!("schema/sqlite_8.sql"),
    include_str!("schema/sqlite_9.sql"),
    include_str!("schema/sqlite_10.sql"),
    include_str!("schema/sqlite_11.sql"),
    include_str!("schema/sqlite_12.sql"),
    include_str!("schema/sqlite_13.sql"),
    include_str!("schema/sqlite_14.sql"),
    include_str!("schema/sqlite_15.sql"),
    include_str!("schema/sqlite_16.sql"),
    include_str!("schema/sqlite_17.sql"),
    include_str!("schema/sqlite_18.sql"),
];

/// An open file.
pub(super) struct SqliteFile {
    path: PathBuf,
    writer: SqlitePool,
    readers: SqlitePool,
}

impl SqliteFile {
    pub(super) async fn open(path: &Path) -> Result<Self> {
        let writer = pool(path, 1, false).await?;
        migrate(&writer).await?;
        Ok(Self { path: path.to_owned(), writer, readers: pool(path, READERS, true).await? })
    }

    pub(super) async fn begin(&self, kind: Kind) -> Result<Tx> {
        Ok(Tx::Sqlite(match kind {
            Kind::Read => self.readers.begin().await?,
            Kind::Lease | Kind::LeaseBriefly | Kind::Beat => {
                self.writer.begin_with("PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE").await?
            }
            Kind::Commit | Kind::CommitBriefly | Kind::Write => {
                self.writer.begin_with("PRAGMA synchronous = FULL; BEGIN IMMEDIATE").await?
            }
        }))
    }

    /// Errs if the file is damaged. A connection of its own reads it: others believe what they read before.
    pub(super) async fn examine(&self) -> Result<()> {
        let reader = pool(&self.path, 1, true).await?;
        let found = sqlx::query_scalar::<_, String>("PRAGMA quick_check(1)").fetch_one(&reader).await;
        reader.close().await;
        match found?.as_str() {
            "ok" => Ok(()),
            fault => {
                let what = format!("{} is damaged, restore a backup: {fault}", self.path.display());
                Err(StoreError::Corrupt { what, source: None })
            }
        }
    }

    /// Waits for running transactions and closes the file.
    pub(super) async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

async fn pool(path: &Path, connections: u32, read_only: bool) -> Result<SqlitePool> {
    let options = SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(!read_only)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
        .pragma("query_only", if read_only { "on" } else { "off" })
        .pragma("cache_size", "-16384")
        .disable_statement_logging();
    let pool = SqlitePoolOptions::new()
        .max_connections(connections)
        .acquire_timeout(ACQUIRE_TIMEOUT)
        .idle_timeout(None)
        .max_lifetime(None)
        .test_before_acquire(false)
        .after_release(|connection, _| Box::pin(is_out_of_transaction(connection)));
    Ok(pool.connect_with(options).await?)
}

/// Whether a connection may be used again. When there is no room, SQLite may end a transaction by itself, and the driver,
/// whose ROLLBACK is then refused, thinks for ever that it is in one: such a connection is closed.
async fn is_out_of_transaction(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    if connection.is_in_transaction() {
        // Comes after the rollback of a transaction that was dropped.
        connection.ping().await?;
    }
    Ok(!connection.is_in_transaction())
}

/// Whether the file has the schema of this version.
pub(super) async fn is_current(path: &Path) -> Result<bool> {
    let reader = pool(path, 1, true).await?;
    let version: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&reader).await?;
    reader.close().await;
    Ok(usize::try_from(version) == Ok(MIGRATIONS.len()))
}

/// Brings the file to the schema of this version.
async fn migrate(writer: &SqlitePool) -> Result<()> {
    let mut tx = writer.begin_with("BEGIN IMMEDIATE").await?;
    let version: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut *tx).await?;
    let done = usize::try_from(version).ok().filter(|done| *done <= MIGRATIONS.len());
    let Some(done) = done else { return Err(too_new(version, MIGRATIONS.len())) };
    for migration in &MIGRATIONS[done..] {
        sqlx::raw_sql(*migration).execute(&mut *tx).await?;
    }
    let version = format!("PRAGMA user_version = {}", MIGRATIONS.len());
    sqlx::raw_sql(sqlx::AssertSqlSafe(version)).execute(&mut *tx).await?;
    Ok(tx.commit().await?)
}

/// The class of an error of SQLite.
pub(super) fn class_of(error: &SqliteError) -> Class {
    const BUSY: i32 = 5;
    const LOCKED: i32 = 6;
    const IO: i32 = 10;
    const FULL: i32 = 13;
    const CANNOT_OPEN: i32 = 14;
    let code = error.code().and_then(|code| code.parse::<i32>().ok());
    match code.map(|extended| extended & 0xff) {
        Some(FULL) => Class::Full,
        Some(BUSY | LOCKED | IO | CANNOT_OPEN) => Class::Unavailable,
        _ => Class::Broken,
    }
}
