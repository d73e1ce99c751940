//! A look into the farm's database, past all doors.

use sqlx::{Connection, Executor, PgConnection, Row};
use tokio::runtime::Runtime;

use super::super::parts::postgres::Postgres;
use super::Patience;

/// A PostgreSQL server of the test's own, as it is ended now and then.
pub struct Database {
    server: Postgres,
    runtime: Runtime,
}

impl Database {
    pub fn start() -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        Self { server: Postgres::start(), runtime }
    }

    pub fn port(&self) -> u16 {
        self.server.port()
    }

    /// Its URL by way of another port.
    pub fn url_at(&self, port: u16) -> String {
        self.server.url(None).replace(&format!(":{}/", self.port()), &format!(":{port}/"))
    }

    /// Ends it at once, and waits until it serves again.
    pub fn crash(&self) {
        let sql = "SELECT (extract(epoch FROM pg_postmaster_start_time()) * 1000000)::bigint";
        let before = self.number(sql);
        self.server.crash();
        Patience::new().until("restart of PostgreSQL", || self.number(sql) != before);
    }

    /// Ends all sessions but this one; returns how many.
    pub fn end_sessions(&self) -> i64 {
        let sql = "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity
                   WHERE pid <> pg_backend_pid() AND backend_type = 'client backend'";
        self.number(sql)
    }

    /// The one number that a query gives.
    pub fn number(&self, sql: &'static str) -> i64 {
        self.rows(sql, |row| row.get(0))[0]
    }

    /// The first column of each row.
    pub fn texts(&self, sql: &'static str) -> Vec<String> {
        self.rows(sql, |row| row.get(0))
    }

    fn rows<T>(&self, sql: &'static str, read: impl Fn(&sqlx::postgres::PgRow) -> T) -> Vec<T> {
        let patience = Patience::new();
        loop {
            let asked = self.runtime.block_on(async {
                let mut connection = PgConnection::connect(&self.server.url(None)).await?;
                let rows = connection.fetch_all(sql).await?;
                connection.close().await?;
                Ok::<_, sqlx::Error>(rows)
            });
            match asked {
                Ok(rows) => return rows.iter().map(&read).collect(),
                Err(error) => patience.again(&format!("answer to {sql}: {error}")),
            }
        }
    }
}
