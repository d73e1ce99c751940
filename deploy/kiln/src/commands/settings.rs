//! `kiln settings`: every setting of a kind of bake with its range, presets and effect.

use clap::Args;
use lightkiln_proto::kinds::{Kind, Kinds};
use lightkiln_proto::settings::SettingRow;
use serde_json::{Value, json};

use crate::console::{answer, put_json};
use crate::failure::Result;
use crate::settings::kind_named;

/// Arguments of `kiln settings`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Kind of bake [default: the first that is listed at the end]
    #[arg(long, default_value = "", hide_default_value = true)]
    kind: String,
    /// Prints them as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the table for people or as JSON.
pub fn run(arguments: Arguments, kinds: &Kinds) -> Result<()> {
    let kind = kind_named(kinds, &arguments.kind)?;
    let rows = kind.settings();
    if arguments.json {
        put_json(&rows.iter().map(as_json).collect::<Vec<_>>());
        return Ok(());
    }
    answer!("{}: {}\n", kind.name(), kind.about());
    answer!("{:22} {:>10} {:>10} {:>10}  range", "setting", "draft", "medium", "high");
    for row in &rows {
        let [draft, medium, high] = row.presets.each_ref().map(short);
        answer!("{:22} {draft:>10} {medium:>10} {high:>10}  {}", row.name, row.range);
        answer!("    {}\n", row.effect.trim());
    }
    answer!("set one with --set SETTING=VALUE, KILN_SET_<SETTING> or in a file given with --settings\n");
    answer!("kinds of bake, for --kind:");
    kinds.iter().for_each(|kind: &dyn Kind| answer!("  {:8} {}", kind.name(), kind.about()));
    Ok(())
}

fn as_json(row: &SettingRow) -> Value {
    let [draft, medium, high] = &row.presets;
    let (name, range, effect) = (row.name, row.range, row.effect.trim());
    json!({ "name": name, "range": range, "draft": draft, "medium": medium, "high": high, "effect": effect })
}

/// A word without quotes, a number as it is.
fn short(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}
