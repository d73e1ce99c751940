//! `kiln`: every role of Lightkiln as a subcommand. Bakes relightable global illumination for glTF scenes.

mod arguments;
mod bundle;
mod commands;
mod embedded;
mod enrolment;
mod evaluation;
mod failure;
mod inspection;
mod interrupt;
mod junit;
mod logging;
mod picture;
mod progress;
mod settings;
mod summary;
#[cfg(test)]
mod tests;

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    let arguments = arguments::Arguments::parse();
    logging::start();
    match arguments.command.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprint!("{failure}");
            failure.exit().into()
        }
    }
}
