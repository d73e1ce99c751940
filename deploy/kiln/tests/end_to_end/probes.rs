//! Bakes whose light is in probes alone: pictures, figures, exports and refusals.

use std::fs;
use std::path::Path;
use std::process::Command;

use super::cornell;
use super::processes::{kiln, run};

/// Few probes and few rays.
const FEW: [&str; 8] =
    ["--kind", "captured", "--preset", "draft", "--set", "field_spacing_m=1", "--set", "probe_rays=128"];

/// A triangle that nothing lights.
const DARK: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 0, 1]}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAAAAAAIA/"}]}"#;

fn within(folder: &Path) -> Command {
    let mut command = kiln(&folder.join("state"));
    command.current_dir(folder);
    command
}

fn baked(folder: &Path, structure: &str) -> serde_json::Value {
    let scene = cornell().display().to_string();
    let of_structure = format!("field_structure={structure}");
    let rest = ["--set", &of_structure, "--out", "box.kiln", "--json"];
    run(within(folder), &[&["bake", &scene][..], &FEW, &rest].concat(), 0).json()
}

#[test]
fn captured_light_is_drawn_measured_and_exported_without_a_lightmap() {
    for structure in ["0", "1"] {
        let folder = tempfile::tempdir().unwrap();
        let summary = baked(folder.path(), structure);
        assert!(summary["field"]["probes"].as_u64().unwrap() > 50, "{summary}");
        // The box's lamp lights its walls by the probes.
        let picture = ["preview", "box.kiln", "--out", "a.png", "--size", "64x48", "--backend", "cpu"];
        run(within(folder.path()), &picture, 0);
        let picture = image::open(folder.path().join("a.png")).unwrap().into_rgb8();
        let lit = picture.pixels().filter(|pixel| pixel.0.iter().all(|channel| *channel > 30)).count();
        assert!(lit > 64 * 48 / 4, "{lit} pixels");
        let rough = ["evaluate", "box.kiln", "--receivers", "60", "--rel-error", "0.2", "--json"];
        for place in ["surfaces", "space"] {
            let figures = run(within(folder.path()), &[&rough[..], &["--in", place]].concat(), 0).json();
            let energy = figures["energy_ratio"].as_f64().unwrap();
            assert!((0.5..1.5).contains(&energy), "{place}: {figures}");
            assert_eq!(figures["lights"][0]["name"], "captured", "{figures}");
        }
        let export = ["export", "box.kiln", "--out", "lit", "--backend", "cpu", "--json"];
        let told = run(within(folder.path()), &export, 0).json();
        let names: Vec<&str> = told["files"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(|file| Path::new(file["path"].as_str()?).file_name()?.to_str())
            .collect();
        assert!(
            names.contains(&"scene.glb") && !names.iter().any(|name| name.contains("lightmap")),
            "{names:?}"
        );
        assert!(names.len() > 1, "{names:?}");
    }
}

#[test]
fn captured_light_is_refused_under_other_lights_and_where_there_is_none() {
    let folder = tempfile::tempdir().unwrap();
    baked(folder.path(), "0");
    let lamp =
        r#"{"lights": [{"name": "lamp", "type": "point", "position_m": [0, 1, 0], "strength": [1, 1, 1]}]}"#;
    fs::write(folder.path().join("lights.json"), lamp).unwrap();
    for other in [&["--lights", "lights.json"][..], &["--no-emitters"]] {
        let done = run(within(folder.path()), &[&["evaluate", "box.kiln"], other].concat(), 2);
        assert!(done.stderr().contains("captured"), "{}", done.stderr());
    }
    // Bakes that would be measured in vain are refused before they begin.
    let scene = cornell().display().to_string();
    let vain =
        [&["bake", &scene, "--out", "vain.kiln", "--evaluate", "--lights", "lights.json"][..], &FEW].concat();
    let done = run(within(folder.path()), &vain, 2);
    assert!(
        done.stderr().contains("under no other") && !folder.path().join("vain.kiln").exists(),
        "{}",
        done.stderr()
    );
    let pixels = run(within(folder.path()), &["evaluate", "box.kiln", "--pixels", "20"], 2);
    assert!(pixels.stderr().contains("--pixels"), "{}", pixels.stderr());
    let lit = [
        "preview",
        "box.kiln",
        "--out",
        "a.png",
        "--size",
        "16x12",
        "--backend",
        "cpu",
        "--light",
        "point pos=0,1,0 power=5",
    ];
    let told = run(within(folder.path()), &lit, 0).stderr();
    assert!(told.contains("keeps the bounced light"), "{told}");
    // A scene that nothing lights.
    fs::write(folder.path().join("dark.gltf"), DARK).unwrap();
    let done =
        run(within(folder.path()), &[&["bake", "dark.gltf", "--out", "dark.kiln"][..], &FEW].concat(), 2);
    assert!(done.stderr().contains("add lights"), "{}", done.stderr());
}
