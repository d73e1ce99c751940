//! `kiln evaluate`: a bundle held against the path tracer.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::fetch::Source;

use super::submitting::PackedScene;
use crate::evaluation::{
    Limit, RECEIVERS, REL_ERROR, Wanted, check, draw, measure, scene_of_bundle, words, write_dump, write_page,
};
use crate::failure::{EXIT_CODES, Result};
use crate::interrupt::Interrupt;

/// Arguments of `kiln evaluate`.
#[derive(Args, Debug)]
#[command(after_help = EXIT_CODES)]
pub struct Arguments {
    /// Bundle folder
    bundle: PathBuf,
    /// The scene that was baked [default: where it was then]
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// Lights to measure with, as JSON: {"lights": [{"name": …, "type": "point|spot|sun|sky|panel|emitters", …}]}
    /// (see docs of worker/src/evaluate/light_file.rs) [default: chosen from the scene, and said]
    #[arg(long, value_name = "FILE")]
    lights: Option<PathBuf>,
    /// Standard error of the reference over the larger of the value and the mean; smaller takes longer, with its
    /// inverse square
    #[arg(long, value_name = "E", default_value_t = REL_ERROR, value_parser = parse_rel_error)]
    rel_error: f64,
    /// Receivers to measure at, spread by area
    #[arg(long, value_name = "N", default_value_t = RECEIVERS, value_parser = clap::value_parser!(u32).range(10..=1_000_000))]
    receivers: u32,
    /// Folder to write a page with pictures to (evaluation.html, evaluation.json)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Writes place, normal, area, baked and reference E_ind of every receiver and light
    #[arg(long, value_name = "FILE.csv")]
    dump: Option<PathBuf>,
    /// Fails with exit code 4 when a figure is so: rel_rmse>0.08, sun.p95>0.3, energy_ratio<0.97; may be given often
    #[arg(long, value_name = "EXPR")]
    fail_if: Vec<Limit>,
    /// Ends with one JSON object on standard output: scene, receivers, rel_rmse, energy_ratio, p95, p99, classes, lights
    /// and more
    #[arg(long)]
    json: bool,
}

/// Measures, writes what is wanted, and holds the figures to the limits.
pub fn run(arguments: Arguments) -> Result<()> {
    let source = Source::bundle(&arguments.bundle)?;
    let path = match &arguments.scene {
        Some(scene) => scene.clone(),
        None => scene_of_bundle(&arguments.bundle)?,
    };
    let scene = PackedScene::read(&path)?;
    let wanted = Wanted {
        scene: scene.name.clone(),
        lights: arguments.lights,
        rel_error: arguments.rel_error,
        receivers: arguments.receivers,
    };
    let measured = measure(&source, scene.into_bytes(), &wanted, &Interrupt::default())?;
    if let Some(csv) = &arguments.dump {
        write_dump(csv, &measured)?;
    }
    eprint!("{}", words(&measured.evaluation));
    if let Some(out) = &arguments.out {
        write_page(out, &measured, &draw(&source, &measured)?)?;
    }
    if arguments.json {
        println!("{}", serde_json::json!(measured.evaluation));
    }
    check(&arguments.fail_if, &measured.evaluation)
}

fn parse_rel_error(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(value @ 0.0005..=1.0) => Ok(value),
        _ => Err("write a number in 0.0005..=1, e.g. 0.03".to_owned()),
    }
}
