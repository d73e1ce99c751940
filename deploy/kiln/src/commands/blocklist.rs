//! `kiln blocklist`: workers that failed at tasks of a bake.

use clap::Args;

use crate::arguments::ServerArgument;
use crate::console::{answer, put_json, say};
use crate::failure::Result;

/// Arguments of `kiln blocklist`.
#[derive(Args, Debug)]
#[command(
    after_help = "A worker that failed at several tasks of a bake gets none of it any more while another worker can do them."
)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    #[command(flatten)]
    server: ServerArgument,
    /// Forgets the failures: of the worker named by --worker, or of all
    #[arg(long)]
    clear: bool,
    /// The worker whose failures --clear forgets
    #[arg(long, value_name = "NAME", requires = "clear")]
    worker: Option<String>,
    /// Prints the list as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the list, or what is left of it.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = arguments.server.connect()?;
    let list = if arguments.clear {
        client.clear_blocklist(&arguments.id, arguments.worker.as_deref())?
    } else {
        client.blocklist(&arguments.id)?
    };
    if arguments.json {
        put_json(&list);
        return Ok(());
    }
    for entry in &list.workers {
        let state = if entry.is_blocked { "blocked" } else { "allowed" };
        answer!("{:32}  {state}  failed at {} tasks", entry.worker, entry.tasks);
    }
    if list.workers.is_empty() {
        say!("no worker failed at a task of this bake");
    }
    Ok(())
}
