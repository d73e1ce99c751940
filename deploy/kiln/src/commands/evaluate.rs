//! `kiln evaluate`: a bundle, or a bake on a farm, held against the path tracer.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use clap::Args;
use lightkiln_client::fetch::ApiClient;
use lightkiln_client::lights::parse_camera;
use lightkiln_proto::evaluation::{EvaluationFile, EvaluationIndex, EvaluationMedia, STILLS};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::scene::SceneCamera;

use super::site::{evaluation, stills};
use crate::arguments::BakeArgument;
use crate::console::{printable, put_json, say};
use crate::evaluation::{
    EvaluationArguments, Wanted, check, check_objects, draw, evaluate, measure, object_words,
    packed_scene_of_bundle, part_of_bundle, words, write_dump, write_objects, write_page, write_pixels,
};
use crate::failure::{EXIT_CODES, Failure, Result};
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::objects::{ObjectArgument, parse_object};
use crate::outputs::{check_file, check_folder};
use crate::picture::parse_size;
use crate::submission::{PackedScene, SceneArguments};

/// Arguments of `kiln evaluate`.
#[derive(Args, Debug)]
#[command(after_help = EXIT_CODES)]
pub struct Arguments {
    #[command(flatten)]
    source: BakeArgument,
    /// The scene that was baked [default: where it was then; with --server, as the farm has it]
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// Folder that holds the scene and the files that it names, as of 'kiln bake' [default: the scene's own]
    #[arg(long, value_name = "DIR", requires = "scene")]
    root: Option<PathBuf>,
    /// Object to measure amid the bake, instead of the bake's own places: "FILE [pos=x,y,z] [turn=yaw,pitch,roll] …", as of 'kiln preview
    /// --object', where FILE is the bundle of an object's own bake; may be given often, each is measured alone. Without words it stands in
    /// the open, beside a wall and in a doorway, as far as it fits, at places chosen from the scene. Near it are --receivers places, half as
    /// many elsewhere and on its own surface. --fail-if then names near_rel_rmse, near_energy_ratio, near_ratio, all_rel_rmse,
    /// all_energy_ratio, own_rel_rmse or own_energy_ratio
    #[arg(
        long,
        value_name = "OBJECT",
        value_parser = parse_object,
        conflicts_with_all = ["attach", "dump", "dump_pixels", "pixels", "place"]
    )]
    objects: Vec<ObjectArgument>,
    /// Folder to write a page with pictures to (evaluation.html, evaluation.json, pictures), as 'kiln site --evaluation' takes it; with
    /// --objects, objects.html, objects.json and pictures
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
    /// Writes place, normal, area, shown and reference E_ind of every measured pixel and light
    #[arg(long, value_name = "FILE.csv")]
    dump_pixels: Option<PathBuf>,
    /// Attaches figures and pictures of --out, and pictures for browsers without WebGPU, to the bake on the farm, whose page shows them; in place of those of an earlier evaluation
    #[arg(long, requires = "server", requires = "out")]
    attach: bool,
    /// Pictures for browsers without WebGPU, as of 'kiln site'; 0 draws none
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=i64::from(stills::STILLS_MAX)), requires = "attach")]
    stills: u32,
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
    if !arguments.objects.is_empty() {
        return run_objects(&arguments, kinds, camera);
    }
    arguments.wanted.check_figures(&kinds.worker)?;
    arguments.wanted.own_lights()?;
    if arguments.dump_pixels.is_some() && arguments.wanted.pixels() == 0 {
        return Err(Failure::bad_input(
            "no pixel is measured that --dump-pixels could write: give --pixels 1 or more",
        ));
    }
    for csv in [&arguments.dump, &arguments.dump_pixels].into_iter().flatten() {
        check_file(csv)?;
    }
    arguments.out.as_deref().map_or(Ok(()), check_folder)?;
    let source = arguments.source.open()?;
    let farm = arguments.source.on_farm()?;
    let scene = scene_of(&arguments, farm.as_ref())?;
    let measured =
        measure(kinds, &source, scene, (&arguments.wanted, &arguments.lighting), &Interrupt::default())?;
    if let Some(csv) = &arguments.dump {
        write_dump(csv, &measured)?;
    }
    if let Some(csv) = &arguments.dump_pixels {
        write_pixels(csv, &measured)?;
    }
    eprint!("{}", printable(&words(&measured.evaluation)));
    if let Some(out) = &arguments.out {
        write_page(out, &measured, &draw(kinds, &source, &measured, camera, arguments.size)?)?;
        if let Some((client, id)) = farm.filter(|_| arguments.attach) {
            let stills = stills::draw(&source, &kinds.client, arguments.stills)?;
            attach(&client, &id, out, &stills)?;
        }
    }
    if arguments.json {
        put_json(&measured.evaluation);
    }
    check(&arguments.wanted.fail_if, &measured.evaluation)
}

/// The same with objects amid the bake.
fn run_objects(arguments: &Arguments, kinds: &KindTables, camera: Option<SceneCamera>) -> Result<()> {
    arguments.wanted.check_object_figures()?;
    arguments.out.as_deref().map_or(Ok(()), check_folder)?;
    let source = arguments.source.open()?;
    let scene = scene_of(arguments, arguments.source.on_farm()?.as_ref())?;
    let wanted = Wanted {
        objects: &arguments.objects,
        arguments: &arguments.wanted,
        lighting: &arguments.lighting,
        draws: arguments.out.is_some().then_some((camera, arguments.size)),
    };
    let evaluation = evaluate(kinds, &source, scene, &wanted, &Interrupt::default())?;
    eprint!("{}", printable(&object_words(&evaluation)));
    if let Some(out) = &arguments.out {
        write_objects(out, &evaluation)?;
    }
    if arguments.json {
        put_json(&evaluation);
    }
    check_objects(&arguments.wanted.fail_if, &evaluation)
}

/// The scene: as given, as the farm has it, or where the bundle's report says.
fn scene_of(arguments: &Arguments, farm: Option<&(ApiClient, String)>) -> Result<PackedScene> {
    match (&arguments.scene, farm) {
        (Some(path), farm) => {
            let scene =
                PackedScene::read(&SceneArguments { path: path.clone(), root: arguments.root.clone() })?;
            if farm.is_some() { Ok(scene) } else { part_of_bundle(scene, arguments.source.folder()) }
        }
        (None, Some((client, id))) => PackedScene::of_bake(client, &client.bake(id)?),
        (None, None) => packed_scene_of_bundle(arguments.source.folder()),
    }
}

/// Attaches the evaluation of a folder and stills to a bake: all files are stored before the index names them.
fn attach(client: &ApiClient, id: &str, folder: &Path, stills: &[stills::Still]) -> Result<()> {
    let read = evaluation::read(folder)?;
    let mut files = evaluation::files(&read);
    files.extend(stills::files(stills).map(|(name, png)| (name.to_owned(), Cow::from(png))));
    let list = serde_json::json!(stills::list(stills)).to_string();
    files.push((STILLS.to_owned(), Cow::from(list.into_bytes())));
    let mut index = EvaluationIndex::default();
    for (name, bytes) in &files {
        let media_type = if name.ends_with(".png") { EvaluationMedia::Png } else { EvaluationMedia::Json };
        let (digest, bytes) = (Digest::of(bytes), bytes.len() as u64);
        index.files.push(EvaluationFile { name: name.clone(), media_type, digest, bytes });
    }
    index.check().map_err(|error| {
        Failure::bad_input("the evaluation cannot be attached")
            .caused_by(&error)
            .try_this("a smaller --size, or fewer lights")
    })?;
    files.iter().try_for_each(|(_, bytes)| client.put_evaluation_file(id, bytes))?;
    client.attach_evaluation(id, &index)?;
    say!("attached to bake {id}: {} files", files.len());
    Ok(())
}
