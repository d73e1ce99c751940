//! `kiln cancel`: ends a bake.

use clap::Args;

use super::submitting::connect;
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Arguments of `kiln cancel`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id
    id: String,
    #[command(flatten)]
    server: ServerArgument,
}

/// Cancels the bake; what was done of it stays and is used again by a later bake.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = connect(&arguments.server.server, &arguments.server.trust, &Interrupt::default())?;
    let bake = client.cancel(&arguments.id)?;
    eprintln!("bake {} is cancelled", bake.id);
    Ok(())
}
