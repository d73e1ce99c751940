//! Processor time of each call, of the server and of the database's processes, as one caller makes it many times.

use std::io::{Seek as _, Write as _};
use std::time::{Duration, Instant};

use lightkiln_tests::scale::costs::{Call, Costs, Database};
use serde_json::json;

use super::meter::Meter;
use super::{DATABASES, Farm, number};
use crate::calls::Caller;
use crate::report::{quantile, row};

/// Calls of each kind. More → less noise of the clock, which counts hundredths of a second.
const CALLS: usize = 600;
/// Calls for many leases or results at once, and how many each has.
const BATCHES: usize = 20;
const BATCH: usize = 32;
/// Kind of the tasks.
const KIND: &str = "bench.work";

/// Measures both databases, and prints the table that `measured.rs` holds.
pub fn measure() {
    for (name, database) in DATABASES {
        let costs = costs_on(database);
        let (server, of_database) = costs.of_task();
        let ms = |time: Duration| format!("{:.2} ms", time.as_secs_f64() * 1000.0);
        row(
            "processor time of a task, the server's and the database's",
            name,
            &format!("{}, {}", ms(server), ms(of_database)),
        );
        let calls = [
            ("claim of a task", costs.claim),
            ("each further lease of a claim", costs.lease),
            ("heartbeat", costs.heartbeat),
            ("question for a chunk", costs.look),
            ("upload of 64 bytes", costs.upload),
            ("commit of a result", costs.commit),
            ("each further result of a commit", costs.result),
        ];
        for (what, call) in calls {
            let figure = format!(
                "{:.2} ms, {:.2} ms, {:.1} waits for the database",
                call.server_ms, call.database_ms, call.trips
            );
            row(what, name, &figure);
        }
        row(
            "HTTP alone; flush of the disk",
            name,
            &format!("{:.2} ms; {:.2} ms", costs.http_ms, costs.flush_ms),
        );
        eprintln!("{costs:.3?}");
    }
}

/// Costs of calls on a server of this machine.
pub fn costs_on(database: Database) -> Costs {
    let calls = number("KILN_BENCH_CALLS", CALLS);
    let farm = Farm::start(database);
    let caller = Caller::new(&farm.server.url);
    caller.fill(calls + BATCHES * BATCH + BATCH);
    let bench = Bench { meter: &farm.meter };
    // Warm both: statements are planned once, and files grow.
    let warm = caller.claim_many("warm", KIND, BATCH);
    commit_all(&caller, &warm, "warm");

    let http = bench.each(10 * calls, |_| {
        caller.get("/healthz");
    });
    let mut tokens = Vec::new();
    let claim = bench.each(calls, |_| tokens.push(caller.claim("w", &[KIND]).unwrap()));
    let heartbeat = bench.each(calls, |call| {
        caller.post(&format!("/v1/leases/{}/heartbeat", tokens[call]), &json!({ "progress": 0.0 }));
    });
    let outputs: Vec<[u8; 64]> = (0..calls).map(|call| output("one", call)).collect();
    let look = bench.each(calls, |call| assert!(!caller.has("chunks", &outputs[call])));
    let upload = bench.each(calls, |call| {
        caller.put("chunks", &outputs[call]);
    });
    let commit = bench.each(calls, |call| caller.commit_stored(&[(&tokens[call], &outputs[call])]));
    let mut held = Vec::new();
    let claims = bench.each(BATCHES, |_| held.push(caller.claim_many("w", KIND, BATCH)));
    let stored: Vec<Vec<[u8; 64]>> = (0..BATCHES)
        .map(|batch| (0..BATCH).map(|index| output("many", batch * BATCH + index)).collect())
        .collect();
    stored.iter().flatten().for_each(|output| {
        caller.put("chunks", output);
    });
    let commits = bench.each(BATCHES, |batch| {
        let results: Vec<_> =
            held[batch].iter().map(String::as_str).zip(&stored[batch]).map(|(t, o)| (t, &o[..])).collect();
        caller.commit_stored(&results);
    });
    Costs {
        http_ms: http.server_ms,
        claim,
        lease: each_further(claim, claims),
        heartbeat,
        look,
        upload,
        commit,
        result: each_further(commit, commits),
        flush_ms: flush_ms(),
    }
}

struct Bench<'a> {
    meter: &'a Meter,
}

impl Bench<'_> {
    /// The mean cost of a call that is made so many times.
    fn each(&self, count: usize, mut call: impl FnMut(usize)) -> Call {
        let before = self.meter.read();
        (0..count).for_each(&mut call);
        let spent = self.meter.since(&before);
        let ms = |time: Duration| time.as_secs_f64() * 1000.0 / count as f64;
        Call {
            server_ms: ms(spent.server),
            database_ms: ms(spent.database),
            trips: spent.trips as f64 / count as f64,
        }
    }
}

/// Cost of each but the first in a batch.
fn each_further(one: Call, batch: Call) -> Call {
    let part = |one: f64, batch: f64| ((batch - one) / (BATCH - 1) as f64).max(0.0);
    Call {
        server_ms: part(one.server_ms, batch.server_ms),
        database_ms: part(one.database_ms, batch.database_ms),
        trips: part(one.trips, batch.trips),
    }
}

/// Bytes that no other result has.
pub fn output(of: &str, index: usize) -> [u8; 64] {
    let mut bytes = [0; 64];
    let name = format!("{of} {index}");
    bytes[..name.len()].copy_from_slice(name.as_bytes());
    bytes
}

fn commit_all(caller: &Caller, tokens: &[String], of: &str) {
    let outputs: Vec<_> = (0..tokens.len()).map(|index| output(of, index)).collect();
    outputs.iter().for_each(|output| {
        caller.put("chunks", output);
    });
    let results: Vec<_> =
        tokens.iter().zip(&outputs).map(|(token, output)| (token.as_str(), &output[..])).collect();
    caller.commit_stored(&results);
}

/// Median time of a flush after a write of a page, in milliseconds, where databases and chunks are.
fn flush_ms() -> f64 {
    let mut file = tempfile::tempfile().unwrap();
    let mut times: Vec<Duration> = (0..200)
        .map(|_| {
            let started = Instant::now();
            file.rewind().unwrap();
            file.write_all(&[1; 4096]).unwrap();
            file.sync_data().unwrap();
            started.elapsed()
        })
        .collect();
    quantile(&mut times, 0.5).as_secs_f64() * 1000.0
}
