//! A farm in a model: workers claim, keep leases, upload and hand in as the worker's runtime does; servers, database and bakes are
//! stations with so many places.
//!
//! A call takes a server's processor for its HTTP and its own work, and one of the database's. A claim and a commit change the farm:
//! on SQLite each has the file alone, on PostgreSQL its bakes, from some point of its work on. Results that come to a server while it
//! commits others share the next transaction.
//!
//! Left out: fetches of inputs, which workers keep; claims that wait while there is nothing; submissions; failures.

use std::time::Duration;

use super::costs::{Costs, Database};
use super::run::Run;
use super::timeline::Figures;

/// Efficiency from which on workers count as fed.
pub const FED: f64 = 0.9;
/// Share of busy time from which on a station counts as full.
const FULL: f64 = 0.85;

/// A farm and its work; all counts are at least 1.
#[derive(Clone, Copy, Debug)]
pub struct Farm {
    /// Its database.
    pub database: Database,
    /// Costs of calls there.
    pub costs: Costs,
    /// Servers; one on SQLite.
    pub servers: usize,
    /// Processors of each server.
    pub server_processors: usize,
    /// Processors of the database, and none if it has those of the one machine that all are on.
    pub database_processors: Option<usize>,
    /// Processor time of a task on the worker's side, where workers are on that machine, too.
    pub worker_work: Duration,
    /// Share of the machines' time that goes to other programs, 0..1: all work takes so much longer.
    pub elsewhere: f64,
    /// Time of a message there and back, between workers, servers and database.
    pub round_trip: Duration,
    /// Bakes among which the tasks are spread.
    pub bakes: usize,
    /// Workers.
    pub workers: usize,
    /// Tasks that each has in hand.
    pub in_hand: usize,
    /// Tasks in all.
    pub tasks: usize,
    /// Mean time of a task.
    pub mean: Duration,
    /// Time between heartbeats.
    pub beat: Duration,
    /// Number of the run: others draw other task times.
    pub seed: u64,
}

/// Cause for which more workers are of no use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// There is none: the workers are fed.
    None,
    /// The servers' processors.
    Server,
    /// The database's processors.
    Database,
    /// SQLite's one change at a time, or the busiest bake's lock.
    Lock,
    /// A server's one transaction of results at a time.
    Writer,
    /// A server's connections to the database.
    Connections,
    /// Nothing is full: calls take long beside the tasks.
    Calls,
}

/// One run of a model.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Throughput, efficiency, tail.
    pub figures: Figures,
    /// 99th percentile of a claim's time, as workers see it.
    pub claim_p99: Duration,
    /// That of a commit's time.
    pub commit_p99: Duration,
    /// Share of the servers' processors that is at work.
    pub server_busy: f64,
    /// That of the database's processors; of the one machine's where there is one.
    pub database_busy: f64,
    /// Share of the time in which the busiest lock is held.
    pub lock_busy: f64,
    /// Share of the time in which the busiest server commits results.
    pub writer_busy: f64,
    /// Share of the busiest server's connections for changes that are in use.
    pub connections_busy: f64,
    /// Time until the last commit.
    pub finished: Duration,
    /// Heartbeats that were sent, the first ones of tasks among them.
    pub heartbeats: u64,
    /// Claims that were called.
    pub claims: u64,
    /// Calls that handed results in.
    pub commits: u64,
    /// Results of the mean transaction.
    pub mean_batch: f64,
}

impl Outcome {
    /// The first full station, of those that none of the others is waited in for.
    pub fn limit(&self) -> Limit {
        if self.figures.efficiency >= FED {
            return Limit::None;
        }
        let stations = [
            (self.server_busy, Limit::Server),
            (self.database_busy, Limit::Database),
            (self.lock_busy, Limit::Lock),
            (self.writer_busy, Limit::Writer),
            (self.connections_busy, Limit::Connections),
        ];
        let full = stations.into_iter().find(|(busy, _)| *busy >= FULL);
        full.map_or(Limit::Calls, |(_, limit)| limit)
    }
}

impl Farm {
    /// Runs it until all tasks are committed. None if there are too few of them for figures.
    pub fn run(&self) -> Option<Outcome> {
        Run::new(self).run()
    }
}
