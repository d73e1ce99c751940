//! Faults that befall the farm, by the dice.

use std::time::Duration;

use super::Patience;
use super::troupe::Troupe;

/// A fault.
#[derive(Clone, Copy, Debug)]
enum Fault {
    KillWorker,
    KillServer,
    /// A worker stands still until its lease is gone, and then goes on as if nothing had been.
    StopWorker,
    EndSessions,
    CrashDatabase,
    Cut,
    LoseAnswers,
    Delay,
}

const FAULTS: [Fault; 8] = [
    Fault::KillWorker,
    Fault::KillServer,
    Fault::StopWorker,
    Fault::EndSessions,
    Fault::CrashDatabase,
    Fault::Cut,
    Fault::LoseAnswers,
    Fault::Delay,
];

/// Dice that fall alike for the same seed.
pub struct Dice {
    random: fastrand::Rng,
    /// Faults still to come before each has come once more.
    bag: Vec<Fault>,
}

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self { random: fastrand::Rng::with_seed(seed), bag: Vec::new() }
    }

    pub fn number(&mut self, range: std::ops::Range<u64>) -> u64 {
        self.random.u64(range)
    }

    fn index(&mut self, count: usize) -> usize {
        self.random.usize(..count)
    }

    fn fault(&mut self) -> Fault {
        if self.bag.is_empty() {
            self.bag = FAULTS.to_vec();
            self.random.shuffle(&mut self.bag);
        }
        self.bag.pop().expect("it was filled")
    }
}

/// Lets the next thing happen; says what it was.
pub fn strike(troupe: &mut Troupe, dice: &mut Dice) -> String {
    let fault = dice.fault();
    let told = match fault {
        Fault::KillWorker => {
            let worker = busy_worker(troupe, dice);
            troupe.replace_worker(worker);
            troupe.workers[worker].name.clone()
        }
        Fault::KillServer => {
            let server = dice.index(troupe.servers.len());
            troupe.replace_server(server);
            troupe.servers[server].name.clone()
        }
        Fault::StopWorker => stop_past_lease(troupe, dice),
        Fault::EndSessions => format!("{} sessions", troupe.database.end_sessions()),
        Fault::CrashDatabase => {
            troupe.database.crash();
            String::new()
        }
        Fault::Cut => {
            let first = dice.index(DOORS.len());
            // At a door where there is something to cut.
            let in_turn = (0..DOORS.len()).map(|number| (first + number) % DOORS.len());
            let cut =
                in_turn.map(|door| (troupe.doors()[door].cut(), DOORS[door])).find(|(count, _)| *count > 0);
            cut.map_or_else(String::new, |(count, name)| format!("{count} connections at {name}"))
        }
        Fault::LoseAnswers => {
            let (door, name) = door(dice);
            let count = dice.number(1..12) as u32;
            troupe.doors()[door].lose_answers(count);
            format!("{count} at {name}")
        }
        Fault::Delay => {
            let (door, name) = door(dice);
            // A transaction has many statements: with more, no heartbeat comes through in time for the shortest lease.
            let longest_ms = if door == 1 { 20 } else { 900 };
            let delay = Duration::from_millis(dice.number(5..longest_ms));
            troupe.doors()[door].delay(delay);
            format!("{delay:?} at {name}")
        }
    };
    format!("{fault:?} {told}")
}

/// Names of the troupe's doors, in their order.
const DOORS: [&str; 3] = ["the front door", "the database's door", "the chunks' door"];

fn door(dice: &mut Dice) -> (usize, &'static str) {
    let door = dice.index(DOORS.len());
    (door, DOORS[door])
}

/// A worker that has a task, if one has.
fn busy_worker(troupe: &Troupe, dice: &mut Dice) -> usize {
    let busy = troupe.database.texts("SELECT worker FROM leases WHERE task IS NOT NULL ORDER BY worker");
    let chosen = dice.index(troupe.workers.len().max(1));
    let name = busy.get(chosen % busy.len().max(1));
    let found = name.and_then(|name| troupe.workers.iter().position(|worker| worker.name == *name));
    found.unwrap_or(chosen)
}

fn stop_past_lease(troupe: &Troupe, dice: &mut Dice) -> String {
    let worker = &troupe.workers[busy_worker(troupe, dice)];
    worker.signal("STOP");
    let held = || {
        let leases = troupe.database.texts("SELECT worker FROM leases WHERE task IS NOT NULL");
        leases.contains(&worker.name)
    };
    let had_one = held();
    Patience::new().until("end of a stopped worker's lease", || !held());
    worker.signal("CONT");
    format!("{}, which {} a task", worker.name, if had_one { "had" } else { "did not have" })
}
