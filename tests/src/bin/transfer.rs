//! Holds objects that move through a bake against paths: `cargo run --release -p lightkiln-tests --bin transfer -- SCENE OBJECT x,y,z[,yaw]
//! [NAME=VALUE…]` bakes both at draft with those settings, and prints a table. OBJECT is a file, or one of box, ball, table, panel.

use anyhow::{Context, Result};
use lightkiln_client::scene::Stance;
use lightkiln_tests::scenes::movers::mover;
use lightkiln_tests::studies::transfer::{HEAD, Setting, measured, packed, table};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().context("name a scene")?;
    let object = arguments.next().context("name an object")?;
    let place = arguments.next().context("give its place x,y,z or x,y,z,yaw")?;
    let numbers: Vec<f32> = place.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let mut stance = Stance::default();
    stance.position_m.copy_from_slice(numbers.get(..3).context("a place has three numbers")?);
    stance.turn_deg[0] = numbers.get(3).copied().unwrap_or(0.0);
    let mut settings = serde_json::json!({ "preset": "draft" });
    let mut rel_error = 0.02;
    for argument in arguments {
        let (name, value) =
            argument.split_once('=').with_context(|| format!("'{argument}' is not NAME=VALUE"))?;
        if name == "rel_error" {
            rel_error = value.parse()?;
        } else {
            settings[name] = serde_json::from_str(value).unwrap_or_else(|_| value.into());
        }
    }
    let bundle = match mover(&object) {
        Some(bytes) => bytes,
        None => packed(object.as_ref())?,
    };
    let setting = Setting { scene: packed(scene.as_ref())?, object: bundle, stance, settings, rel_error };
    println!("{HEAD}{}", table(&object, &measured(&setting)?)?);
    Ok(())
}
