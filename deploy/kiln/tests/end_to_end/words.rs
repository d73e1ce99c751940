//! What reaches the screen: logs as they were asked for, errors once, names that give a terminal no orders.

use std::path::{Path, PathBuf};

use super::farm::arguments;
use super::processes::{Running, Server, kiln, run};
use super::{SMALL, cornell_and_json, cornell_with};

/// Sets a window's title, and turns the direction of text.
const ORDERS: &str = "\u{1b}]0;owned\u{7}\u{202e}";

/// A scene that can be read but not imported.
fn broken_scene(folder: &Path) -> PathBuf {
    let path = folder.join("broken.gltf");
    std::fs::write(&path, r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[7]}],"scene":0}"#).unwrap();
    path
}

/// The box with orders to a terminal in the names of its file and of its materials, which reflect so much that the import
/// warns of them by name.
fn scene_with_orders(folder: &Path) -> PathBuf {
    cornell_with(&folder.join(format!("box{ORDERS}.glb")), |json| {
        for material in json["materials"].as_array_mut().unwrap() {
            material["name"] = format!("wall{ORDERS}").into();
            material["pbrMetallicRoughness"]["baseColorFactor"] = serde_json::json!([1.0, 1.0, 1.0, 1.0]);
        }
    })
}

fn assert_no_orders(place: &str, text: &str) {
    let order = text.chars().find(|character| matches!(character, '\u{1b}' | '\u{7}' | '\u{202e}'));
    assert_eq!(order, None, "{place}: {text:?}");
}

#[test]
fn log_is_filtered_by_rust_log_unless_kiln_log_says_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    let scene = broken_scene(folder.path()).display().to_string();
    let told = |variables: &[(&str, &str)]| {
        let mut command = kiln(folder.path());
        command.env_remove("RUST_LOG").envs(variables.iter().copied());
        run(command, &["bake", &scene, "--out", "none"], 2).stderr()
    };
    let quiet = told(&[]);
    assert_eq!(quiet.matches("node 7").count(), 1, "an error is told once:\n{quiet}");
    assert!(!quiet.contains("WARN") && !quiet.contains("INFO"), "{quiet}");
    let wordy = told(&[("RUST_LOG", "info")]);
    assert!(wordy.contains("INFO") && wordy.contains("WARN"), "{wordy}");
    for internal in ["blame=", "verdict=", "GivenUp", "\u{1b}"] {
        assert!(!wordy.contains(internal), "{internal} in:\n{wordy}");
    }
    assert!(wordy.contains("the bake has failed"), "{wordy}");
    assert!(!told(&[("RUST_LOG", "info"), ("KILN_LOG", "off")]).contains("INFO"));
    assert!(told(&[("RUST_LOG", "off"), ("KILN_LOG", "info")]).contains("INFO"));
}

#[test]
fn bake_whose_picture_fails_has_told_its_object_and_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = kiln(&folder.path().join("state"));
    // No driver that a loader of Vulkan could find.
    command
        .current_dir(folder.path())
        .env("VK_DRIVER_FILES", "/dev/null")
        .env("VK_ICD_FILENAMES", "/dev/null");
    let more = ["--out", "box.kiln", "--json", "--preview", "a.png", "--backend", "gpu"];
    let failed = run(command, &arguments("bake", &more), 1);
    let object = failed.json();
    assert_eq!((&object["out"], object["receivers"].is_u64()), (&"box.kiln".into(), true), "{object}");
    let told = failed.stderr();
    assert!(told.contains("bundle: box.kiln") && told.contains("error: "), "{told}");
    assert!(folder.path().join("box.kiln/manifest.json").is_file() && !folder.path().join("a.png").exists());
}

/// From the submission to the bundle, of every command that prints a name.
#[test]
fn names_that_come_through_a_farm_give_a_terminal_no_orders() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene_with_orders(folder.path()).display().to_string();
    let mut command = kiln(&folder.path().join("server"));
    command.env("RUST_LOG", "debug");
    let server = Server::start_with(command, &[]);
    let mut command = kiln(&folder.path().join("worker"));
    command.env("RUST_LOG", "info").args(["worker", "--server", &server.url, "--threads", "2"]);
    let worker = Running::start({
        command.args(["--name", &format!("oven{ORDERS}")]);
        command
    });
    let call = |arguments: &[&str]| {
        let finished = run(kiln(folder.path()), &[arguments, &["--server", &server.url]].concat(), 0);
        let text = finished.stdout() + &finished.stderr();
        assert_no_orders(&arguments[..1].join(" "), &text);
        text
    };
    let submitted = call(&[&["submit", &scene, "--wait"], &SMALL[..]].concat());
    let bake = submitted.lines().find(|line| line.len() == 16).unwrap().to_owned();
    let out = folder.path().join("out").display().to_string();
    for (arguments, named) in [
        (&["list"][..], "box\\u{1b}"),
        (&["top", "--once"], "oven\\u{1b}"),
        (&["show", &bake], "box\\u{1b}"),
        (&["logs", &bake], "oven\\u{1b}"),
        (&["watch", &bake], "done"),
        (&["blocklist", &bake], ""),
        (&["fetch", &bake, "--out", &out], "'wall\\u{1b}"),
        (&["show", &bake[..5]], "box\\u{1b}"),
    ] {
        let told = call(arguments);
        assert!(told.contains(named), "{arguments:?}: no {named} in {told:?}");
    }
    worker.signal("TERM");
    assert_no_orders("worker", &worker.finish().stderr.join("\n"));
}

#[test]
fn help_names_no_source() {
    let folder = tempfile::tempdir().unwrap();
    let help = |command: &[&str]| run(kiln(folder.path()), &[command, &["--help"]].concat(), 0).stdout();
    let all = help(&[]);
    let commands = all.lines().skip_while(|line| *line != "Commands:").skip(1);
    let names = commands.map_while(|line| line.split_whitespace().next());
    let mut seen = 0;
    for name in names.filter(|name| *name != "help") {
        let text = help(&[name]);
        for source in [".rs", "src/", "lightkiln_", "METHOD", "crate"] {
            assert!(!text.contains(source), "{source} in kiln {name} --help:\n{text}");
        }
        seen += 1;
    }
    assert!(seen > 20, "{seen} commands in:\n{all}");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_is_opened_without_complaints_of_drivers() {
    let folder = tempfile::tempdir().unwrap();
    run(
        kiln(&folder.path().join("state")),
        &arguments("bake", &["--out", &folder.path().join("b").display().to_string()]),
        0,
    );
    let draw = |log: &str| {
        let mut command = kiln(&folder.path().join("state"));
        command.current_dir(folder.path()).env_remove("XDG_RUNTIME_DIR").env_remove("VK_LOADER_DEBUG");
        command.env("RUST_LOG", log);
        run(command, &["preview", "b", "--out", "a.png", "--size", "64x48", "--backend", "gpu"], 0).stderr()
    };
    let told = draw("");
    assert!(!told.contains("XDG_RUNTIME_DIR") && !told.contains("error"), "{told}");
    assert!(told.contains("drawn by"), "{told}");
}

#[test]
fn files_above_a_scene_are_taken_with_root_and_words_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, json_bytes, mut json) = cornell_and_json();
    json["buffers"][0]["uri"] = "../parts/box.bin".into();
    for name in ["levels", "parts"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
    }
    std::fs::write(folder.path().join("parts/box.bin"), &glb[20 + json_bytes + 8..]).unwrap();
    std::fs::write(folder.path().join("levels/box.gltf"), serde_json::to_vec(&json).unwrap()).unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let check = |root: Option<&str>, code: i32| {
        let mut words = vec!["check".to_owned(), at("levels/box.gltf")];
        words.extend(root.into_iter().flat_map(|root| ["--root".to_owned(), at(root)]));
        run(kiln(folder.path()), &words, code)
    };
    let refused = check(None, 2).stderr();
    assert!(refused.contains("leaves the scene's folder") && refused.contains("--root DIR"), "{refused}");
    let elsewhere = check(Some("parts"), 2).stderr();
    assert!(elsewhere.contains("does not hold the scene") && elsewhere.contains("--root"), "{elsewhere}");
    assert!(check(Some(""), 0).stdout().contains("triangles"));
}
