//! The course of a farm in the model: each event of a worker, and the way that it sends through the stations.

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use super::costs::{Call, Database};
use super::engine::{Engine, StationId, Step};
use super::farm::{Farm, Outcome};
use super::timeline::{Figures, Span, WARM_PART, quantile};
use super::times::task_time;

/// Most results of one transaction, as `COMMITS_MAX` of the server has it.
const RESULTS_MAX: usize = 64;
/// Connections of a server to PostgreSQL for changes, and for heartbeats (`WRITERS` and `BEATS` of the server).
const CONNECTIONS: usize = 8;
const BEAT_CONNECTIONS: usize = 2;
/// Longest time for which a call has a processor at a time, in milliseconds.
const TURN_MS: f64 = 1.0;
/// Part of a claim's work on PostgreSQL, and of a commit's, that comes after it has locked its bakes. Assumed: claims search first, commits
/// lock almost at once.
const CLAIM_LOCKED: f64 = 0.5;
const COMMIT_LOCKED: f64 = 0.8;

#[derive(Debug)]
enum Event {
    /// The worker's claim was answered.
    Claimed {
        worker: usize,
        asked: Duration,
        slots: Vec<usize>,
    },
    /// The first heartbeat was heard.
    Begun(usize),
    /// The task of that number has run.
    Ran(usize),
    /// Its output is stored.
    Stored(usize),
    /// The time for a heartbeat of that task.
    BeatDue(usize, usize),
    Beaten,
    /// A call with results came to the server.
    Arrived(Results),
    /// The server's transaction is over.
    Committed {
        server: usize,
        calls: Vec<Results>,
    },
    /// The worker heard that its results are committed.
    Answered(Results),
}

#[derive(Debug)]
struct Results {
    worker: usize,
    slots: Vec<usize>,
    sent: Duration,
}

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    bake: usize,
    task: usize,
    time: Duration,
    is_idle: bool,
    /// From the lease's arrival to the answer to its result: the worker sends heartbeats.
    is_kept: bool,
}

#[derive(Debug, Default)]
struct Bake {
    next: u64,
    left: usize,
    leased: usize,
}

#[derive(Debug, Default)]
struct Worker {
    has_claim: bool,
    is_sending: bool,
    waiting: Vec<usize>,
}

#[derive(Debug, Default)]
struct Line {
    waiting: VecDeque<Results>,
    is_writing: bool,
}

pub(super) struct Run<'a> {
    farm: &'a Farm,
    engine: Engine<Event>,
    processors: Vec<StationId>,
    database: StationId,
    locks: Vec<StationId>,
    connections: Vec<StationId>,
    beats: Vec<StationId>,
    writers: Vec<StationId>,
    slots: Vec<Slot>,
    workers: Vec<Worker>,
    lines: Vec<Line>,
    bakes: Vec<Bake>,
    spans: Vec<Span>,
    claims: Vec<Duration>,
    commits: Vec<Duration>,
    batches: usize,
    heartbeats: u64,
    begun: usize,
    ended: usize,
    finished: Duration,
    /// Moment and busy time of each station when the window of the figures begins, and when it ends.
    looks: Vec<(Duration, Vec<Duration>)>,
}

impl<'a> Run<'a> {
    pub(super) fn new(farm: &'a Farm) -> Self {
        let mut engine = Engine::default();
        let is_sqlite = farm.database == Database::Sqlite;
        let servers = if is_sqlite { 1 } else { farm.servers.max(1) };
        // On one machine all have the same processors.
        let first = engine.station(farm.server_processors);
        let (processors, database) = match farm.database_processors {
            None => (vec![first; servers], first),
            Some(count) => {
                let others = (1..servers).map(|_| engine.station(farm.server_processors));
                ([first].into_iter().chain(others.collect::<Vec<_>>()).collect(), engine.station(count))
            }
        };
        let locks = (0..if is_sqlite { 1 } else { farm.bakes }).map(|_| engine.station(1)).collect();
        let connections = (0..servers).map(|_| engine.station(CONNECTIONS)).collect();
        let writers = (0..servers).map(|_| engine.station(1)).collect();
        let beats = (0..servers).map(|_| engine.station(BEAT_CONNECTIONS)).collect();
        let bakes = (0..farm.bakes).map(|bake| Bake {
            left: farm.tasks / farm.bakes + usize::from(bake < farm.tasks % farm.bakes),
            ..Bake::default()
        });
        Self {
            processors,
            database,
            locks,
            connections,
            beats,
            writers,
            slots: vec![Slot { is_idle: true, ..Slot::default() }; farm.workers * farm.in_hand],
            workers: (0..farm.workers).map(|_| Worker::default()).collect(),
            lines: (0..servers).map(|_| Line::default()).collect(),
            bakes: bakes.collect(),
            spans: Vec::with_capacity(farm.tasks),
            claims: Vec::new(),
            commits: Vec::new(),
            batches: 0,
            heartbeats: 0,
            begun: 0,
            ended: 0,
            finished: Duration::ZERO,
            looks: Vec::new(),
            farm,
            engine,
        }
    }

    pub(super) fn run(mut self) -> Option<Outcome> {
        (0..self.farm.workers).for_each(|worker| self.claim(worker));
        while let Some(event) = self.engine.next_event() {
            self.heed(event);
        }
        self.outcome()
    }

    fn heed(&mut self, event: Event) {
        match event {
            Event::Claimed { worker, asked, slots } => self.begin(worker, asked, &slots),
            Event::Begun(slot) => self.run_task(slot),
            Event::BeatDue(slot, task) => self.beat(slot, task),
            Event::Beaten => {}
            Event::Ran(slot) => self.store(slot),
            Event::Stored(slot) => self.hand_in(slot),
            Event::Arrived(results) => {
                let server = self.server_of(results.worker);
                self.lines[server].waiting.push_back(results);
                self.write(server);
            }
            Event::Committed { server, calls } => {
                self.lines[server].is_writing = false;
                for results in calls {
                    self.engine.go([Step::Wait(self.farm.round_trip / 2)], Event::Answered(results));
                }
                self.write(server);
            }
            Event::Answered(results) => self.end(&results),
        }
    }

    fn server_of(&self, worker: usize) -> usize {
        worker % self.processors.len()
    }

    /// Work of so many milliseconds on a station.
    fn work(&self, station: StationId, ms: f64) -> [Step; 3] {
        Step::work(station, Duration::from_secs_f64(ms.max(0.0) / 1000.0 / (1.0 - self.farm.elsewhere)))
    }

    /// HTTP's work of a call, after half a round trip.
    fn arrive(&self, server: usize) -> Vec<Step> {
        let mut steps = vec![Step::Wait(self.farm.round_trip / 2)];
        steps.extend(self.work(self.processors[server], self.farm.costs.http_ms));
        steps
    }

    /// Part of a call's work but HTTP's, on server and database, with its waits for answers.
    fn part(&self, server: usize, call: Call, part: f64) -> Vec<Step> {
        // In turns, as a server asks and the database answers: nobody has a processor for the whole of a long call.
        let turns = (part * call.server_ms.max(call.database_ms) / TURN_MS).ceil().max(1.0);
        let mut steps = Vec::new();
        for _ in 0..turns as usize {
            steps.extend(self.work(self.processors[server], part * call.server_ms / turns));
            steps.extend(self.work(self.database, part * call.database_ms / turns));
        }
        steps.push(Step::Wait(self.farm.round_trip.mul_f64(part * call.trips)));
        steps
    }

    /// A change: the part `locked` of its work is done under the locks of its bakes, and so is its flush, if it has one.
    fn change(
        &self,
        server: usize,
        call: Call,
        locked: f64,
        bakes: &BTreeSet<usize>,
        flush: bool,
    ) -> Vec<Step> {
        let flush_ms = if flush { self.farm.costs.flush_ms } else { 0.0 };
        let flush = Step::Wait(Duration::from_secs_f64(flush_ms / 1000.0));
        if self.farm.database == Database::Sqlite {
            let mut steps = vec![Step::Take(self.locks[0])];
            steps.extend(self.part(server, call, 1.0));
            steps.extend([flush, Step::Free(self.locks[0])]);
            return steps;
        }
        let mut steps = vec![Step::Take(self.connections[server])];
        steps.extend(self.part(server, call, 1.0 - locked));
        // In order, so that none wait in a ring.
        steps.extend(bakes.iter().map(|bake| Step::Take(self.locks[*bake])));
        steps.extend(self.part(server, call, locked));
        steps.push(flush);
        steps.extend(bakes.iter().map(|bake| Step::Free(self.locks[*bake])));
        steps.push(Step::Free(self.connections[server]));
        steps
    }

    /// A call without HTTP's share of its server's work.
    fn beyond_http(&self, call: Call) -> Call {
        Call { server_ms: (call.server_ms - self.farm.costs.http_ms).max(0.0), ..call }
    }

    /// Asks for as many tasks as the worker has room for, unless it asks already or nothing is left.
    fn claim(&mut self, worker: usize) {
        if self.workers[worker].has_claim {
            return;
        }
        let own = worker * self.farm.in_hand..(worker + 1) * self.farm.in_hand;
        let idle: Vec<usize> = own.filter(|slot| self.slots[*slot].is_idle).collect();
        let mut slots = Vec::new();
        for slot in idle {
            // The bake that has fewest tasks in hand is next.
            let open = self.bakes.iter().enumerate().filter(|(_, bake)| bake.left > 0);
            let Some((number, _)) = open.min_by_key(|(_, bake)| bake.leased) else { break };
            let bake = &mut self.bakes[number];
            let time = task_time(self.farm.seed ^ number as u64, bake.next, self.farm.mean);
            bake.next += 1;
            bake.left -= 1;
            bake.leased += 1;
            self.slots[slot] = Slot { bake: number, time, is_idle: false, ..self.slots[slot] };
            slots.push(slot);
        }
        if slots.is_empty() {
            return;
        }
        self.workers[worker].has_claim = true;
        let server = self.server_of(worker);
        let (first, more) = (self.beyond_http(self.farm.costs.claim), self.farm.costs.lease);
        let call = together(first, more, slots.len());
        let bakes = slots.iter().map(|slot| self.slots[*slot].bake).collect();
        let mut steps = self.arrive(server);
        steps.extend(self.change(server, call, CLAIM_LOCKED, &bakes, false));
        steps.push(Step::Wait(self.farm.round_trip / 2));
        self.engine.go(steps, Event::Claimed { worker, asked: self.engine.now(), slots });
    }

    /// Says that the leases arrived.
    fn begin(&mut self, worker: usize, asked: Duration, slots: &[usize]) {
        self.claims.push(self.engine.now() - asked);
        self.workers[worker].has_claim = false;
        for slot in slots {
            self.slots[*slot].task += 1;
            self.slots[*slot].is_kept = true;
            self.engine.after(self.farm.beat, Event::BeatDue(*slot, self.slots[*slot].task));
            self.send_beat(worker, Event::Begun(*slot));
        }
        // Places that came free meanwhile.
        self.claim(worker);
    }

    fn send_beat(&mut self, worker: usize, heard: Event) {
        self.heartbeats += 1;
        let server = self.server_of(worker);
        let place = match self.farm.database {
            Database::Sqlite => self.locks[0],
            Database::Postgres => self.beats[server],
        };
        let mut steps = self.arrive(server);
        steps.push(Step::Take(place));
        steps.extend(self.part(server, self.beyond_http(self.farm.costs.heartbeat), 1.0));
        steps.extend([Step::Free(place), Step::Wait(self.farm.round_trip / 2)]);
        self.engine.go(steps, heard);
    }

    fn run_task(&mut self, slot: usize) {
        self.begun += 1;
        let time = self.slots[slot].time;
        self.spans.push(Span { begin: self.engine.now(), end: self.engine.now() + time });
        if self.begun == self.farm.tasks {
            self.look();
        }
        self.engine.after(time, Event::Ran(slot));
    }

    fn beat(&mut self, slot: usize, task: usize) {
        let state = self.slots[slot];
        if state.task == task && state.is_kept {
            self.send_beat(slot / self.farm.in_hand, Event::Beaten);
            self.engine.after(self.farm.beat, Event::BeatDue(slot, task));
        }
    }

    /// Uploads a task's output.
    fn store(&mut self, slot: usize) {
        self.ended += 1;
        if self.ended == self.farm.tasks / WARM_PART + 1 {
            self.look();
        }
        let server = self.server_of(slot / self.farm.in_hand);
        let costs = self.farm.costs;
        let own_ms = self.farm.worker_work.as_secs_f64() * 1000.0;
        let mut steps = Vec::from(self.work(self.processors[server], own_ms));
        steps.extend(self.arrive(server));
        steps.extend(self.part(server, self.beyond_http(costs.look), 1.0));
        steps.push(Step::Wait(self.farm.round_trip / 2));
        steps.extend(self.arrive(server));
        // The file is flushed before the farm hears of it.
        steps.push(Step::Wait(Duration::from_secs_f64(costs.flush_ms / 1000.0)));
        steps.extend(self.change(server, self.beyond_http(costs.upload), 0.0, &BTreeSet::new(), false));
        steps.push(Step::Wait(self.farm.round_trip / 2));
        self.engine.go(steps, Event::Stored(slot));
    }

    /// Hands a result in, with the others that came while the last call was under way.
    fn hand_in(&mut self, slot: usize) {
        let worker = slot / self.farm.in_hand;
        self.workers[worker].waiting.push(slot);
        self.send(worker);
    }

    fn send(&mut self, worker: usize) {
        if self.workers[worker].is_sending || self.workers[worker].waiting.is_empty() {
            return;
        }
        self.workers[worker].is_sending = true;
        let slots = std::mem::take(&mut self.workers[worker].waiting);
        let steps = self.arrive(self.server_of(worker));
        let sent = self.engine.now();
        self.engine.go(steps, Event::Arrived(Results { worker, slots, sent }));
    }

    /// Commits the results that came to a server meanwhile, unless it commits others.
    fn write(&mut self, server: usize) {
        if self.lines[server].is_writing || self.lines[server].waiting.is_empty() {
            return;
        }
        let (mut calls, mut count) = (Vec::new(), 0);
        while let Some(call) = self.lines[server].waiting.pop_front() {
            count += call.slots.len();
            calls.push(call);
            if count >= RESULTS_MAX {
                break;
            }
        }
        self.lines[server].is_writing = true;
        self.batches += 1;
        let bakes = calls.iter().flat_map(|call| &call.slots).map(|slot| self.slots[*slot].bake).collect();
        let first = self.beyond_http(self.farm.costs.commit);
        let call = together(first, self.farm.costs.result, count);
        let mut steps = vec![Step::Take(self.writers[server])];
        steps.extend(self.change(server, call, COMMIT_LOCKED, &bakes, true));
        steps.push(Step::Free(self.writers[server]));
        self.engine.go(steps, Event::Committed { server, calls });
    }

    /// The worker's places are free again.
    fn end(&mut self, results: &Results) {
        self.finished = self.engine.now();
        self.commits.push(self.finished - results.sent);
        self.workers[results.worker].is_sending = false;
        for slot in &results.slots {
            self.bakes[self.slots[*slot].bake].leased -= 1;
            self.slots[*slot].is_idle = true;
            self.slots[*slot].is_kept = false;
        }
        self.send(results.worker);
        self.claim(results.worker);
    }

    /// Notes how long each station has been busy.
    fn look(&mut self) {
        let all =
            [&self.processors[..], &[self.database], &self.locks, &self.writers, &self.connections].concat();
        let busy = all.into_iter().map(|station| self.engine.usage(station).busy).collect();
        self.looks.push((self.engine.now(), busy));
    }

    fn outcome(mut self) -> Option<Outcome> {
        let finished = self.finished;
        let figures = Figures::of(&self.spans, self.slots.len(), finished)?;
        let [(from, before), (to, after)] = &self.looks[..] else { return None };
        let secs = (*to - *from).as_secs_f64();
        let mut shares = before.iter().zip(after).map(|(b, a)| (*a - *b).as_secs_f64() / secs);
        let mut next = |count: usize, places: usize| {
            let shares = shares.by_ref().take(count).map(|share| share / places as f64);
            shares.fold((0.0, 0.0_f64), |(sum, most), share| (sum + share / count as f64, most.max(share)))
        };
        let database_processors = self.farm.database_processors.unwrap_or(self.farm.server_processors);
        let server_busy = next(self.processors.len(), self.farm.server_processors).0;
        let database_busy = next(1, database_processors).0;
        let lock_busy = next(self.locks.len(), 1).1;
        let writer_busy = next(self.writers.len(), 1).1;
        let connections_busy = next(self.connections.len(), CONNECTIONS).1;
        Some(Outcome {
            figures,
            claim_p99: quantile(&mut self.claims, 0.99),
            commit_p99: quantile(&mut self.commits, 0.99),
            server_busy,
            database_busy,
            lock_busy,
            writer_busy,
            connections_busy,
            finished,
            heartbeats: self.heartbeats,
            claims: self.claims.len() as u64,
            commits: self.commits.len() as u64,
            mean_batch: self.farm.tasks as f64 / self.batches as f64,
        })
    }
}

/// A call for so many leases or results.
fn together(first: Call, more: Call, count: usize) -> Call {
    let more_count = count.saturating_sub(1) as f64;
    Call {
        server_ms: first.server_ms + more_count * more.server_ms,
        database_ms: first.database_ms + more_count * more.database_ms,
        trips: first.trips + more_count * more.trips,
    }
}
