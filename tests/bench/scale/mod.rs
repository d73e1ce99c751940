//! Farms of many workers: costs of calls, runs of real workers whose tasks only take time, and the model of `lightkiln_tests::scale`
//! that is fed with those costs.

mod costs;
mod load;
mod measured;
pub mod meter;
mod model;
mod worker;

pub use costs::measure as measure_costs;
pub use load::measure as measure_load;
pub use model::measure as measure_model;

use std::str::FromStr;

use lightkiln_tests::scale::costs::Database;

use crate::farm::Server;
use crate::parts::postgres::Postgres;
use meter::Meter;

/// Both databases, by name.
const DATABASES: [(&str, Database); 2] = [("SQLite", Database::Sqlite), ("PostgreSQL", Database::Postgres)];

/// A server on a database of its own, and the meter of both.
struct Farm {
    server: Server,
    meter: Meter,
    _postgres: Option<Postgres>,
    _folder: tempfile::TempDir,
}

impl Farm {
    fn start(database: Database) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let postgres = (database == Database::Postgres).then(|| Postgres::start_with(""));
        let url = postgres.as_ref().map(|postgres| postgres.url(None));
        let server = Server::start(folder.path(), url.as_deref());
        let meter = Meter::new(server.process.id(), postgres.as_ref().map(Postgres::port));
        Self { server, meter, _postgres: postgres, _folder: folder }
    }
}

/// A number that a variable of the environment may give.
fn number<T: FromStr>(name: &str, default: T) -> T {
    match std::env::var(name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{name} is '{text}', no such number")),
        Err(_) => default,
    }
}

/// Numbers that a variable of the environment may give, with commas between them.
fn numbers<T: FromStr>(name: &str, default: &str) -> Vec<T> {
    let text = std::env::var(name).unwrap_or_else(|_| default.to_owned());
    text.split(',')
        .map(|part| part.trim().parse().unwrap_or_else(|_| panic!("{name}: no number: '{part}'")))
        .collect()
}
