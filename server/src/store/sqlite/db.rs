//! Connections, migration, errors and column values.

use std::path::Path;
use std::time::Duration;

use lightkiln_proto::ids::Digest;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{ConnectOptions, SqlitePool};

use super::Conn;
use crate::store::StoreError;

/// Reading connections.
pub(super) const READERS: u32 = 4;
/// Wait for a lock held by another process (a backup, say) before giving up.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Wait for a free connection before giving up.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(30);
/// `user_version` of the schema below.
const SCHEMA_VERSION: i64 = 1;
const SCHEMA: &str = include_str!("schema.sql");
/// Rows that one statement takes in as a JSON array.
pub(super) const ROWS_PER_STATEMENT: usize = 2_000;

/// Opens `connections` connections to the file at `path`.
pub(super) async fn pool(path: &Path, connections: u32, read_only: bool) -> Result<SqlitePool, StoreError> {
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
        .test_before_acquire(false);
    Ok(pool.connect_with(options).await?)
}

/// Brings the file to the schema of this version.
pub(super) async fn migrate(writer: &SqlitePool) -> Result<(), StoreError> {
    let mut tx = writer.begin_with("BEGIN IMMEDIATE").await?;
    let version: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut *tx).await?;
    match version {
        SCHEMA_VERSION => return Ok(()),
        0 => {
            sqlx::raw_sql(SCHEMA).execute(&mut *tx).await?;
            sqlx::raw_sql("PRAGMA user_version = 1").execute(&mut *tx).await?;
        }
        newer => {
            let what = format!(
                "the database has schema version {newer}, this program knows {SCHEMA_VERSION}; use a newer program"
            );
            return Err(StoreError::Corrupt { what, source: None });
        }
    }
    Ok(tx.commit().await?)
}

/// Writes the probe's row.
pub(super) async fn probe(conn: &mut Conn, now_ms: i64) -> Result<(), StoreError> {
    let sql = "INSERT INTO probe VALUES (1, ?) ON CONFLICT (id) DO UPDATE SET at_ms = excluded.at_ms";
    sqlx::query(sql).bind(now_ms).execute(conn).await?;
    Ok(())
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        const BUSY: i32 = 5;
        const LOCKED: i32 = 6;
        const IO: i32 = 10;
        const FULL: i32 = 13;
        let code = error.as_database_error().and_then(|error| error.code()?.parse::<i32>().ok());
        match (code.map(|extended| extended & 0xff), &error) {
            (Some(FULL), _) => Self::Full(error.into()),
            (Some(BUSY | LOCKED | IO), _) => Self::Unavailable(error.into()),
            (_, sqlx::Error::Io(_) | sqlx::Error::PoolTimedOut | sqlx::Error::PoolClosed) => {
                Self::Unavailable(error.into())
            }
            _ => Self::Corrupt { what: "a query failed".into(), source: Some(error.into()) },
        }
    }
}

/// JSON of a value for a column.
pub(super) fn to_json<T: Serialize + ?Sized>(value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| corrupt("a value cannot be written as JSON", error))
}

/// Reads a JSON column.
pub(super) fn from_json<T: DeserializeOwned>(text: &str, column: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| corrupt(&format!("column {column}"), error))
}

/// Reads a digest column.
pub(super) fn digest(text: &str) -> Result<Digest, StoreError> {
    text.parse().map_err(|error| corrupt("a digest", error))
}

/// A stored value that makes no sense.
pub(super) fn corrupt(what: &str, error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> StoreError {
    StoreError::Corrupt { what: what.to_owned(), source: Some(error.into()) }
}

/// A count for a column; counts never come near 2⁶³.
pub(super) fn to_column(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// A count from a column; checks in the schema keep them positive.
pub(super) fn from_column(count: i64) -> u64 {
    u64::try_from(count).unwrap_or(0)
}
