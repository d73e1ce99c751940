//! `kiln watch`: follows a bake until it ends.

use clap::Args;

use crate::arguments::{PatienceArgument, ServerArgument};
use crate::console::say;
use crate::failure::Result;
use crate::following::follow;
use crate::interrupt::Interrupt;

/// Arguments of `kiln watch`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    #[command(flatten)]
    server: ServerArgument,
    #[command(flatten)]
    patience: PatienceArgument,
}

/// Shows progress until the bake is done; the exit code says how it ended. Ctrl-C ends the watch, not the bake.
pub fn run(arguments: Arguments) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let client = arguments.patience.with(arguments.server.connect_until(&interrupt)?);
    let bake = follow(&client, &arguments.id, &interrupt, || Ok(None))?;
    say!("done; 'kiln fetch {} --out DIR' downloads it", bake.id);
    Ok(())
}
