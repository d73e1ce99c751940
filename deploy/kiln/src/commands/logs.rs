//! `kiln logs`: what happened to a bake, a line an event.

use std::io::Write as _;

use clap::Args;
use lightkiln_proto::api::{BakeEvent, Blame, EventKind};
use lightkiln_proto::ids::Digest;

use crate::arguments::ServerArgument;
use crate::console::printable;
use crate::failure::Result;
use crate::interrupt::Interrupt;
use crate::times::utc;

/// Seconds that one poll waits for news; short, so that Ctrl-C is heard soon.
const POLL_SECS: u32 = 1;

/// Arguments of `kiln logs`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    #[command(flatten)]
    server: ServerArgument,
    /// Goes on until the bake ends
    #[arg(long, short)]
    follow: bool,
    /// Prints an event of the API as JSON on each line
    #[arg(long)]
    json: bool,
}

/// Prints the events in order; Ctrl-C ends it, not the bake.
pub fn run(arguments: Arguments) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let client = arguments.server.connect_until(&interrupt)?;
    let wait_secs = if arguments.follow { POLL_SECS } else { 0 };
    let mut seen = 0;
    let mut out = std::io::stdout().lock();
    while !interrupt.is_raised() {
        let page = client.events(&arguments.id, seen, wait_secs)?;
        for event in &page.events {
            seen = event.seq;
            let line = if arguments.json {
                serde_json::json!(event).to_string()
            } else {
                printable(&words(event)).into_owned()
            };
            // Whoever reads may have had enough.
            if writeln!(out, "{line}").is_err() {
                return Ok(());
            }
        }
        let has_ended = page.bake.state.is_final() || !arguments.follow;
        if has_ended && page.events.is_empty() {
            break;
        }
    }
    Ok(())
}

fn words(event: &BakeEvent) -> String {
    let what = match &event.event {
        EventKind::Submitted => "submitted".to_owned(),
        EventKind::Planned { tasks, reused } => {
            format!("planned   {tasks} tasks, {reused} of them done before")
        }
        EventKind::TaskStarted { kind, label, worker, attempt, .. } => {
            format!("started   {kind} {label} on {worker}{}", which(*attempt))
        }
        EventKind::TaskDone { kind, label, worker, attempt, elapsed_ms, note, .. } => {
            let note = if note.is_empty() { String::new() } else { format!("; {note}") };
            format!("done      {kind} {label} by {worker}{}{}{note}", took(*elapsed_ms), which(*attempt))
        }
        EventKind::TaskFailed {
            kind,
            label,
            worker,
            message,
            retry,
            blame,
            attempt,
            elapsed_ms,
            wait_ms,
            ..
        } => {
            let how = if *blame == Blame::Lost { "lost      " } else { "failed    " };
            let next = match retry {
                true => format!("tried again after {}", secs(*wait_ms)),
                false => "given up".to_owned(),
            };
            let (took, which) = (took(*elapsed_ms), which(*attempt));
            format!("{how}{kind} {label} by {worker}{took}{which}, {next}: {message}")
        }
        EventKind::LeaseExpired { kind, label, worker, attempt, elapsed_ms, took_too_long, .. } => {
            let why = match took_too_long {
                true => "took longer than an attempt may (--attempt-limit-secs)",
                false => "was not heard from",
            };
            format!("expired   {kind} {label}{}{}: {worker} {why}", took(*elapsed_ms), which(*attempt))
        }
        EventKind::TaskReleased { kind, label, worker, elapsed_ms, .. } => {
            format!("released  {kind} {label} by {worker}{}, which was told to stop", took(*elapsed_ms))
        }
        EventKind::ResultLost { kind, label, .. } => {
            format!("bytes     {kind} {label}: the bytes of its result are gone, it runs again")
        }
        EventKind::ResultDiffers { kind, label, worker, output, kept, found, .. } => {
            let digest = |digest: &Option<Digest>| {
                digest.map_or_else(|| "absent".to_owned(), |digest| digest.to_string())
            };
            let by = if worker.is_empty() { String::new() } else { format!(" by {worker}") };
            let (kept, found) = (digest(kept), digest(found));
            format!(
                "ALARM     {kind} {label}: another attempt{by} gave other bytes for '{output}', {found} instead of {kept}"
            )
        }
        EventKind::State { state } => format!("state     {}", state.name()),
    };
    format!("{}  {what}", utc(event.at_ms))
}

fn secs(ms: u64) -> String {
    format!("{:.1} s", ms as f64 / 1e3)
}

/// How long it took; nothing for events from before that was noted.
fn took(elapsed_ms: u64) -> String {
    if elapsed_ms == 0 { String::new() } else { format!(" in {}", secs(elapsed_ms)) }
}

/// Which attempt it was, where it was not the first.
fn which(attempt: u32) -> String {
    if attempt < 2 { String::new() } else { format!(" (attempt {attempt})") }
}

/// A time as `2026-01-31T12:00:00.000Z`.
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_say_who_did_what_how_long_it_took_and_what_comes_next() {
        let task =
            || (Digest::of(b"task"), "prt.transport".to_owned(), "cluster 7".to_owned(), "oven".to_owned());
        let (key, kind, label, worker) = task();
        let failed = EventKind::TaskFailed {
            key,
            kind,
            label,
            worker,
            message: "out of memory".to_owned(),
            retry: true,
            blame: Blame::Worker,
            attempt: 2,
            elapsed_ms: 61_250,
            wait_ms: 1_730,
        };
        let (key, kind, label, worker) = task();
        let (attempt, elapsed_ms, took_too_long) = (1, 30_000, false);
        let expired =
            EventKind::LeaseExpired { key, kind, label, worker, attempt, elapsed_ms, took_too_long };
        let (key, kind, label, worker) = task();
        let started = EventKind::TaskStarted { key, kind, label, worker, attempt: 3 };
        let start = "1970-01-01T00:00:00.000Z  ";
        for (event, line) in [
            (
                failed,
                "failed    prt.transport cluster 7 by oven in 61.2 s (attempt 2), tried again after 1.7 s: out of memory",
            ),
            (expired, "expired   prt.transport cluster 7 in 30.0 s: oven was not heard from"),
            (started, "started   prt.transport cluster 7 on oven (attempt 3)"),
        ] {
            assert_eq!(words(&BakeEvent { seq: 1, at_ms: 0, event }), format!("{start}{line}"));
        }
    }

    #[test]
    fn times_are_told_in_the_gregorian_calendar() {
        for (unix_ms, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (1_709_251_199_999, "2024-02-29T23:59:59.999Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
            (-1, "1969-12-31T23:59:59.999Z"),
        ] {
            assert_eq!(utc(unix_ms), text);
        }
    }
}
