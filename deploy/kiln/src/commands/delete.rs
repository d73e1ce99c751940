//! `kiln delete`: removes a bake that has ended.

use clap::Args;

use super::submitting::connect;
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Arguments of `kiln delete`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id
    id: String,
    #[command(flatten)]
    server: ServerArgument,
}

/// Deletes the bake with the results that no other bake holds; the server frees their room after its grace.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = connect(&arguments.server.server, &arguments.server.trust, &Interrupt::default())?;
    client.delete(&arguments.id)?;
    eprintln!("bake {} is deleted", arguments.id);
    Ok(())
}
