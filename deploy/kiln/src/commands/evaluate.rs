//! `kiln evaluate`: a bundle held against the path tracer.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::fetch::Source;

use super::submitting::PackedScene;
use crate::evaluation::{
    EvaluationArguments, check, draw, measure, scene_of_bundle, words, write_dump, write_page,
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
    /// Folder to write a page with pictures to (evaluation.html, evaluation.json)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Writes place, normal, area, baked and reference E_ind of every receiver and light
    #[arg(long, value_name = "FILE.csv")]
    dump: Option<PathBuf>,
    #[command(flatten)]
    wanted: EvaluationArguments,
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
    let measured = measure(&source, scene, &arguments.wanted, &Interrupt::default())?;
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
    check(&arguments.wanted.fail_if, &measured.evaluation)
}
