//! `kiln evaluate` and `kiln bake --evaluate`: figures, files, limits and refusals.

use std::fs;
use std::path::Path;

use super::processes::{kiln, run};
use super::{SMALL, cornell};

/// Quick and rough: few receivers, two lights of the caller's own.
const ROUGH: [&str; 6] = ["--receivers", "60", "--rel-error", "0.2", "--lights", "lights.json"];
const LIGHTS: &str = r#"{"lights": [
    {"name": "lamp", "type": "point", "position_m": [0.5, 4, -2], "strength": [10, 9, 8]},
    {"name": "own", "type": "emitters", "scale": 1}
]}"#;

fn words(parts: &[&[&str]]) -> Vec<String> {
    parts.iter().flat_map(|part| part.iter().map(|word| (*word).to_owned())).collect()
}

/// Bakes the small box into `box.kiln` of a folder, with more arguments; gives what was printed.
fn baked(folder: &Path, more: &[&str], exit: i32) -> super::processes::Finished {
    fs::write(folder.join("lights.json"), LIGHTS).unwrap();
    let scene = cornell().display().to_string();
    let mut command = kiln(&folder.join("state"));
    command.current_dir(folder);
    run(command, &words(&[&["bake", &scene, "--out", "box.kiln", "--json"], &SMALL, more]), exit)
}

fn evaluated(folder: &Path, more: &[&str], exit: i32) -> super::processes::Finished {
    let mut command = kiln(&folder.join("state"));
    command.current_dir(folder);
    run(command, &words(&[&["evaluate", "box.kiln"], more]), exit)
}

#[test]
fn evaluation_of_a_bundle_finds_its_scene_and_writes_figures_page_and_table() {
    let folder = tempfile::tempdir().unwrap();
    baked(folder.path(), &[], 0);
    let files = ["--out", "page", "--dump", "receivers.csv", "--dump-pixels", "pixels.csv", "--json"];
    let view = ["--camera", "eye=0,2.5,1 target=0,2.5,-3 fov=60", "--size", "72x50"];
    let done = evaluated(folder.path(), &[&ROUGH[..], &files[..], &view[..]].concat(), 0);
    let figures = done.json();
    assert_eq!(figures["scene"], "cornell");
    let names: Vec<&str> =
        figures["lights"].as_array().unwrap().iter().map(|light| light["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["lamp", "own"]);
    for key in ["rel_rmse", "energy_ratio", "p95", "p99"] {
        let value = figures[key].as_f64().unwrap();
        let [low, high] = [0, 1].map(|end| figures["interval_95"][key][end].as_f64().unwrap());
        assert!(value > 0.0 && low < high && low <= value && value <= high, "{key}: {figures}");
    }
    for class in ["transport", "factorisation", "quantisation", "interpolation", "shadow"] {
        assert!(figures["classes"][class].is_f64(), "{class}: {figures}");
    }
    assert!(figures["lights"][0]["reference_rel_error"].as_f64().unwrap() > 0.0);
    // The box is small and rough, but not wrong.
    assert!(
        figures["energy_ratio"].as_f64().unwrap() > 0.7 && figures["rel_rmse"].as_f64().unwrap() < 0.6,
        "{figures}"
    );
    let [lamp, own] = [0, 1].map(|light| &figures["lights"][light]);
    for row in [&figures["pixels"], &lamp["pixels"], &own["pixels"]] {
        let [low, high] = [0, 1].map(|end| row["interpolation"]["interval_95"][end].as_f64().unwrap());
        assert!(row["rel_rmse"].as_f64().unwrap() < 0.6 && low < high, "{row}");
        assert!(row["seams"]["inside"]["pairs"].as_u64().unwrap() > 0, "{row}");
        assert!(row["hunt"]["texels"].as_u64().unwrap() > 0, "{row}");
    }
    assert!(lamp["pixels"]["direct"]["leak"].is_f64() && own["pixels"]["direct"].is_null(), "{figures}");
    assert!(lamp["classes"]["shadow"].is_f64() && own["classes"]["shadow"].is_null(), "{figures}");
    let page = fs::read_to_string(folder.path().join("page/evaluation.html")).unwrap();
    assert!(page.contains("At pixels"));
    let without =
        evaluated(folder.path(), &[&ROUGH[..], &["--pixels", "0", "--json"][..]].concat(), 0).json();
    assert!(without["pixels"].is_null() && without["classes"]["shadow"].is_null(), "{without}");
    assert_eq!(without["rel_rmse"], figures["rel_rmse"]);
    assert!(page.contains("data:image/png;base64,") && !page.contains("<script") && !page.contains("http"));
    let table = fs::read_to_string(folder.path().join("receivers.csv")).unwrap();
    let receivers = figures["receivers"].as_u64().unwrap() as usize;
    assert_eq!(table.lines().count(), 1 + 2 * receivers);
    assert!(table.starts_with("light,receiver,x_m,"));
    pixels_have_the_energy_of(&fs::read_to_string(folder.path().join("pixels.csv")).unwrap(), lamp);
    let again = evaluated(folder.path(), &[&ROUGH[..], &["--json"][..]].concat(), 0);
    assert_eq!(again.json(), figures, "the same bundle, the same figures");
}

/// The file of pixels holds those of which the lamp's ratio of energy was made.
fn pixels_have_the_energy_of(table: &str, lamp: &serde_json::Value) {
    let mut lines = table.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert!(rows.len() > 1 && rows.iter().all(|row| row.len() == head.len()), "{table}");
    let sum = |column: &str| -> f64 {
        let at = |name: &str| head.iter().position(|found| *found == name).unwrap();
        let own = rows.iter().filter(|row| row[at("light")] == "lamp" && row[at("counted")] == "1");
        own.map(|row| row[at(column)].parse::<f64>().unwrap() * row[at("area_m2")].parse::<f64>().unwrap())
            .sum()
    };
    let energy_ratio = sum("shown_r") / sum("reference_r");
    let wanted = lamp["pixels"]["channel_energy_ratios"][0].as_f64().unwrap();
    assert!((energy_ratio / wanted - 1.0).abs() < 1e-6, "{energy_ratio} {wanted}");
}

#[test]
fn lights_are_told_apart_in_pictures_and_figures() {
    let folder = tempfile::tempdir().unwrap();
    baked(folder.path(), &[], 0);
    let brightest = |more: &[&str]| {
        let mut command = kiln(&folder.path().join("state"));
        command.current_dir(folder.path());
        let arguments = ["preview", "box.kiln", "--out", "a.png", "--size", "32x24", "--backend", "cpu"];
        run(command, &words(&[&arguments, more]), 0);
        let picture = image::open(folder.path().join("a.png")).unwrap().into_rgb8();
        picture.pixels().flat_map(|pixel| pixel.0).max().unwrap()
    };
    // The box has its lamp and no other light.
    assert!(brightest(&[]) > 100);
    assert_eq!(brightest(&["--no-emitters"]), 0);
    assert_eq!(brightest(&["--light", "emitters scale=0"]), 0);
    assert_eq!(brightest(&["--no-emitters", "--no-sky", "--light", "sky strength=1"]), 0);
    assert!(brightest(&["--no-emitters", "--light", "sky strength=1"]) > 100);
    let figures = evaluated(folder.path(), &[&ROUGH[..], &["--no-emitters", "--json"]].concat(), 0).json();
    let lights = figures["lights"].as_array().unwrap();
    assert_eq!(lights.iter().map(|light| light["name"].as_str().unwrap()).collect::<Vec<_>>(), ["lamp"]);
}

#[test]
fn bake_that_breaks_a_limit_ends_with_4_and_one_that_keeps_it_with_0() {
    let folder = tempfile::tempdir().unwrap();
    let with = |limit: &'static str| [&["--evaluate", "--fail-if", limit], &ROUGH[..]].concat();
    let broken = baked(folder.path(), &with("rel_rmse>0.0001"), 4);
    assert!(broken.stderr().contains("rel_rmse>0.0001 (it is "), "{}", broken.stderr());
    // Broken at one end of the interval alone: said, not failed.
    let figures = baked(folder.path(), &[&["--evaluate"], &ROUGH[..]].concat(), 0).json();
    let [low, high] =
        [0, 1].map(|end| figures["evaluation"]["interval_95"]["rel_rmse"][end].as_f64().unwrap());
    let limit = format!("rel_rmse>{}", 0.5 * (low + high));
    let unsure = baked(folder.path(), &[&["--evaluate", "--fail-if", &limit], &ROUGH[..]].concat(), 0);
    assert!(unsure.stderr().contains("may be broken"), "{}", unsure.stderr());
    let kept = baked(folder.path(), &with("rel_rmse>10"), 0);
    assert!(kept.json()["evaluation"]["rel_rmse"].as_f64().unwrap() > 0.0, "{}", kept.json());
    let report = fs::read_to_string(folder.path().join("box.kiln/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["run"]["evaluation"], kept.json()["evaluation"]);
}

#[test]
fn lights_that_cannot_be_measured_with_are_said_before_anything_is_baked() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("wrong.json"), r#"{"lights": [{"name": "a", "type": "candle"}]}"#).unwrap();
    let stderr = baked(folder.path(), &["--evaluate", "--lights", "wrong.json"], 2).stderr();
    assert!(stderr.contains("wrong.json") && stderr.contains("candle"), "{stderr}");
    assert!(!folder.path().join("box.kiln").exists());
}

#[test]
fn evaluation_refuses_what_it_cannot_measure_and_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    baked(folder.path(), &[], 0);
    let refused = |more: &[&str], said: &[&str]| {
        let stderr = evaluated(folder.path(), more, 2).stderr();
        said.iter().for_each(|word| assert!(stderr.contains(word), "{more:?}: no '{word}' in {stderr}"));
        assert!(!stderr.contains("panicked"), "{stderr}");
    };
    refused(&["--fail-if", "rmse>1"], &["rel_rmse"]);
    refused(&["--rel-error", "0"], &["0.0005"]);
    refused(&["--dump-pixels", "pixels.csv", "--pixels", "0"], &["--dump-pixels", "--pixels 1"]);
    refused(&["--lights", "absent.json"], &["absent.json"]);
    refused(&["--out", "page", "--camera", "eye=0"], &["eye=0", "target=x,y,z"]);
    refused(&["--out", "page", "--size", "0x9"], &["1..=16384"]);
    let other = cornell().with_file_name("two_rooms.glb").display().to_string();
    refused(&["--scene", &other], &["digest", "baked from"]);
    let lit_by = |light: &str| {
        fs::write(folder.path().join("lights.json"), format!("{{\"lights\": [{light}]}}")).unwrap()
    };
    // Inside the tall box.
    lit_by(r#"{"name": "buried", "type": "point", "position_m": [-0.94, 1, -3.5], "strength": [1, 1, 1]}"#);
    refused(&["--lights", "lights.json"], &["'buried'", "inside", "tall box"]);
    lit_by(
        r#"{"name": "cut", "type": "rect", "pos": [0, 2, -2], "dir": [0, -1, 0], "size": [18, 2], "radiance": 1}"#,
    );
    refused(&["--lights", "lights.json"], &["'cut'", "passes through a surface"]);
    lit_by(r#"{"name": "lost", "type": "sun", "direction": [0, 0, 1], "strength": [1, 1, 1]}"#);
    refused(&["--lights", "lights.json"], &["'lost'", "reaches no surface"]);
    fs::remove_file(folder.path().join("box.kiln/report.json")).unwrap();
    refused(&[], &["--scene"]);
}
