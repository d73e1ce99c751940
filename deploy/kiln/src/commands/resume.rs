//! `kiln resume`: ends a bake's pause.

use clap::Args;

use super::submitting::connect;
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Arguments of `kiln resume`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id
    id: String,
    #[command(flatten)]
    server: ServerArgument,
}

/// Lets the bake go on.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = connect(&arguments.server.server, &arguments.server.trust, &Interrupt::default())?;
    let bake = client.resume(&arguments.id)?;
    eprintln!("bake {} goes on", bake.id);
    Ok(())
}
