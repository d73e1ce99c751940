//! `kiln top`: a farm's bakes and workers, as they are now.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::time::{Duration, Instant};

use clap::Args;
use lightkiln_proto::api::{Bake, BakeFilter, StageCount, Worker};
use lightkiln_server::clock::{Clock as _, SystemClock};
use lightkiln_worker::runtime::Level;

use crate::arguments::ServerArgument;
use crate::console::printable;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::progress::estimate::{Estimate, Estimator};
use crate::progress::line::duration_words;

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
    let (began, mut estimators) = (Instant::now(), BTreeMap::<String, Estimator>::new());
    loop {
        let bakes = client.bakes(&BakeFilter::default(), None, arguments.limit)?.bakes;
        let workers = client.workers()?.workers;
        estimators.retain(|id, _| bakes.iter().any(|bake| bake.id == *id));
        let estimated: Vec<(Bake, Estimate)> = bakes
            .into_iter()
            .map(|bake| {
                let estimator = estimators.entry(bake.id.clone()).or_default();
                let estimate = estimator.observe(&bake, began.elapsed());
                (bake, estimate)
            })
            .collect();
        let table = table(&estimated, &workers, SystemClock.now_ms());
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

fn table(bakes: &[(Bake, Estimate)], workers: &[Worker], now_ms: i64) -> String {
    let mut text = format!(
        "{:16}  {:9}  {:>5}  {:>15}  {:>5}  {:>6}  {:>11}  NAME\n",
        "BAKE", "STATE", "PRIO", "TASKS", "HELD", "DONE", "LEFT"
    );
    for (bake, estimate) in bakes {
        let sum = |count: fn(&StageCount) -> u64| bake.stages.iter().map(count).sum::<u64>();
        let (done, total) = (sum(|stage| stage.done), sum(|stage| stage.total));
        let share = 100.0 * estimate.share;
        let left = estimate.left.map_or_else(|| "-".to_owned(), duration_words);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_and_time_left_are_those_of_every_other_command() {
        let digest = lightkiln_proto::ids::Digest::of(b"");
        let bake: Bake = serde_json::from_value(serde_json::json!({
            "id": "b", "name": "n", "kind": "prt", "scene": digest, "settings": null, "priority": 0,
            "state": "running", "stages": [], "tasks_run": 0, "tasks_reused": 0, "failure": null,
            "manifest": null, "report": null, "created_ms": 1_000, "finished_ms": null,
            "counters": {}, "counters_reused": {},
        }))
        .unwrap();
        let estimate = Estimate { share: 0.25, left: Some(Duration::from_secs(185)) };
        let text = table(&[(bake.clone(), estimate), (bake, Estimate::default())], &[], 61_000);
        let rows: Vec<&str> = text.lines().collect();
        assert!(rows[0].contains("LEFT") && rows[1].contains("25.0%") && rows[1].contains("3 min"), "{text}");
        assert!(rows[2].contains("0.0%") && rows[2].contains(" - "), "{text}");
    }
}
