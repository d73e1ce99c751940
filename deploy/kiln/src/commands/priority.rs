//! `kiln priority`: changes which bakes go first.

use clap::Args;

use crate::arguments::ServerArgument;
use crate::console::say;
use crate::failure::Result;

/// Arguments of `kiln priority`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    /// Its new priority; bigger runs first
    #[arg(allow_negative_numbers = true)]
    priority: i32,
    #[command(flatten)]
    server: ServerArgument,
}

/// Changes the bake's priority; tasks under way go on.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = arguments.server.connect()?;
    let bake = client.reprioritise(&arguments.id, arguments.priority)?;
    say!("bake {} has priority {}", bake.id, bake.priority);
    Ok(())
}
