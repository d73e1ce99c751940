//! `kiln top`: a farm's bakes and workers, as they are now.

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use clap::Args;
use lightkiln_proto::api::{Bake, BakeFilter, BakeState, StageCount, Worker};
use lightkiln_server::clock::{Clock as _, SystemClock};
use lightkiln_worker::runtime::Level;

use crate::arguments::ServerArgument;
use crate::console::printable;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::progress::duration_words;

/// Clears the terminal and goes to its first line.
const CLEAR: &str = "\x1b[2J\x1b[H";

/// Arguments of `kiln top`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArgument,
    /// Seconds between two looks
    #[arg(long, value_name = "SECS", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=3600))]
    interval_secs: u32,
    /// Lists at most this many bakes, newest first
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=500))]
    limit: u32,
    /// Prints the table once; so it is where standard output is no terminal
    #[arg(long)]
    once: bool,
}

/// Prints the table again and again until Ctrl-C.
pub fn run(arguments: Arguments) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let client = arguments.server.connect_until(&interrupt)?;
    let is_live = !arguments.once && std::io::stdout().is_terminal();
    loop {
        let bakes = client.bakes(&BakeFilter::default(), None, arguments.limit)?.bakes;
        let workers = client.workers()?.workers;
        let table = table(&bakes, &workers, SystemClock.now_ms());
        let mut out = std::io::stdout().lock();
        let written = write!(out, "{}{}", if is_live { CLEAR } else { "" }, printable(&table))
            .and_then(|()| out.flush());
        written
            .map_err(|error| Failure::new(Exit::Failed, "the table cannot be written").caused_by(&error))?;
        drop(out);
        let wait = Duration::from_secs(arguments.interval_secs.into());
        if !is_live || interrupt.flag().wait(wait, |level| level > Level::Run) > Level::Run {
            return Ok(());
        }
    }
}

fn table(bakes: &[Bake], workers: &[Worker], now_ms: i64) -> String {
    let mut text = format!(
        "{:16}  {:9}  {:>5}  {:>15}  {:>5}  {:>6}  {:>11}  NAME\n",
        "BAKE", "STATE", "PRIO", "TASKS", "HELD", "DONE", "LEFT"
    );
    for bake in bakes {
        let sum = |count: fn(&StageCount) -> u64| bake.stages.iter().map(count).sum::<u64>();
        let (done, total) = (sum(|stage| stage.done), sum(|stage| stage.total));
        let (cost_done, cost_total) = (sum(|stage| stage.cost_done), sum(|stage| stage.cost_total));
        let share = 100.0 * cost_done as f64 / cost_total.max(1) as f64;
        let left = time_left(bake, now_ms).map_or_else(|| "-".to_owned(), duration_words);
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:16}  {:9}  {:>5}  {:>15}  {:>5}  {share:>5.1}%  {left:>11}  {}",
            bake.id,
            bake.state.name(),
            bake.priority,
            format!("{done}/{total}"),
            sum(|stage| stage.leased),
            bake.name
        );
    }
    let _ = writeln!(text, "\n{:32}  {:>7}  {:>10}  {:>7}  HOLDS", "WORKER", "THREADS", "MEMORY", "HEARD");
    for worker in workers {
        let heard_secs = (now_ms - worker.seen_ms).max(0) / 1000;
        let _ = writeln!(
            text,
            "{:32}  {:>7}  {:>6} MiB  {:>6}s  {}",
            worker.name,
            worker.threads,
            worker.memory_mib,
            heard_secs,
            worker.holds.join(", ")
        );
    }
    text
}

/// Time that the bake still takes, at the pace of the cost that its tasks had so far; what was done before it came counts
/// for nothing. None where nothing is under way, or nothing has been done yet.
fn time_left(bake: &Bake, now_ms: i64) -> Option<Duration> {
    if bake.state != BakeState::Running {
        return None;
    }
    let reused =
        |stage: &StageCount| stage.cost_total as f64 * stage.reused as f64 / stage.total.max(1) as f64;
    let sum = |cost: &dyn Fn(&StageCount) -> f64| bake.stages.iter().map(cost).sum::<f64>();
    let here = sum(&|stage| (stage.cost_done as f64 - reused(stage)).max(0.0));
    let open = sum(&|stage| stage.cost_total.saturating_sub(stage.cost_done) as f64);
    let secs = (now_ms - bake.created_ms).max(0) as f64 / 1e3;
    Duration::try_from_secs_f64(secs * open / here).ok().filter(|_| here > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bake(state: BakeState, stages: &[(u64, u64, u64, u64)]) -> Bake {
        let stage = |&(total, reused, cost_total, cost_done): &(u64, u64, u64, u64)| {
            serde_json::json!({
                "kind": "prt.transport", "total": total, "done": 0, "reused": reused, "leased": 1,
                "cost_total": cost_total, "cost_done": cost_done, "elapsed_ms": 0,
            })
        };
        let stages: Vec<_> = stages.iter().map(stage).collect();
        let digest = lightkiln_proto::ids::Digest::of(b"");
        serde_json::from_value(serde_json::json!({
            "id": "b", "name": "n", "kind": "prt", "scene": digest, "settings": null, "priority": 0,
            "state": state, "stages": stages, "tasks_run": 0, "tasks_reused": 0, "failure": null,
            "manifest": null, "report": null, "created_ms": 1_000, "finished_ms": null,
            "counters": {}, "counters_reused": {},
        }))
        .unwrap()
    }

    #[test]
    fn time_left_is_told_of_bakes_that_run_by_the_cost_of_their_own_tasks() {
        let left = |state, stages: &[_]| time_left(&bake(state, stages), 61_000).map(|left| left.as_secs());
        // A quarter of the cost in a minute.
        assert_eq!(left(BakeState::Running, &[(1, 0, 100, 100), (9, 0, 300, 0)]), Some(180));
        // Two of the ten tasks were done before: they took no time here.
        assert_eq!(left(BakeState::Running, &[(10, 2, 1000, 400)]), Some(180));
        assert_eq!(left(BakeState::Running, &[(10, 10, 1000, 1000), (1, 0, 50, 0)]), None);
        assert_eq!(left(BakeState::Running, &[]), None);
        assert_eq!(left(BakeState::Paused, &[(10, 0, 1000, 400)]), None);
        assert_eq!(left(BakeState::Done, &[(10, 0, 1000, 1000)]), None);
        let text = table(&[bake(BakeState::Running, &[(4, 0, 400, 100)])], &[], 61_000);
        assert!(text.contains("LEFT") && text.contains("3 min"), "{text}");
    }
}
