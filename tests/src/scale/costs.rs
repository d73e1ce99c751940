//! Costs of a farm's calls, as `tests/bench/run scale-costs` measures them.

use std::time::Duration;

/// Processor time of one call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Call {
    /// Of the server, in milliseconds.
    pub server_ms: f64,
    /// Of the database's own processes, in milliseconds; 0 where the server is the database.
    pub database_ms: f64,
    /// Times that the server waits for the database's answer; measured as the waits of its sessions, for the disk and for locks among them:
    /// at most so many.
    pub trips: f64,
}

/// A farm's database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Database {
    /// A file of the one server: one change at a time.
    Sqlite,
    /// One for any number of servers; changes wait for each other by bake.
    Postgres,
}

/// Costs of calls on one database.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Costs {
    /// HTTP alone, of each call.
    pub http_ms: f64,
    /// A claim that brings one lease.
    pub claim: Call,
    /// Each further lease of a claim.
    pub lease: Call,
    /// A heartbeat.
    pub heartbeat: Call,
    /// The question whether a chunk is there.
    pub look: Call,
    /// The upload of a small chunk.
    pub upload: Call,
    /// A commit of one result.
    pub commit: Call,
    /// Each further result in the same transaction.
    pub result: Call,
    /// A flush of the disk, in milliseconds.
    pub flush_ms: f64,
}

impl Costs {
    /// Processor time of a task from claim to commit, of the server and of the database's processes, where results go alone and no
    /// heartbeat but the first is due.
    pub fn of_task(&self) -> (Duration, Duration) {
        let calls = [self.claim, self.heartbeat, self.look, self.upload, self.commit];
        let sum = |ms: fn(&Call) -> f64| Duration::from_secs_f64(calls.iter().map(ms).sum::<f64>() / 1000.0);
        (sum(|call| call.server_ms), sum(|call| call.database_ms))
    }
}
