//! `kiln list`: a farm's bakes, newest first.

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use lightkiln_proto::api::{Bake, BakeFilter, BakeState};

use crate::arguments::ServerArgument;
use crate::console::{answer, put_json, say};
use crate::failure::Result;
use crate::times::{moment, utc_secs};

/// Arguments of `kiln list`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArgument,
    /// Lists bakes in this state alone; several with commas between them
    #[arg(long = "state", value_name = "STATE", value_delimiter = ',', value_parser = state())]
    states: Vec<BakeState>,
    /// Lists bakes whose names have this in them, in capitals or not
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    name: String,
    /// Lists bakes submitted since: an age (90m, 12h, 7d) or a day (2026-11-24, UTC)
    #[arg(long, value_name = "AGE", value_parser = moment)]
    since: Option<i64>,
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

/// A state by its name.
fn state() -> impl clap::builder::TypedValueParser<Value = BakeState> {
    let names = PossibleValuesParser::new(BakeState::ALL.map(BakeState::name));
    names.try_map(|name| BakeState::named(&name).ok_or("no state"))
}

/// Prints the bakes as a table or as JSON.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = arguments.server.connect()?;
    let filter = BakeFilter { states: arguments.states, name: arguments.name, since_ms: arguments.since };
    let page = client.bakes(&filter, arguments.after, arguments.limit)?;
    if arguments.json {
        put_json(&page);
        return Ok(());
    }
    if page.bakes.is_empty() {
        say!("{}", if filter == BakeFilter::default() { NONE } else { NONE_SUCH });
        return Ok(());
    }
    answer!("{:16}  {:9}  {:>13}  {:20}  {:20}  NAME", "BAKE", "STATE", "TASKS", "SUBMITTED", "ENDED");
    for bake in &page.bakes {
        answer!("{}", line(bake));
    }
    if let Some(next) = page.next {
        say!("more with --after {next}");
    }
    Ok(())
}

const NONE: &str = "no bakes here; 'kiln submit SCENE' makes one";
const NONE_SUCH: &str = "no bakes pass --state, --name and --since; 'kiln list' shows all";

fn line(bake: &Bake) -> String {
    let total: u64 = bake.stages.iter().map(|stage| stage.total).sum();
    let done: u64 = bake.stages.iter().map(|stage| stage.done).sum();
    let ended = bake.finished_ms.map_or_else(|| "-".to_owned(), utc_secs);
    let submitted = utc_secs(bake.created_ms);
    let (tasks, state) = (format!("{done}/{total}"), bake.state.name());
    format!("{:16}  {state:9}  {tasks:>13}  {submitted:20}  {ended:20}  {}", bake.id, bake.name)
}
