//! `kiln list`: a farm's bakes, newest first.

use clap::Args;

use crate::arguments::ServerArgument;
use crate::console::{answer, say};
use crate::failure::Result;

/// Arguments of `kiln list`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArgument,
    /// Lists at most this many
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=100))]
    limit: u32,
    /// Goes on behind this number, which the page before ended with
    #[arg(long, value_name = "NUMBER")]
    after: Option<u64>,
    /// Prints the page as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the bakes as a table or as JSON.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = arguments.server.connect()?;
    let page = client.bakes(arguments.after, arguments.limit)?;
    if arguments.json {
        println!("{}", serde_json::json!(page));
        return Ok(());
    }
    for bake in &page.bakes {
        let total: u64 = bake.stages.iter().map(|stage| stage.total).sum();
        let done: u64 = bake.stages.iter().map(|stage| stage.done).sum();
        answer!("{}  {:9}  {:>6}/{:<6}  {}", bake.id, bake.state.name(), done, total, bake.name);
    }
    if page.bakes.is_empty() {
        say!("no bakes here; 'kiln submit SCENE' makes one");
    }
    if let Some(next) = page.next {
        say!("more with --after {next}");
    }
    Ok(())
}
