//! How long long plans take to be taken in, by each database, and the processor time for it: of this process, which is the
//! server here, and of the database's.

use std::sync::Arc;

use lightkiln_server::clock::SystemClock;
use lightkiln_server::store::{FarmStore, SqlStore};

use crate::parts::postgres::Postgres;
use crate::report::{millis, row};
use crate::scale::meter::Meter;
use crate::stores::Run;

/// Tasks of each plan, where `KILN_BENCH_TASKS` names no others.
const PLANS: [usize; 4] = [100_000, 100_000, 100_000, 1_000_000];

/// Measures each database.
pub fn measure() {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("farm.sqlite");
        let sqlite = SqlStore::open_sqlite(&path, Arc::new(SystemClock)).await.unwrap();
        // With its flushes, unlike in tests.
        let server = Postgres::start_with("");
        let postgres = SqlStore::open_postgres(&server.url(None), None).await.unwrap();
        let alone = Meter::new(std::process::id(), None);
        let both = Meter::new(std::process::id(), Some(server.port()));
        for (number, tasks) in wanted().into_iter().enumerate() {
            measure_plan("SQLite", &sqlite, &alone, tasks, number).await;
            measure_plan("PostgreSQL", &postgres, &both, tasks, number).await;
        }
    });
}

/// Tasks of each plan to measure.
fn wanted() -> Vec<usize> {
    let Ok(numbers) = std::env::var("KILN_BENCH_TASKS") else { return PLANS.to_vec() };
    numbers.split(',').map(|number| number.parse().unwrap()).collect()
}

async fn measure_plan(name: &str, store: &dyn FarmStore, meter: &Meter, tasks: usize, number: usize) {
    eprintln!("plans: {tasks} tasks on {name}");
    let run = Run::new(&format!("{name} {tasks} {number}"), tasks - 1);
    let token = run.claim_planner(store).await;
    let result = run.result();
    let before = meter.read();
    let elapsed = Run::commit_plan(store, &token, &result).await;
    let spent = meter.since(&before);
    let figure = format!(
        "{}, of processors {} here and {} in the database's processes",
        millis(elapsed),
        millis(spent.server),
        millis(spent.database)
    );
    row(&format!("plan of {tasks} tasks"), name, &figure);
}
