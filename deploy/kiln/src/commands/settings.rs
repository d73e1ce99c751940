//! `kiln settings`: every setting of a bake with its range, presets and effect.

use clap::Args;
use lightkiln_proto::prt::{SettingRow, Settings};
use serde_json::json;

use crate::failure::Result;

/// Arguments of `kiln settings`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Prints them as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the table for people or as JSON.
pub fn run(arguments: Arguments) -> Result<()> {
    if arguments.json {
        println!("{}", json!(Settings::TABLE.iter().map(as_json).collect::<Vec<_>>()));
        return Ok(());
    }
    println!("{:22} {:>10} {:>10} {:>10}  range", "setting", "draft", "medium", "high");
    for row in Settings::TABLE {
        let [draft, medium, high] = row.presets.map(short);
        println!("{:22} {draft:>10} {medium:>10} {high:>10}  {}", row.name, row.range);
        println!("    {}\n", row.effect.trim());
    }
    println!("set one with --set SETTING=VALUE, KILN_SET_<SETTING> or in a file given with --settings");
    Ok(())
}

fn as_json(row: &SettingRow) -> serde_json::Value {
    let [draft, medium, high] = row.presets;
    let (name, range, effect) = (row.name, row.range, row.effect.trim());
    json!({ "name": name, "range": range, "draft": draft, "medium": medium, "high": high, "effect": effect })
}

/// The table's values were f32 once: nine digits of 0.04_f32 help nobody.
fn short(value: f64) -> String {
    (value as f32).to_string()
}
