//! The model's farms: 1 to 2,000 workers, on one server and on three, and how many workers each farm feeds.

use std::time::Duration;

use lightkiln_tests::scale::costs::{Costs, Database};
use lightkiln_tests::scale::farm::{FED, Farm, Limit, Outcome};

use super::measured::{POSTGRES, SQLITE};
use super::{number, numbers};
use crate::report::row;

/// Counts of workers, and mean seconds of a task, where the environment does not say.
const WORKERS: &str = "1,10,50,100,200,500,1000,2000";
const MEAN_SECS: &str = "0.2,2,10";
/// Processors of a server, and of the database's machine.
const SERVER_PROCESSORS: usize = 4;
const DATABASE_PROCESSORS: usize = 8;
/// Bakes at a time, tasks in hand of a worker, tasks for each worker, and a message there and back in milliseconds.
const BAKES: usize = 4;
const IN_HAND: usize = 1;
const TASKS_EACH: usize = 12;
const ROUND_TRIP_MS: f64 = 0.2;
/// Most workers that are tried.
const WORKERS_MAX: usize = 20_000;

/// Farms that are told of: name, database, servers.
const FARMS: [(&str, Database, usize); 3] = [
    ("SQLite, one server", Database::Sqlite, 1),
    ("PostgreSQL, one server", Database::Postgres, 1),
    ("PostgreSQL, three servers", Database::Postgres, 3),
];

/// Prints the farms with each mean time.
pub fn measure() {
    for mean_secs in numbers("KILN_BENCH_MEAN_SECS", MEAN_SECS) {
        for (name, database, servers) in FARMS {
            let farm = farm(database, servers, Duration::from_secs_f64(mean_secs));
            let place = format!("{name}, tasks of {mean_secs} s");
            for workers in numbers("KILN_BENCH_WORKERS", WORKERS) {
                row(&format!("{workers} workers"), &place, &words(&outcome(&farm, workers)));
            }
            let fed = fed(&farm);
            let next = outcome(&farm, fed + fed / 5 + 1);
            let rate = outcome(&farm, fed).figures.tasks_per_sec;
            let figure =
                format!("{fed} workers, {rate:.0} tasks a second; {} ends it", name_of(next.limit()));
            row(&format!("fed at {:.0} %", 100.0 * FED), &place, &figure);
        }
    }
}

fn farm(database: Database, servers: usize, mean: Duration) -> Farm {
    let costs: Costs = match database {
        Database::Sqlite => SQLITE,
        Database::Postgres => POSTGRES,
    };
    Farm {
        database,
        costs,
        servers,
        server_processors: number("KILN_BENCH_SERVER_PROCESSORS", SERVER_PROCESSORS),
        database_processors: Some(number("KILN_BENCH_DATABASE_PROCESSORS", DATABASE_PROCESSORS)),
        worker_work: Duration::ZERO,
        elsewhere: 0.0,
        round_trip: Duration::from_secs_f64(number("KILN_BENCH_ROUND_TRIP_MS", ROUND_TRIP_MS) / 1000.0),
        bakes: number("KILN_BENCH_BAKES", BAKES),
        workers: 1,
        in_hand: number("KILN_BENCH_IN_HAND", IN_HAND),
        tasks: 0,
        mean,
        beat: Duration::from_secs(10),
        seed: 0,
    }
}

fn outcome(farm: &Farm, workers: usize) -> Outcome {
    let tasks = (TASKS_EACH * workers * farm.in_hand).max(400);
    Farm { workers, tasks, ..*farm }.run().expect("enough tasks for figures")
}

/// The most workers that are fed, to a fiftieth: more are never better fed.
fn fed(farm: &Farm) -> usize {
    let is_fed = |workers: usize| outcome(farm, workers).figures.efficiency >= FED;
    let (mut fed, mut hungry) = (1, 2);
    while hungry < WORKERS_MAX && is_fed(hungry) {
        (fed, hungry) = (hungry, 2 * hungry);
    }
    while hungry - fed > 1 + fed / 50 {
        let middle = fed.midpoint(hungry);
        if is_fed(middle) { fed = middle } else { hungry = middle }
    }
    fed
}

fn words(outcome: &Outcome) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    format!(
        "{:.1} tasks a second, efficiency {}, tail {:.1} s; servers {}, database {}, lock {}, results {}; claim p99 {:.1} ms; {}",
        outcome.figures.tasks_per_sec,
        percent(outcome.figures.efficiency),
        outcome.figures.tail.as_secs_f64(),
        percent(outcome.server_busy),
        percent(outcome.database_busy),
        percent(outcome.lock_busy),
        percent(outcome.writer_busy),
        outcome.claim_p99.as_secs_f64() * 1000.0,
        name_of(outcome.limit()),
    )
}

fn name_of(limit: Limit) -> &'static str {
    match limit {
        Limit::None => "fed",
        Limit::Server => "the servers' processors",
        Limit::Database => "the database's processors",
        Limit::Lock => "the lock",
        Limit::Writer => "a server's one transaction of results at a time",
        Limit::Connections => "connections to the database",
        Limit::Calls => "the time of calls",
    }
}
