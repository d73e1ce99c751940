//! Holds voxel cone tracing as the paper has it, and mended, against rays, beside walks through voxels:
//! `cargo run --release -p lightkiln-tests --bin voxels -- SCENE [NAME=VALUE…]` bakes the scene at draft with `voxels=on` and prints a table of errors;
//! with `table=steps` it prints times and bytes instead, and bakes nothing. `leaks` in place of a scene prints light that comes through walls.
//! `pictures=FOLDER` writes pictures too.

use anyhow::{Context, Result, bail};
use lightkiln_tests::studies::voxels::{Build, Kind, Model, Options, Sampling, leaks, measured, steps};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().context("name a scene: a glTF or GLB file")?;
    let mut options = Options {
        bake: serde_json::json!({ "preset": "draft", "voxels": "on" }),
        build: Build { depth: 7, shadow_map: 512, sampling: Sampling::Paper, start: 2.0 },
        kinds: Kind::ALL.to_vec(),
        light: "point".to_owned(),
        sites: 300,
        pictures: None,
    };
    let mut is_of_steps = false;
    for argument in arguments {
        let (name, value) =
            argument.split_once('=').with_context(|| format!("'{argument}' is not NAME=VALUE"))?;
        match name {
            "model" => {
                let model = model(value)?;
                options.kinds.retain(|kind| kind.model == model);
            }
            "depth" => options.build.depth = value.parse()?,
            "start" => options.build.start = value.parse()?,
            "shadow_map" => options.build.shadow_map = value.parse()?,
            "sampling" => options.build.sampling = sampling(value)?,
            "light" => options.light = value.to_owned(),
            "table" => is_of_steps = is_steps(value)?,
            "pictures" => options.pictures = Some(value.into()),
            "sites" => options.sites = value.parse()?,
            _ => options.bake[name] = serde_json::from_str(value).unwrap_or_else(|_| value.into()),
        }
    }
    let page = match scene.as_str() {
        "leaks" => leaks(&options.build)?,
        scene if is_of_steps => steps(scene.as_ref(), &options.build)?,
        scene => measured(scene.as_ref(), &options)?,
    };
    println!("{page}");
    Ok(())
}

fn is_steps(value: &str) -> Result<bool> {
    Ok(match value {
        "errors" => false,
        "steps" => true,
        _ => bail!("there is no table '{value}'; there are errors and steps"),
    })
}

fn model(value: &str) -> Result<Model> {
    Ok(match value {
        "axes" => Model::Axes,
        "lobes" => Model::Lobes,
        _ => bail!("there is no model '{value}'; there are axes and lobes"),
    })
}

fn sampling(value: &str) -> Result<Sampling> {
    Ok(match value {
        "paper" => Sampling::Paper,
        "levels" => Sampling::Levels,
        "diameters" => Sampling::Diameters,
        _ => bail!("there is no sampling '{value}'; there are paper, levels and diameters"),
    })
}
