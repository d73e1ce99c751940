//! With a full queue: how long a submission takes, and what a task costs the server from claim to commit.

use std::time::{Duration, Instant};

use crate::calls::Caller;
use crate::farm::Server;
use crate::parts::postgres::Postgres;
use crate::report::{quantiles, row};

/// Tasks that are ready all the while.
const QUEUED: usize = 10_000;
/// Submissions that are timed.
const SUBMISSIONS: usize = 300;
/// Tasks that are run, with an upload each.
const TASKS: u32 = 1_500;

/// Measures both databases.
pub fn measure() {
    measure_on("SQLite", None);
    let postgres = Postgres::start_with("");
    measure_on("PostgreSQL", Some(&postgres.url(None)));
}

fn measure_on(name: &str, database: Option<&str>) {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path(), database);
    let caller = Caller::new(&server.url);
    caller.fill(QUEUED + TASKS as usize);
    let scene = caller.put("scenes", b"another scene");
    let mut submissions: Vec<Duration> = (0..SUBMISSIONS)
        .map(|index| {
            let started = Instant::now();
            caller.submit(scene, index);
            started.elapsed()
        })
        .collect();
    let place = format!("{name}, over HTTP");
    row(&format!("submission with {QUEUED} queued tasks"), &place, &quantiles(&mut submissions));

    let mut vain: Vec<Duration> = (0..SUBMISSIONS)
        .map(|_| {
            let started = Instant::now();
            assert!(caller.claim("other", &["bench.other"]).is_none());
            started.elapsed()
        })
        .collect();
    row(&format!("claim in vain, {QUEUED} queued tasks of another kind"), &place, &quantiles(&mut vain));

    let (mut claims, mut rounds) = (Vec::new(), Vec::new());
    let before = server.process.cpu();
    for index in 0..TASKS {
        let started = Instant::now();
        let token = caller.claim("w", &["bench.work"]).unwrap();
        claims.push(started.elapsed());
        caller.commit(&token, &index.to_le_bytes(), serde_json::json!([]));
        rounds.push(started.elapsed());
    }
    let cpu_ms = (server.process.cpu() - before).as_secs_f64() * 1000.0 / f64::from(TASKS);
    row(&format!("claim with {QUEUED} queued tasks"), &place, &quantiles(&mut claims));
    row("claim, upload of 4 bytes and commit", &place, &quantiles(&mut rounds));
    let figure = format!("{cpu_ms:.2} ms of the server's processor time");
    row("the queue's cost of a task: claim, upload, commit", &place, &figure);
}
