//! One PostgreSQL server for all tests of the process; each test has a schema of its own.

use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU16, AtomicU32, Ordering};

use sqlx::{Connection, Executor, PgConnection};

use super::keeper::{Keeper, free_port};

/// Argument with which nothing is flushed.
const NO_FLUSH: &str = "-c fsync=off";

/// A running server.
pub struct Postgres {
    port: u16,
    keeper: Keeper,
}

impl Postgres {
    /// Starts a server with an empty database. Nothing is flushed: tests end sessions and servers, not machines.
    pub fn start() -> Self {
        Self::start_with(NO_FLUSH)
    }

    /// Starts one with an empty database, with more arguments.
    pub fn start_with(more: &str) -> Self {
        Self::start_so(more, &[])
    }

    /// The same without flushes, with more variables.
    pub fn start_among(variables: &[(&str, String)]) -> Self {
        Self::start_so(NO_FLUSH, variables)
    }

    fn start_so(more: &str, variables: &[(&str, String)]) -> Self {
        let variables: String = variables.iter().map(|(name, value)| format!("{name}='{value}' ")).collect();
        let programs = programs();
        let programs = programs.display();
        let port = AtomicU16::new(0);
        let script = || {
            port.store(free_port(), Ordering::Relaxed);
            let port = port.load(Ordering::Relaxed);
            format!(
                r#"
                [ -d "$folder/data" ] || "{programs}/initdb" -D "$folder/data" -U kiln -A trust -E UTF8 --locale=C --no-sync >log 2>&1 ||
                    {{ cat log; exit 1; }}
                {variables}"{programs}/postgres" -D "$folder/data" -p {port} -c listen_addresses=127.0.0.1 \
                    -c unix_socket_directories= -c max_connections=400 -c shared_buffers=64MB {more} 2>&1 &
                server=$! stop=QUIT
                "#
            )
        };
        let (keeper, _) = Keeper::start(script, "ready to accept connections", true);
        Self { port: port.into_inner(), keeper }
    }

    /// Its port on 127.0.0.1.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Ends it at once, as a crash would, and starts it again; its sessions and unflushed changes are lost. Nobody
    /// waits until it answers.
    pub fn crash(&self) {
        self.keeper.restart();
    }

    /// The URL of its database, or of a schema of it.
    pub fn url(&self, schema: Option<&str>) -> String {
        let path = schema.map(|schema| format!("?options[search_path]={schema}")).unwrap_or_default();
        format!("postgres://kiln@127.0.0.1:{}/postgres{path}", self.port)
    }
}

/// The process's server, started when first asked for.
pub fn server() -> &'static Postgres {
    static SERVER: OnceLock<Postgres> = OnceLock::new();
    SERVER.get_or_init(Postgres::start)
}

/// The URL of an empty schema.
pub async fn empty_schema() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let schema = format!("farm_{}", COUNT.fetch_add(1, Ordering::Relaxed));
    let mut connection = PgConnection::connect(&server().url(None)).await.unwrap();
    let create = format!("CREATE SCHEMA {schema}");
    connection.execute(sqlx::AssertSqlSafe(create)).await.unwrap();
    connection.close().await.unwrap();
    server().url(Some(&schema))
}

/// The name and the URL of an empty database.
pub async fn empty_database() -> (String, String) {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let name = format!("farm_{}", COUNT.fetch_add(1, Ordering::Relaxed));
    let mut connection = PgConnection::connect(&server().url(None)).await.unwrap();
    connection.execute(sqlx::AssertSqlSafe(format!("CREATE DATABASE {name}"))).await.unwrap();
    connection.close().await.unwrap();
    let url = server().url(None);
    let url = url.strip_suffix("postgres").map(|server| format!("{server}{name}"));
    (name, url.expect("a URL that ends in its database"))
}

/// Folder of `postgres` and `initdb`, which Debian keeps off the PATH.
fn programs() -> PathBuf {
    let versions = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten();
    let mut folders: Vec<PathBuf> = versions.map(|entry| entry.unwrap().path().join("bin")).collect();
    folders.extend(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()));
    folders.retain(|folder| folder.join("postgres").is_file() && folder.join("initdb").is_file());
    folders.sort();
    folders.pop().expect("PostgreSQL's server is not installed; tests/run installs it")
}
