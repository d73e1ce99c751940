//! `kiln logs`: what happened to a bake, a line an event.

use std::io::Write as _;
use std::time::Duration;

use clap::Args;
use lightkiln_proto::api::{BakeEvent, EventKind};

use super::show::state_word;
use super::submitting::connect;
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Seconds that one poll waits for news; short, so that Ctrl-C is heard soon.
const POLL_SECS: u32 = 1;

/// Arguments of `kiln logs`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id
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
    let client = connect(&arguments.server.server, &arguments.server.trust, &interrupt)?;
    let wait_secs = if arguments.follow { POLL_SECS } else { 0 };
    let mut seen = 0;
    let mut out = std::io::stdout().lock();
    while !interrupt.is_raised() {
        let page = client.events(&arguments.id, seen, wait_secs)?;
        for event in &page.events {
            seen = event.seq;
            let line = if arguments.json { serde_json::json!(event).to_string() } else { words(event) };
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
        EventKind::TaskDone { kind, label, worker, .. } => format!("done      {kind} {label} by {worker}"),
        EventKind::TaskFailed { kind, label, worker, message, retry, .. } => {
            let next = if *retry { "it will be tried again" } else { "it was given up" };
            format!("failed    {kind} {label} by {worker}, {next}: {message}")
        }
        EventKind::LeaseExpired { key, worker } => {
            format!("expired   task {key}: worker {worker} was not heard from, or took too long")
        }
        EventKind::State { state } => format!("state     {}", state_word(*state)),
    };
    format!("{}  {what}", utc(event.at_ms))
}

/// A time as `2026-01-31T12:00:00.000Z`.
fn utc(unix_ms: i64) -> String {
    let (days, ms) = (unix_ms.div_euclid(86_400_000), unix_ms.rem_euclid(86_400_000));
    let time = Duration::from_millis(ms.unsigned_abs());
    let (secs, ms) = (time.as_secs(), time.subsec_millis());
    let (year, month, day) = date(days);
    let (hour, minute, second) = (secs / 3600, secs / 60 % 60, secs % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

/// Year, month and day of a day counted from 1970-01-01, in the Gregorian calendar.
fn date(days: i64) -> (i64, i64, i64) {
    // Years begin in March here, so that the leap day is their last; an era has 400 of them.
    let days = days + 719_468;
    let (era, day_of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + 400 * era + i64::from(month <= 2);
    (year, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

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
