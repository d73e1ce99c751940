//! `kiln evaluate`: a bundle held against the path tracer.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::fetch::Source;
use lightkiln_client::lights::parse_camera;

use crate::console::{printable, put_json};
use crate::evaluation::{
    EvaluationArguments, check, draw, measure, scene_of_bundle, words, write_dump, write_page,
};
use crate::failure::{EXIT_CODES, Result};
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::outputs::{check_file, check_folder};
use crate::picture::parse_size;
use crate::submission::{PackedScene, SceneArguments};

/// Arguments of `kiln evaluate`.
#[derive(Args, Debug)]
#[command(after_help = EXIT_CODES)]
pub struct Arguments {
    /// Bundle folder
    bundle: PathBuf,
    /// The scene that was baked [default: where it was then]
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// Folder that holds the scene and the files that it names, as of 'kiln bake' [default: the scene's own]
    #[arg(long, value_name = "DIR", requires = "scene")]
    root: Option<PathBuf>,
    /// Folder to write a page with pictures to (evaluation.html, evaluation.json, pictures), as 'kiln site --evaluation' takes it
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Camera of the pictures of --out, e.g. "eye=0,1.6,4 target=0,1,0 fov=50" (metres, degrees) [default: the scene's
    /// first, else one is chosen and said]
    #[arg(long, value_name = "CAMERA", requires = "out")]
    camera: Option<String>,
    /// Width and height in pixels of the pictures of --out; every light takes as long as its paths do
    #[arg(long, value_name = "WxH", default_value = "256x192", value_parser = parse_size)]
    size: (u32, u32),
    /// Writes place, normal, area, baked and reference E_ind of every receiver and light
    #[arg(long, value_name = "FILE.csv")]
    dump: Option<PathBuf>,
    #[command(flatten)]
    wanted: EvaluationArguments,
    #[command(flatten)]
    lighting: LightArguments,
    /// Ends with one JSON object on standard output: scene, receivers, rel_rmse, energy_ratio, p95, p99, interval_95,
    /// area_above, classes, lights and more
    #[arg(long)]
    json: bool,
}

/// Measures, writes what is wanted, and holds the figures to the limits.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let camera = arguments.camera.as_deref().map(parse_camera).transpose()?;
    arguments.wanted.check_figures(&kinds.worker)?;
    arguments.wanted.own_lights()?;
    arguments.dump.as_deref().map_or(Ok(()), check_file)?;
    arguments.out.as_deref().map_or(Ok(()), check_folder)?;
    let source = Source::bundle(&arguments.bundle)?;
    let scene = match &arguments.scene {
        Some(path) => SceneArguments { path: path.clone(), root: arguments.root.clone() },
        None => scene_of_bundle(&arguments.bundle)?,
    };
    let scene = PackedScene::read(&scene)?;
    let measured =
        measure(kinds, &source, scene, (&arguments.wanted, &arguments.lighting), &Interrupt::default())?;
    if let Some(csv) = &arguments.dump {
        write_dump(csv, &measured)?;
    }
    eprint!("{}", printable(&words(&measured.evaluation)));
    if let Some(out) = &arguments.out {
        write_page(out, &measured, &draw(kinds, &source, &measured, camera, arguments.size)?)?;
    }
    if arguments.json {
        put_json(&measured.evaluation);
    }
    check(&arguments.wanted.fail_if, &measured.evaluation)
}
