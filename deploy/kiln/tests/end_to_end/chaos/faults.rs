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
    /// All that is behind a door is away for a while: server, database, or store of bytes.
    Away,
    /// It is there and does not answer.
    Hang,
    /// The clock by which leases end, or one that nobody should go by, is set ahead or back by hours.
    TurnClock,
}

const FAULTS: [Fault; 11] = [
    Fault::KillWorker,
    Fault::KillServer,
    Fault::StopWorker,
    Fault::EndSessions,
    Fault::CrashDatabase,
    Fault::Cut,
    Fault::LoseAnswers,
    Fault::Delay,
    Fault::Away,
    Fault::Hang,
    Fault::TurnClock,
];

/// Faults of a short run: one of each kind.
pub const KINDS: u64 = FAULTS.len() as u64;
/// Farthest that a clock is set ahead or back, in seconds.
const TURN_MAX_SECS: u64 = 3 * 3600;

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
        Fault::EndSessions | Fault::CrashDatabase if troupe.database.server().is_none() => {
            "of none".to_owned()
        }
        Fault::EndSessions => format!("{} sessions", troupe.database.end_sessions()),
        Fault::CrashDatabase => {
            troupe.database.crash();
            String::new()
        }
        Fault::Cut => {
            let doors = troupe.doors();
            let first = dice.index(doors.len());
            // At a door where there is something to cut.
            let in_turn = (0..doors.len()).map(|number| (first + number) % doors.len());
            let cut = in_turn.map(|door| (doors[door].cut(), NAMES[door])).find(|(count, _)| *count > 0);
            cut.map_or_else(String::new, |(count, name)| format!("{count} connections at {name}"))
        }
        Fault::LoseAnswers => {
            let door = dice.index(troupe.doors().len());
            let count = dice.number(1..12) as u32;
            troupe.doors()[door].lose_answers(count);
            format!("{count} at {}", NAMES[door])
        }
        Fault::Delay => {
            let door = dice.index(troupe.doors().len());
            // A transaction has many statements: with more, no heartbeat comes through in time for the shortest lease.
            let longest_ms = if NAMES[door] == DATABASE { 20 } else { 900 };
            let delay = Duration::from_millis(dice.number(5..longest_ms));
            troupe.doors()[door].delay(delay);
            format!("{delay:?} at {}", NAMES[door])
        }
        Fault::Away | Fault::Hang => {
            let door = dice.index(troupe.doors().len());
            let time = Duration::from_millis(dice.number(200..9_000));
            match fault {
                Fault::Hang => troupe.doors()[door].delay(time),
                _ => drop(troupe.doors()[door].shut()),
            }
            // The time is the trouble itself; nothing waits for it to be over.
            std::thread::park_timeout(time);
            troupe.doors()[door].heal();
            format!("{time:?} at {}", NAMES[door])
        }
        Fault::TurnClock => {
            let clocks = troupe.clocks();
            let (name, clock) = clocks[dice.index(clocks.len())];
            let turn = dice.number(0..2 * TURN_MAX_SECS) as i64 - TURN_MAX_SECS as i64;
            clock.set(turn);
            format!("{turn} s at {name}")
        }
    };
    format!("{fault:?} {told}")
}

/// Names of the troupe's doors, in their order; a farm on SQLite has the first alone.
const NAMES: [&str; 3] = ["the front door", DATABASE, "the chunks' door"];
const DATABASE: &str = "the database's door";

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
