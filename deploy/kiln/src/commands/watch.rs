//! `kiln watch`: follows a bake until it ends.

use clap::Args;

use super::following::follow;
use super::submitting::connect;
use crate::arguments::ServerArgument;
use crate::failure::Result;
use crate::interrupt::Interrupt;

/// Arguments of `kiln watch`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id
    id: String,
    #[command(flatten)]
    server: ServerArgument,
}

/// Shows progress until the bake is done; the exit code says how it ended. Ctrl-C ends the watch, not the bake.
pub fn run(arguments: Arguments) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let client = connect(&arguments.server.server, &arguments.server.trust, &interrupt)?;
    let bake = follow(&client, &arguments.id, &interrupt, || Ok(()))?;
    eprintln!("done; 'kiln fetch {} --out DIR' downloads it", bake.id);
    Ok(())
}
