//! Holds objects that move through a bake against paths: `cargo run --release -p lightkiln-tests --bin transfer -- SCENE OBJECT x,y,z[,yaw]
//! [NAME=VALUE…]` bakes both at draft with those settings, those of the object as object.NAME=VALUE, and prints a table. SCENE is a file, or one_box: the Cornell box without its short box;
//! OBJECT a file, or one of box, ball, table, panel. `lights=point,sun` takes some lights, `rel_error=0.01` sets the paths' noise; `pictures=DIR
//! "camera=eye=… target=…"` draws instead.

use std::path::PathBuf;

use anyhow::{Context, Result};
use lightkiln_client::lights::parse_camera;
use lightkiln_client::scene::Stance;
use lightkiln_tests::scenes::cornell_of_one_box;
use lightkiln_tests::scenes::movers::mover;
use lightkiln_tests::studies::transfer::{HEAD, Setting, measured, packed, pictures, table};

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
    let mut object_settings = settings.clone();
    let (mut rel_error, mut lights, mut folder, mut camera) = (0.02, Vec::new(), None, None);
    for argument in arguments {
        let (name, value) =
            argument.split_once('=').with_context(|| format!("'{argument}' is not NAME=VALUE"))?;
        match name {
            "rel_error" => rel_error = value.parse()?,
            "lights" => lights = value.split(',').map(str::to_owned).collect(),
            "pictures" => folder = Some(PathBuf::from(value)),
            "camera" => camera = Some(parse_camera(value)?),
            _ if name.starts_with("object.") => {
                object_settings[&name[7..]] = serde_json::from_str(value).unwrap_or_else(|_| value.into());
            }
            _ => settings[name] = serde_json::from_str(value).unwrap_or_else(|_| value.into()),
        }
    }
    let bundle = match mover(&object) {
        Some(bytes) => bytes,
        None => packed(object.as_ref())?,
    };
    let scene = if scene == "one_box" { cornell_of_one_box() } else { packed(scene.as_ref())? };
    let setting = Setting { scene, object: bundle, stance, settings, object_settings, rel_error, lights };
    match folder {
        Some(folder) => pictures(&setting, &camera.context("pictures need camera=…")?, &folder)?,
        None => println!("{HEAD}{}", table(&object, &measured(&setting)?)?),
    }
    Ok(())
}
