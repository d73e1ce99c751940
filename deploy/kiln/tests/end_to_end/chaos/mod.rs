//! Everything that can go wrong around a farm goes wrong, by the dice: workers and servers are killed, workers are stopped
//! for longer than their leases, PostgreSQL loses its sessions and crashes, connections are cut, slow, and lose answers
//! after the request was done, servers, database and store of bytes are away or hang, clocks are set ahead and back by hours. Every
//! bake must end well at its first submission, with the chunks of an undisturbed one; each of its callers calls once, with the patience that
//! `kiln` has of its own; and the farm's books must be right.
//!
//! The same seed throws the same dice; the moment at which a fault strikes is up to the machine. `KILN_CHAOS_SEED` says which;
//! `KILN_CHAOS_ROUNDS` and `KILN_CHAOS_MINUTES` for how many faults or for how long at least:
//! ```sh
//! KILN_CHAOS_SEED=7 KILN_CHAOS_MINUTES=60 cargo test --release -p kiln --test end_to_end chaos::farm -- --nocapture --test-threads=1
//! ```

mod clocks;
mod database;
mod faults;
mod proxy;
mod troupe;
mod verdict;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use lightkiln_client::fetch::ApiClient;
use lightkiln_http::Patience as Waiting;
use lightkiln_proto::api::Bake;

use super::processes::{LIMIT, Running, kiln, run};
use super::{bundle, cornell};
use faults::Dice;
use troupe::Troupe;
use verdict::Books;

pub use verdict::all_events;

/// Dice of a short run.
const SEED: u64 = 1;
/// The shortest lease there is, so that workers are missed soon.
const LEASE_SECS: u32 = 5;
/// Workers of a farm.
const WORKERS: usize = 4;
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

/// How long faults go on.
#[derive(Clone, Copy)]
struct Length {
    /// So many faults at least.
    rounds: u64,
    /// So long at least.
    until: Instant,
}

/// A run under way; when it fails it says how to repeat it.
struct Story {
    seed: u64,
    length: Length,
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
            eprintln!("again with KILN_CHAOS_SEED={} KILN_CHAOS_ROUNDS={}", self.seed, self.history.len());
        }
    }
}

impl Story {
    fn new(seed: u64, length: Length, troupe: Troupe) -> Self {
        let client = ApiClient::new(&troupe.url(), None).unwrap();
        let client = client.with_patience(Waiting::new(ROUND_LIMIT, |_| ()));
        let (dice, books) = (Dice::new(seed), Books::default());
        Self { seed, length, troupe, dice, client, books, history: Vec::new() }
    }

    fn is_long_enough(&self) -> bool {
        self.history.len() as u64 >= self.length.rounds && Instant::now() >= self.length.until
    }

    /// Runs a command of a person, who calls it once, whatever goes on.
    fn command(&self, arguments: &[String]) -> Vec<String> {
        let mut command = kiln(self.troupe.folder());
        command.args(arguments).args(["--server", &self.troupe.url()]);
        let ended = Running::start(command).finish();
        assert_eq!(ended.exit, Some(0), "{arguments:?} said {:?}", ended.stderr);
        ended.stdout
    }

    /// Bakes until it is done, with faults until there were enough.
    fn bake(&mut self, number: u64) {
        let expected = self.undisturbed(number);
        let commit = ["--commit".to_owned(), format!("bake {number}")];
        let submitted = self.command(&[arguments("submit", number), commit.to_vec()].concat());
        let id = submitted.last().expect("the bake's id").trim().to_owned();
        let ended = self.disturb(&id);
        self.books.close(&self.client, &ended);
        let out = self.troupe.folder().join(format!("out-{number}"));
        self.command(&["fetch".to_owned(), id, "--out".to_owned(), out.display().to_string()]);
        assert_eq!(bundle(&out), expected, "bake {number}");
        // An hour has many of them.
        std::fs::remove_dir_all(out).unwrap();
        std::fs::remove_dir_all(self.undisturbed_folder(number)).unwrap();
    }

    /// Lets one fault follow the other while the bake goes on; the bake when it has ended.
    fn disturb(&mut self, id: &str) -> Bake {
        loop {
            let bake = self.client.bake(id).unwrap();
            if bake.state.is_final() {
                return bake;
            }
            let enough = if !self.is_long_enough() {
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
        let folder = self.undisturbed_folder(number);
        let out = folder.join("out");
        let arguments =
            [arguments("bake", number), vec!["--out".to_owned(), out.display().to_string()]].concat();
        run(kiln(&folder), &arguments, 0);
        bundle(&out)
    }

    fn undisturbed_folder(&self, number: u64) -> PathBuf {
        self.troupe.folder().join(format!("undisturbed-{number}"))
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

/// Bakes on a farm for as long as the variables say, while faults strike.
fn play(troupe: impl FnOnce(&str) -> Troupe) {
    let seed = number_from("KILN_CHAOS_SEED").unwrap_or(SEED);
    let minutes = number_from("KILN_CHAOS_MINUTES");
    let rounds = number_from("KILN_CHAOS_ROUNDS").unwrap_or(faults::KINDS);
    let until = Instant::now() + Duration::from_secs(60 * minutes.unwrap_or_default());
    let mut story = Story::new(seed, Length { rounds, until }, troupe(&format!("chaos-{seed}-{rounds}")));
    let mut number = 0;
    while number == 0 || !story.is_long_enough() {
        story.bake(number);
        number += 1;
    }
    story.troupe.doors().iter().for_each(|door| door.heal());
    story.troupe.clocks().iter().for_each(|(_, clock)| clock.set(0));
    verdict::assert_books_are_right(&mut story.troupe);
    story.books.assert_told(number);
    let faults = story.history.len();
    eprintln!("{number} bakes, {faults} faults; {}", story.books.summary());
}

#[test]
fn farm_on_postgres_that_everything_happens_to_gives_an_undisturbed_bakes_chunks() {
    play(|prefix| Troupe::on_postgres(WORKERS, prefix));
}

#[test]
fn farm_on_sqlite_that_everything_happens_to_gives_an_undisturbed_bakes_chunks() {
    play(|_| Troupe::on_sqlite(WORKERS));
}
