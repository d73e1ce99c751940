//! `kiln top`: a farm's bakes and workers, as they are now.

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use clap::Args;
use lightkiln_proto::api::{Bake, Worker};
use lightkiln_server::clock::{Clock as _, SystemClock};
use lightkiln_worker::runtime::Level;

use crate::arguments::ServerArgument;
use crate::console::printable;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;

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
        let bakes = client.bakes(None, arguments.limit)?.bakes;
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
        "{:16}  {:9}  {:>5}  {:>15}  {:>5}  {:>6}  NAME\n",
        "BAKE", "STATE", "PRIO", "TASKS", "HELD", "DONE"
    );
    for bake in bakes {
        let sum =
            |count: fn(&lightkiln_proto::api::StageCount) -> u64| bake.stages.iter().map(count).sum::<u64>();
        let (done, total) = (sum(|stage| stage.done), sum(|stage| stage.total));
        let (cost_done, cost_total) = (sum(|stage| stage.cost_done), sum(|stage| stage.cost_total));
        let share = 100.0 * cost_done as f64 / cost_total.max(1) as f64;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:16}  {:9}  {:>5}  {:>15}  {:>5}  {share:>5.1}%  {}",
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
