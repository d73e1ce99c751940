//! Holds walks through voxels against rays: `cargo run --release -p lightkiln-tests --bin walks -- SCENE [NAME=VALUE…]` bakes the scene at
//! draft with `voxels=on` and those settings, and prints a table.

use anyhow::{Context, Result};
use lightkiln_tests::studies::walks::measured;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let scene =
        arguments.next().context("name a scene: a GLB file, or a glTF file without others beside it")?;
    let mut settings = serde_json::json!({ "preset": "draft", "voxels": "on" });
    for argument in arguments {
        let (name, value) =
            argument.split_once('=').with_context(|| format!("'{argument}' is not NAME=VALUE"))?;
        settings[name] = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    }
    println!("{}", measured(scene.as_ref(), settings)?);
    Ok(())
}
