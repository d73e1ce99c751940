//! Everything that can go wrong around a farm goes wrong, by the dice: workers and servers are killed, workers are stopped
//! for longer than their leases, PostgreSQL loses its sessions and crashes, connections are cut, slow, and lose answers
//! after the request was done. The result must be that of an undisturbed bake, and the farm's books must
//! be right.
//!
//! The same seed throws the same dice; the moment at which a fault strikes is up to the machine. `KILN_CHAOS_SEED`
//! and `KILN_CHAOS_ROUNDS` say which, and for how long:
//! ```sh
//! KILN_CHAOS_SEED=7 KILN_CHAOS_ROUNDS=200 cargo test --release -p kiln --test end_to_end chaos::farm -- --nocapture
//! ```

mod database;
mod faults;
mod proxy;
mod troupe;
mod verdict;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use lightkiln_client::fetch::ApiClient;
use lightkiln_http::USUAL;
use lightkiln_proto::api::{Bake, BakeState};

use super::processes::{LIMIT, Running, kiln, run};
use super::{bundle, cornell};
use faults::Dice;
use troupe::Troupe;
use verdict::Books;

/// Faults of a short run: one of each kind.
const ROUNDS: u64 = 8;
/// Dice of a short run.
const SEED: u64 = 1;
/// The shortest lease there is, so that workers are missed soon.
const LEASE_SECS: u32 = 5;
/// Tries of one bake before the test gives up: a task that is killed again and again takes its bake along.
const TRIES_OF_A_BAKE: u32 = 10;
/// Time for one fault and all that follows from it.
const ROUND_LIMIT: Duration = LIMIT;

/// Settings of a bake with many small tasks.
const MANY: [&str; 6] =
    ["--preset", "draft", "--set", "receivers_target=12000", "--set", "cluster_receivers=64"];

/// Waits for something, up to a limit.
struct Patience {
    until: Instant,
}

impl Patience {
    fn new() -> Self {
        Self { until: Instant::now() + ROUND_LIMIT }
    }

    /// Before looking again for `what`.
    fn again(&self, what: &str) {
        assert!(Instant::now() < self.until, "no {what} within {ROUND_LIMIT:?}");
        std::thread::park_timeout(Duration::from_millis(20));
    }

    fn until(&self, what: &str, is_there: impl Fn() -> bool) {
        while !is_there() {
            self.again(what);
        }
    }
}

/// A run under way; when it fails it says how to repeat it.
struct Story {
    seed: u64,
    rounds: u64,
    troupe: Troupe,
    dice: Dice,
    client: ApiClient,
    books: Books,
    history: Vec<String>,
}

impl Drop for Story {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.troupe.show();
            eprintln!("faults: {:#?}", self.history);
            eprintln!("again with KILN_CHAOS_SEED={} KILN_CHAOS_ROUNDS={}", self.seed, self.rounds);
        }
    }
}

impl Story {
    fn new(seed: u64, rounds: u64) -> Self {
        let troupe = Troupe::start(2, 4, &format!("chaos-{seed}-{rounds}"));
        let client = ApiClient::new(&troupe.url(), None).unwrap().with_retry(USUAL.with_max_times(120));
        let (dice, books) = (Dice::new(seed), Books::default());
        Self { seed, rounds, troupe, dice, client, books, history: Vec::new() }
    }

    /// Runs a command of a person who tries again until it works, as it may be tried; its standard output.
    fn insist(&self, arguments: &[String]) -> Vec<String> {
        let patience = Patience::new();
        loop {
            let mut command = kiln(self.troupe.folder());
            command.args(arguments).args(["--server", &self.troupe.url()]);
            let ended = Running::start(command).finish();
            if ended.exit == Some(0) {
                return ended.stdout;
            }
            patience.again(&format!("success of {arguments:?}, which said {:?}", ended.stderr));
        }
    }

    /// Bakes until it is done, with faults for as long as there are rounds left.
    fn bake(&mut self, number: u64) {
        let expected = self.undisturbed(number);
        for _ in 0..TRIES_OF_A_BAKE {
            let commit = ["--commit".to_owned(), format!("bake {number}")];
            let submitted = self.insist(&[arguments("submit", number), commit.to_vec()].concat());
            let id = submitted.last().expect("the bake's id").trim().to_owned();
            let ended = self.disturb(&id);
            self.books.close(&self.client, &ended);
            if ended.state == BakeState::Done {
                let out = self.troupe.folder().join(format!("out-{number}"));
                self.insist(&["fetch".to_owned(), id, "--out".to_owned(), out.display().to_string()]);
                assert_eq!(bundle(&out), expected, "bake {number}");
                return;
            }
            eprintln!("the bake failed, and is tried again: {:?}", ended.failure);
        }
        panic!("bake {number} failed {TRIES_OF_A_BAKE} times");
    }

    /// Lets one fault follow the other while the bake goes on; the bake when it has ended.
    fn disturb(&mut self, id: &str) -> Bake {
        loop {
            let bake = self.client.bake(id).unwrap();
            if bake.state.is_final() {
                return bake;
            }
            let enough = if self.history.len() < self.rounds as usize {
                let told = faults::strike(&mut self.troupe, &mut self.dice);
                eprintln!("round {}: {told}", self.history.len() + 1);
                self.history.push(told);
                // Now and then the next one comes at once.
                self.dice.number(0..6)
            } else {
                u64::MAX
            };
            if enough > 0 {
                self.wait_for_progress(id, done_tasks(&bake), enough);
                self.troupe.doors().iter().for_each(|door| door.heal());
            }
            self.troupe.assert_alive();
        }
    }

    /// Whatever happened, the farm goes on: some tasks more are done, or all.
    fn wait_for_progress(&self, id: &str, before: u64, enough: u64) {
        let mut patience = Patience::new();
        let mut seen = before;
        loop {
            let bake = self.client.bake(id).unwrap();
            let done = done_tasks(&bake);
            if bake.state.is_final() || done.saturating_sub(before) >= enough {
                return;
            }
            if done > seen {
                (seen, patience) = (done, Patience::new());
            }
            let leases = "SELECT worker || ' ' || coalesce(task, 0) || ' ' || expires_ms FROM leases";
            let what = || format!("progress: {:?} {:?}", bake.stages, self.troupe.database.texts(leases));
            patience.again_with(what);
        }
    }

    /// The bundle of a bake in a process of its own.
    fn undisturbed(&self, number: u64) -> BTreeMap<String, String> {
        let folder = self.troupe.folder().join(format!("undisturbed-{number}"));
        let out = folder.join("out");
        let arguments =
            [arguments("bake", number), vec!["--out".to_owned(), out.display().to_string()]].concat();
        run(kiln(&folder), &arguments, 0);
        bundle(&out)
    }
}

impl Patience {
    fn again_with(&self, what: impl Fn() -> String) {
        if Instant::now() >= self.until {
            self.again(&what());
        }
        std::thread::park_timeout(Duration::from_millis(50));
    }
}

fn done_tasks(bake: &Bake) -> u64 {
    bake.stages.iter().map(|stage| stage.done).sum()
}

/// A bake with tasks of its own.
fn arguments(command: &str, number: u64) -> Vec<String> {
    let mut arguments = vec![command.to_owned(), cornell().display().to_string()];
    arguments.extend(MANY.map(str::to_owned));
    arguments.extend(["--set".to_owned(), format!("transport_rays={}", 32 + number)]);
    arguments
}

fn number_from(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable} must be a number, not {text}")))
}

#[test]
fn farm_that_everything_happens_to_gives_an_undisturbed_bakes_chunks() {
    let seed = number_from("KILN_CHAOS_SEED").unwrap_or(SEED);
    let rounds = number_from("KILN_CHAOS_ROUNDS").unwrap_or(ROUNDS);
    let mut story = Story::new(seed, rounds);
    let mut number = 0;
    while number == 0 || (story.history.len() as u64) < rounds {
        story.bake(number);
        number += 1;
    }
    story.troupe.doors().iter().for_each(|door| door.heal());
    verdict::assert_books_are_right(&mut story.troupe);
    story.books.assert_told(number);
    let faults = story.history.len();
    eprintln!("{number} bakes, {faults} faults; {}", story.books.summary());
}
