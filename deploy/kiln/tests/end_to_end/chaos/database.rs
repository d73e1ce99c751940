//! A look into the farm's database, past all doors.

use std::path::PathBuf;

use sqlx::{
    Connection, Decode, Executor, PgConnection, Postgres as PostgresRows, Row, Sqlite, SqliteConnection, Type,
};
use tokio::runtime::Runtime;

use super::super::parts::postgres::Postgres;
use super::Patience;
use super::clocks::Clock;

/// The database of a farm of the test's own.
pub struct Database {
    kind: Kind,
    runtime: Runtime,
}

enum Kind {
    /// A server, which is ended now and then, with a clock of its own.
    Postgres { server: Box<Postgres>, clock: Clock },
    /// A file of the farm's only server.
    Sqlite { file: PathBuf },
}

impl Database {
    pub fn postgres() -> Self {
        let clock = Clock::new();
        let server = Box::new(Postgres::start_among(&clock.variables()));
        Self::new(Kind::Postgres { server, clock })
    }

    pub fn sqlite(file: PathBuf) -> Self {
        Self::new(Kind::Sqlite { file })
    }

    fn new(kind: Kind) -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        Self { kind, runtime }
    }

    /// The server's port and clock, if it is one.
    pub fn server(&self) -> Option<(u16, &Clock)> {
        match &self.kind {
            Kind::Postgres { server, clock } => Some((server.port(), clock)),
            Kind::Sqlite { .. } => None,
        }
    }

    /// Its URL; that of a server by way of a port.
    pub fn url_at(&self, port: u16) -> String {
        match &self.kind {
            Kind::Postgres { server, .. } => {
                server.url(None).replace(&format!(":{}/", server.port()), &format!(":{port}/"))
            }
            Kind::Sqlite { file } => format!("sqlite:{}", file.display()),
        }
    }

    /// Ends a server at once, and waits until it serves again.
    pub fn crash(&self) {
        let Kind::Postgres { server, .. } = &self.kind else { return };
        let sql = "SELECT (extract(epoch FROM pg_postmaster_start_time()) * 1000000)::bigint";
        let before = self.number(sql);
        server.crash();
        Patience::new().until("restart of PostgreSQL", || self.number(sql) != before);
    }

    /// Ends all sessions of a server but this one; returns how many.
    pub fn end_sessions(&self) -> i64 {
        let sql = "SELECT count(pg_terminate_backend(pid)) FROM pg_stat_activity
                   WHERE pid <> pg_backend_pid() AND backend_type = 'client backend'";
        self.number(sql)
    }

    /// The one number that a query gives.
    pub fn number(&self, sql: &'static str) -> i64 {
        self.first_column(sql)[0]
    }

    /// The first column of each row.
    pub fn texts(&self, sql: &'static str) -> Vec<String> {
        self.first_column(sql)
    }

    fn first_column<T>(&self, sql: &'static str) -> Vec<T>
    where
        T: for<'r> Decode<'r, PostgresRows> + Type<PostgresRows> + for<'r> Decode<'r, Sqlite> + Type<Sqlite>,
    {
        let patience = Patience::new();
        loop {
            match self.runtime.block_on(self.ask(sql)) {
                Ok(column) => return column,
                Err(error) => patience.again(&format!("answer to {sql}: {error}")),
            }
        }
    }

    async fn ask<T>(&self, sql: &'static str) -> sqlx::Result<Vec<T>>
    where
        T: for<'r> Decode<'r, PostgresRows> + Type<PostgresRows> + for<'r> Decode<'r, Sqlite> + Type<Sqlite>,
    {
        match &self.kind {
            Kind::Postgres { server, .. } => {
                let mut connection = PgConnection::connect(&server.url(None)).await?;
                let rows = connection.fetch_all(sql).await?;
                connection.close().await?;
                rows.iter().map(|row| row.try_get(0)).collect()
            }
            Kind::Sqlite { file } => {
                let mut connection = SqliteConnection::connect(&format!("sqlite:{}", file.display())).await?;
                let rows = connection.fetch_all(sql).await?;
                connection.close().await?;
                rows.iter().map(|row| row.try_get(0)).collect()
            }
        }
    }
}
