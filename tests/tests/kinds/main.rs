//! A kind of bake outside Lightkiln goes the whole way: bake, inspect, preview, evaluate, and a farm over HTTP.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::preview::{Backend, View, render};
use lightkiln_proto::manifest::Manifest;
use lightkiln_tests::ambient::{self, NAME};
use serde_json::Value;

/// The program with the kind.
const PROGRAM: &str = env!("CARGO_BIN_EXE_kiln-ambient");

fn scene() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.glb")
}

/// A call whose state and home are in `folder`.
fn program(folder: &Path) -> Command {
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder).env("KILN_STATE", folder.join("state")).env_remove("KILN_TOKEN");
    command
}

/// Runs a call that must end with `code`.
fn run(folder: &Path, arguments: &[&str], code: i32) -> Output {
    let output = program(folder).args(arguments).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {errors}");
    output
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Bakes Cornell under 2 W/m² and gives the bundle's folder.
fn bake(folder: &Path) -> PathBuf {
    let scene = scene();
    let arguments =
        ["bake", scene.to_str().unwrap(), "--kind", NAME, "--set", "irradiance=2", "--out", "out", "--json"];
    let summary = json(&run(folder, &arguments, 0));
    assert_eq!((&summary["kind"], &summary["irradiance"]), (&NAME.into(), &2.0.into()));
    let stages: Vec<&String> = summary["stages"].as_object().unwrap().keys().collect();
    assert_eq!(stages, ["draw", "frame", "import", "light"], "a kind without a lightmap needs no unwrap");
    folder.join("out")
}

#[test]
fn kind_is_baked_inspected_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let out = bake(folder.path());
    let manifest = Manifest::from_json(&std::fs::read(out.join("manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest.body::<ambient::Body>().unwrap().irradiance, 2.0);
    assert!(manifest.lightmap.is_none());
    let figures = json(&run(folder.path(), &["inspect", "out", "--json"], 0));
    assert_eq!((&figures["kind"], &figures["irradiance"]), (&NAME.into(), &2.0.into()));
    let chunk = format!("out/chunks/{}", manifest.chunks(ambient::ROLE)[0].digest);
    let chunk =
        [chunk.clone(), format!("{chunk}.lkc")].into_iter().find(|path| folder.path().join(path).exists());
    let chunk = json(&run(folder.path(), &["inspect", &chunk.unwrap(), "--json"], 0));
    assert_eq!((&chunk["kind"], &chunk["content"]["irradiance"][0]), (&NAME.into(), &2.0.into()));
    let size = ["preview", "out", "--out", "a.png", "--size", "64x48", "--backend", "cpu"];
    run(folder.path(), &size, 0);
    let picture = image::open(folder.path().join("a.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (64, 48));
    assert!(picture.pixels().any(|pixel| pixel.0.iter().all(|channel| *channel > 40)), "walls are lit");
    // Its pictures for finding faults are none, and that is said.
    let debug = run(folder.path(), &["preview", "out", "--out", "b.png", "--debug", "atlas"], 2);
    assert!(String::from_utf8_lossy(&debug.stderr).contains(NAME));
    // It has no lightmap to export.
    let export = run(folder.path(), &["export", "out", "--out", "lit", "--backend", "cpu"], 2);
    let said = String::from_utf8_lossy(&export.stderr);
    assert!(
        said.contains(NAME) && said.contains("lightmap") && !folder.path().join("lit").exists(),
        "{said}"
    );
    // Browsers have no module for it.
    let site = run(folder.path(), &["site", "out", "--out", "site"], 2);
    let said = String::from_utf8_lossy(&site.stderr);
    assert!(said.contains(NAME) && !folder.path().join("site").exists(), "{said}");
}

#[test]
fn kind_is_drawn_by_the_library_as_bright_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let source = Source::bundle(bake(folder.path())).unwrap();
    let loaded = LoadedBake::load(&source, &ambient::tables().client).unwrap();
    assert!(loaded.light.lightmap(&loaded.scene).is_none());
    let (view, notes) = View::of_bake(&loaded, None, None).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    let size = View { width: 64, height: 48, samples: 1, ..view };
    let dark = View { lights: Vec::new(), emitter_scale: vec![0.0], ..size };
    let picture = render(&loaded, &dark, Backend::Cpu).unwrap();
    assert_eq!((picture.bounces, picture.converged), (0, true));
    // White walls: L = ρ/π · E.
    let wanted = [0.725, 0.71, 0.68].map(|albedo| 2.0 * albedo / std::f32::consts::PI);
    let close =
        |found: &&[f32; 3]| found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-5);
    let white = picture.linear.iter().filter(close).count();
    assert!(white > picture.linear.len() / 10, "{white} of {}", picture.linear.len());
}

#[test]
fn kind_is_held_against_the_path_tracer() {
    let folder = tempfile::tempdir().unwrap();
    bake(folder.path());
    let lights =
        r#"{"lights": [{"name": "lamp", "type": "point", "position_m": [0, 1, 0], "strength": [1, 1, 1]}]}"#;
    std::fs::write(folder.path().join("lights.json"), lights).unwrap();
    let rough = ["--receivers", "200", "--rel-error", "0.5", "--lights", "lights.json", "--json"];
    let arguments = [&["evaluate", "out"], &rough[..]].concat();
    let figures = json(&run(folder.path(), &arguments, 0));
    // Light that follows no lamp is wrong, and measured to be.
    assert!(figures["rel_rmse"].as_f64().unwrap() > 0.5, "{figures}");
    assert_eq!(figures["classes"], serde_json::json!({}));
    let failed = [&arguments[..], &["--fail-if", "rel_rmse>0.1"]].concat();
    run(folder.path(), &failed, 4);
}

#[test]
fn settings_of_the_kind_are_listed_and_checked() {
    let folder = tempfile::tempdir().unwrap();
    let table = run(folder.path(), &["settings", "--kind", NAME], 0);
    assert!(String::from_utf8_lossy(&table.stdout).contains("irradiance"));
    let scene = scene();
    let wrong = ["bake", scene.to_str().unwrap(), "--kind", NAME, "--set", "irradiance=-1"];
    let refused = run(folder.path(), &wrong, 2);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("irradiance"));
}

/// A process that is killed with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn kind_is_baked_by_a_farm_over_http() {
    let folder = tempfile::tempdir().unwrap();
    let mut server = program(folder.path());
    server.args(["server", "--listen", "127.0.0.1:0", "--state", "farm"]).stdout(Stdio::piped());
    let mut server = Running(server.spawn().unwrap());
    let mut line = String::new();
    BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let url = line.trim().strip_prefix("listening on ").unwrap().to_owned();
    let mut worker = program(folder.path());
    let _worker = Running(worker.args(["worker", "--server", &url, "--threads", "1"]).spawn().unwrap());
    let scene = scene();
    let arguments =
        ["bake", scene.to_str().unwrap(), "--kind", NAME, "--server", &url, "--out", "out", "--json"];
    let summary = json(&run(folder.path(), &arguments, 0));
    assert_eq!(summary["irradiance"], 1.0);
    // The same scene as another kind shares the tasks that are the same.
    let other =
        ["bake", scene.to_str().unwrap(), "--server", &url, "--out", "prt", "--preset", "draft", "--json"];
    let small = ["--set", "receivers_target=200", "--set", "transport_rays=16"];
    let summary = json(&run(folder.path(), &[&other[..], &small].concat(), 0));
    assert!(summary["tasks_reused"].as_u64().unwrap() >= 2, "import and frame are shared: {summary}");
}
