//! A transaction under way, on either database, and the few shapes of query that the farm needs.
//!
//! The transactions are written once, in SQL that both databases read alike; where they differ, [`Conn::pick`] chooses.

use std::sync::Arc;

use sqlx::postgres::{PgConnection, PgCopyIn};
use sqlx::{AssertSqlSafe, ColumnIndex, Postgres, Row as _, Sqlite, Transaction};

use super::Kind;
use super::faults::{FaultPoint, Faults};
use crate::store::{Result, StoreError};

/// A transaction under way. Dropped without [`Conn::commit`], it never happened.
pub(super) struct Conn {
    tx: Tx,
    /// The time by which this transaction lives.
    pub(super) now_ms: i64,
    kind: Kind,
    call: &'static str,
    step: u32,
    faults: Option<Arc<dyn Faults>>,
}

/// The driver's own transaction.
pub(super) enum Tx {
    Sqlite(Transaction<'static, Sqlite>),
    Postgres(Transaction<'static, Postgres>),
}

impl Conn {
    pub(super) fn new(
        tx: Tx,
        kind: Kind,
        now_ms: i64,
        call: &'static str,
        faults: Option<Arc<dyn Faults>>,
    ) -> Self {
        Self { tx, now_ms, kind, call, step: 0, faults }
    }

    /// That of the database at hand.
    pub(super) fn pick<T>(&self, sqlite: T, postgres: T) -> T {
        match self.tx {
            Tx::Sqlite(_) => sqlite,
            Tx::Postgres(_) => postgres,
        }
    }

    /// Whether claims and commits run beside this transaction, and it must keep out of their way.
    pub(super) fn has_neighbours(&self) -> bool {
        matches!(self.tx, Tx::Postgres(_)) && self.kind != Kind::Write
    }

    /// Begins to copy rows into a table, as its text format has them; PostgreSQL alone does.
    pub(super) async fn copy(&mut self, sql: &'static str) -> Result<PgCopyIn<&mut PgConnection>> {
        self.point(sql).await?;
        match &mut self.tx {
            Tx::Sqlite(_) => Err(corrupt("rows are copied into PostgreSQL alone", sql)),
            Tx::Postgres(tx) => Ok(tx.copy_in_raw(sql).await?),
        }
    }

    /// Makes all of it happen.
    pub(super) async fn commit(mut self) -> Result<()> {
        self.point("COMMIT").await?;
        match self.tx {
            Tx::Sqlite(tx) => tx.commit().await?,
            Tx::Postgres(tx) => tx.commit().await?,
        }
        let (call, step) = (self.call, self.step);
        at(self.faults.as_deref(), call, step, "after COMMIT").await
    }

    /// The point between two steps at which tests end the process; nothing else happens here.
    async fn point(&mut self, before: &'static str) -> Result<()> {
        self.step += 1;
        at(self.faults.as_deref(), self.call, self.step, before).await
    }
}

async fn at(faults: Option<&dyn Faults>, call: &'static str, step: u32, before: &'static str) -> Result<()> {
    match faults {
        None => Ok(()),
        Some(faults) => faults.at(FaultPoint { call, step, before }).await,
    }
}

/// A value for a parameter.
#[derive(Clone)]
pub(super) enum Value {
    Int(Option<i64>),
    Real(f64),
    Text(Option<String>),
}

impl Value {
    /// NULL of the same type.
    fn nothing(&self) -> Self {
        match self {
            Self::Int(_) | Self::Real(_) => Self::Int(None),
            Self::Text(_) => Self::Text(None),
        }
    }
}

macro_rules! value_from {
    ($($from:ty, $value:ident => $into:expr;)+) => {
        $(impl From<$from> for Value { fn from($value: $from) -> Self { $into } })+
    };
}

value_from! {
    i64, value => Self::Int(Some(value));
    i32, value => Self::Int(Some(value.into()));
    u32, value => Self::Int(Some(value.into()));
    usize, value => Self::Int(Some(i64::try_from(value).unwrap_or(i64::MAX)));
    u64, value => Self::Int(Some(to_column(value)));
    Option<i64>, value => Self::Int(value);
    f64, value => Self::Real(value);
    String, value => Self::Text(Some(value));
    &str, value => Self::Text(Some(value.to_owned()));
    &String, value => Self::Text(Some(value.clone()));
    Option<String>, value => Self::Text(value);
    &Option<String>, value => Self::Text(value.clone());
}

/// A statement and its parameters.
pub(super) struct Query {
    sql: &'static str,
    values: Vec<Value>,
}

/// A statement with parameters `$1`, `$2`, … still to be bound.
pub(super) fn query(sql: &'static str) -> Query {
    Query { sql, values: Vec::new() }
}

/// Statements without answers that share their parameters, one after the other.
pub(super) struct Steps {
    parts: Vec<&'static str>,
    values: Vec<Value>,
}

/// Statements with parameters `$1`, `$2`, … still to be bound; all share them, and each names those that it needs.
pub(super) fn steps(parts: impl Into<Vec<&'static str>>) -> Steps {
    Steps { parts: parts.into(), values: Vec::new() }
}

/// Statements without answers that share their parameters, none of which reads what another writes.
pub(super) struct Together {
    parts: Vec<&'static str>,
    values: Vec<Value>,
}

/// Statements with parameters `$1`, `$2`, … still to be bound; they may run in any order, and see nothing of each other.
pub(super) fn together(parts: impl Into<Vec<&'static str>>) -> Together {
    Together { parts: parts.into(), values: Vec::new() }
}

/// Whether a statement names parameter `number`.
fn names(sql: &str, number: usize) -> bool {
    let name = format!("${number}");
    let ends = |rest: &str| !rest.starts_with(|next: char| next.is_ascii_digit());
    sql.match_indices(&name).any(|(at, _)| ends(&sql[at + name.len()..]))
}

macro_rules! bound {
    ($database:ty, $sql:expr, $values:expr) => {{
        let mut bound = sqlx::query::<$database>($sql);
        for value in $values {
            bound = match value {
                Value::Int(value) => bound.bind(value),
                Value::Real(value) => bound.bind(value),
                Value::Text(value) => bound.bind(value),
            };
        }
        bound
    }};
}

impl Query {
    pub(super) fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// Runs it for its effect; returns how many rows it touched.
    pub(super) async fn run(self, conn: &mut Conn) -> Result<u64> {
        conn.point(self.sql).await?;
        Ok(match &mut conn.tx {
            Tx::Sqlite(tx) => bound!(Sqlite, self.sql, self.values).execute(&mut **tx).await?.rows_affected(),
            Tx::Postgres(tx) => {
                bound!(Postgres, self.sql, self.values).execute(&mut **tx).await?.rows_affected()
            }
        })
    }

    /// All rows.
    pub(super) async fn all(self, conn: &mut Conn) -> Result<Vec<Row>> {
        conn.point(self.sql).await?;
        Ok(match &mut conn.tx {
            Tx::Sqlite(tx) => {
                let rows = bound!(Sqlite, self.sql, self.values).fetch_all(&mut **tx).await?;
                rows.into_iter().map(Row::Sqlite).collect()
            }
            Tx::Postgres(tx) => {
                let rows = bound!(Postgres, self.sql, self.values).fetch_all(&mut **tx).await?;
                rows.into_iter().map(Row::Postgres).collect()
            }
        })
    }

    /// The first row, if there is one.
    pub(super) async fn optional(self, conn: &mut Conn) -> Result<Option<Row>> {
        Ok(self.all(conn).await?.into_iter().next())
    }

    /// The one row, which must be there.
    pub(super) async fn one(self, conn: &mut Conn) -> Result<Row> {
        let sql = self.sql;
        self.optional(conn).await?.ok_or_else(|| corrupt("a row is missing", sql))
    }
}

impl Steps {
    pub(super) fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// Runs them; returns how many rows they touched together. SQLite takes them in one piece: most of a small
    /// statement's time there is the way to its thread and back.
    pub(super) async fn run(self, conn: &mut Conn) -> Result<u64> {
        let mut touched = 0;
        for &sql in &self.parts {
            conn.point(sql).await?;
            if let Tx::Postgres(tx) = &mut conn.tx {
                // Values that a statement does not name need not travel: a plan may be long.
                let of_part = |(number, value): (usize, &Value)| {
                    if names(sql, number) { value.clone() } else { value.nothing() }
                };
                let bound = bound!(Postgres, sql, (1..).zip(&self.values).map(of_part));
                touched += bound.execute(&mut **tx).await?.rows_affected();
            }
        }
        if let Tx::Sqlite(tx) = &mut conn.tx {
            // Made of nothing but statements of this program.
            let sql = AssertSqlSafe(self.parts.join(";"));
            touched = bound!(Sqlite, sql, self.values).execute(&mut **tx).await?.rows_affected();
        }
        Ok(touched)
    }
}

impl Together {
    pub(super) fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// Runs them, in one piece on either database: PostgreSQL takes them as the parts of one statement.
    pub(super) async fn run(self, conn: &mut Conn) -> Result<()> {
        let Some(first) = self.parts.first().copied() else { return Ok(()) };
        conn.point(first).await?;
        // Made of nothing but statements of this program.
        match &mut conn.tx {
            Tx::Sqlite(tx) => {
                let sql = AssertSqlSafe(self.parts.join(";"));
                bound!(Sqlite, sql, self.values).execute(&mut **tx).await?;
            }
            Tx::Postgres(tx) => {
                let parts = (1..).zip(&self.parts).map(|(number, sql)| format!("part_{number} AS ({sql})"));
                let parts: Vec<String> = parts.collect();
                let sql = AssertSqlSafe(format!("WITH {} SELECT 1", parts.join(", ")));
                bound!(Postgres, sql, self.values).execute(&mut **tx).await?;
            }
        }
        Ok(())
    }
}

/// A row of an answer.
pub(super) enum Row {
    Sqlite(sqlx::sqlite::SqliteRow),
    Postgres(sqlx::postgres::PgRow),
}

/// A value that both databases give.
pub(super) trait Column:
    sqlx::Type<Sqlite>
    + sqlx::Type<Postgres>
    + for<'r> sqlx::Decode<'r, Sqlite>
    + for<'r> sqlx::Decode<'r, Postgres>
{
}

impl<T> Column for T where
    T: sqlx::Type<Sqlite>
        + sqlx::Type<Postgres>
        + for<'r> sqlx::Decode<'r, Sqlite>
        + for<'r> sqlx::Decode<'r, Postgres>
{
}

impl Row {
    /// The column of that name or number.
    pub(super) fn get<T: Column>(
        &self,
        column: impl ColumnIndex<sqlx::sqlite::SqliteRow> + ColumnIndex<sqlx::postgres::PgRow>,
    ) -> Result<T> {
        Ok(match self {
            Self::Sqlite(row) => row.try_get(column)?,
            Self::Postgres(row) => row.try_get(column)?,
        })
    }

    /// A text column.
    pub(super) fn text(&self, column: &str) -> Result<String> {
        self.get(column)
    }

    /// A count; checks in the schema keep them from being negative.
    pub(super) fn count(&self, column: &str) -> Result<u64> {
        Ok(u64::try_from(self.get::<i64>(column)?).unwrap_or(0))
    }

    /// A count of 32 bits.
    pub(super) fn small(&self, column: &str) -> Result<u32> {
        Ok(u32::try_from(self.count(column)?).unwrap_or(u32::MAX))
    }
}

/// A count for a column; counts never come near 2⁶³.
pub(super) fn to_column(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// A stored value that makes no sense.
pub(super) fn corrupt(what: &str, error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> StoreError {
    StoreError::Corrupt { what: what.to_owned(), source: Some(error.into()) }
}

#[cfg(test)]
mod tests {
    use super::names;

    #[test]
    fn parameter_is_named_by_its_whole_number() {
        let sql = "UPDATE t SET a = $12, b = $3 WHERE c = $12";
        assert_eq!([1, 2, 3, 12, 123].map(|number| names(sql, number)), [false, false, true, true, false]);
    }
}
