//! `kiln`: every role of Lightkiln as a subcommand. Bakes relightable global illumination for glTF scenes.
//!
//! The program is a function of the kinds of bake that it knows ([`run`]), so that another program can add its own.

mod arguments;
mod bundle;
mod command_line;
mod commands;
mod console;
mod edit;
mod embedded;
mod enrolment;
mod evaluation;
mod explanation;
mod failure;
mod following;
mod forecast;
mod inspection;
mod interrupt;
mod junit;
pub mod kinds;
mod lighting;
mod logging;
mod movers;
mod objects;
mod outputs;
pub mod pages;
mod picture;
mod progress;
mod reel;
mod settings;
mod sky;
mod submission;
mod summary;
mod telemetry;
#[cfg(test)]
mod tests;
mod times;

use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _};
use tracing::Span;

use command_line::CommandLine;
pub use evaluation::amid;
pub use failure::{Failure, Result};
use kinds::KindTables;

/// Runs the command line of this process to its end; bakes may be of `kinds`.
pub fn run(kinds: &KindTables) -> ExitCode {
    let matches = CommandLine::command().get_matches();
    let role = matches.subcommand_name().unwrap_or_default();
    let command = CommandLine::from_arg_matches(&matches).unwrap_or_else(|error| error.exit()).command;
    // Ends, and exports what is left, when the command has.
    let _telemetry = logging::start(role, command.stays());
    // A server and a worker live for months: what they do belongs to the traces of those who ask for it.
    let span = if command.stays() { Span::none() } else { telemetry::command_span(role) };
    match span.in_scope(|| command.run(kinds)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprint!("{}", console::printable(&failure.to_string()));
            failure.exit().into()
        }
    }
}
