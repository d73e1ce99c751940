//! `kiln pause`: holds a bake's tasks back.

use clap::Args;

use super::submitting::connect;
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Arguments of `kiln pause`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id
    id: String,
    #[command(flatten)]
    server: ServerArgument,
}

/// Pauses the bake; tasks under way go on.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = connect(&arguments.server.server, &arguments.server.trust, &Interrupt::default())?;
    let bake = client.pause(&arguments.id)?;
    eprintln!("bake {} is paused; 'kiln resume {}' lets it go on", bake.id, bake.id);
    Ok(())
}
