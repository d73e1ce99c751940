//! Wrong arguments and broken files: exit code, and a message that helps.

use std::fs;

use super::cornell;
use super::processes::{kiln, run};

/// Runs `kiln` with words split at spaces, `{scene}` and `{dir}` filled in; asserts exit code and words of the message.
fn assert_refused(words: &str, exit: i32, said: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let fill = |word: &str| {
        let word = word.replace("{scene}", &cornell().display().to_string());
        word.replace("{dir}", &folder.path().display().to_string())
    };
    fs::write(folder.path().join("broken.glb"), b"glTF\x02\0\0\0 and then nothing").unwrap();
    fs::write(folder.path().join("text.glb"), b"hello").unwrap();
    fs::write(folder.path().join("missing.gltf"), MISSING_BUFFER).unwrap();
    fs::write(folder.path().join("empty.gltf"), br#"{"asset":{"version":"2.0"}}"#).unwrap();
    fs::write(folder.path().join("forged.gltf"), FORGED_LINE).unwrap();
    fs::write(folder.path().join("settings.json"), b"[1]").unwrap();
    fs::write(folder.path().join("old.gltf"), br#"{"asset":{"version":"1.0"},"meshes":{"m":{}}}"#).unwrap();
    fs::write(folder.path().join("bright.gltf"), triangle(0.0, 1e30)).unwrap();
    fs::write(folder.path().join("far.gltf"), triangle(1e6, 1.0)).unwrap();
    let arguments: Vec<String> = words.split(' ').map(fill).collect();
    let mut command = kiln(&folder.path().join("state"));
    command.current_dir(folder.path());
    let message = run(command, &arguments, exit).stderr();
    assert!(message.contains("error: "), "{message}");
    for word in said {
        assert!(message.contains(word), "{words}: no '{word}' in:\n{message}");
    }
    assert!(!message.contains("panicked"), "{message}");
}

/// A triangle of a metre at `x`, of a material that emits.
fn triangle(x: f32, emission: f32) -> String {
    let corners = [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 0.0, -1.0]];
    let bytes: Vec<u8> =
        corners.as_flattened().iter().flat_map(|number: &f32| number.to_le_bytes()).collect();
    let hex: String = bytes.iter().map(|byte| format!("%{byte:02X}")).collect();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0,"name":"wall"}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
        "materials":[{{"name":"lamp","emissiveFactor":[1,1,1],"extensions":{{
            "KHR_materials_emissive_strength":{{"emissiveStrength":{emission:e}}}}}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],
        "buffers":[{{"byteLength":36,"uri":"data:application/octet-stream,{hex}"}}]}}"#
    )
}

const MISSING_BUFFER: &[u8] = br#"{"asset":{"version":"2.0"},"buffers":[{"uri":"gone.bin","byteLength":4}]}"#;

/// A name that would look like a line of output.
const FORGED_LINE: &[u8] = br#"{"asset":{"version":"2.0"},"extensionsUsed":["a\r\nbundle: b"],"extensionsRequired":["a\r\nbundle: b"]}"#;

#[test]
fn wrong_arguments_exit_with_2_and_name_what_is_wrong() {
    assert_refused("bake", 2, &["SCENE"]);
    assert_refused("bake {scene} --preset best", 2, &["best", "draft"]);
    assert_refused("bake {scene} --set sky_parts", 2, &["SETTING=VALUE", "try: "]);
    assert_refused("bake {scene} --set sky_parts=99", 2, &["sky_parts = 99", "kiln settings"]);
    assert_refused("bake {scene} --set colour=red", 2, &["colour", "kiln settings"]);
    assert_refused("bake {scene} --settings settings.json", 2, &["settings.json", "JSON object"]);
    assert_refused("bake {scene} --camera eye=1,2", 2, &["eye"]);
    assert_refused("bake {scene} --light lamp", 2, &["lamp", "point"]);
    assert_refused("bake {scene} --size 10", 2, &["1280x720"]);
    assert_refused("bake {scene} --out {dir}", 2, &["other files", "--out"]);
    assert_refused("preview {dir} --out a.png", 2, &["manifest.json"]);
    assert_refused("inspect text.glb", 2, &["text.glb"]);
    assert_refused("inspect absent", 2, &["absent", "try: "]);
}

#[test]
fn places_that_cannot_be_written_and_slips_of_the_pen_are_told_before_the_bake() {
    assert_refused("bake {scene} --preview a.jpg", 2, &["a.jpg", "try: a.png"]);
    assert_refused("bake {scene} --preview none/a.png", 2, &["there is no folder none"]);
    assert_refused("bake {scene} --out settings.json/x", 2, &["is no folder"]);
    assert_refused("bake {scene} --exposure inf", 2, &["stops"]);
    assert_refused("bake {scene} --set transportrays=12", 2, &["do you mean 'transport_rays'?"]);
    assert_refused("preview {dir} --out a.jpg", 2, &["try: a.png"]);
}

#[test]
fn input_that_a_later_task_finds_wrong_exits_with_2_and_is_told_once_and_plainly() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (cornell().display().to_string(), folder.path().join("out").display().to_string());
    let wanted = ["bake", &scene, "--set", "texel_m=0.0001", "--out", &out];
    let message = run(kiln(&folder.path().join("state")), &wanted, 2).stderr();
    assert_eq!(message.matches("raise the texel size").count(), 1, "{message}");
    assert!(!message.contains('\u{1b}') && !message.contains("verdict"), "{message}");
}

#[test]
fn scenes_that_cannot_be_read_exit_with_2_and_name_the_file() {
    assert_refused("bake absent.glb", 2, &["absent.glb"]);
    assert_refused("bake text.glb", 2, &["text.glb", "try: "]);
    assert_refused("bake broken.glb", 2, &["broken.glb"]);
    assert_refused("bake missing.gltf", 2, &["gone.bin"]);
    assert_refused("bake {dir}", 2, &["it is a folder", "try: a .glb"]);
    assert_refused("bake forged.gltf", 2, &["extension a  bundle: b, which"]);
    let no_folder = "bake {scene} --state text.glb/state --out {dir}/out";
    assert_refused(no_folder, 2, &["the state folder cannot be opened", "try: --state"]);
    assert_refused("bake empty.gltf --out {dir}/out", 2, &["failed", "no meshes"]);
    assert_refused("bake old.gltf", 2, &["old.gltf", "glTF version \"1.0\"", "gltf-pipeline"]);
    assert_refused("bake bright.gltf --out {dir}/out", 2, &["\"lamp\"", "1e30", "at most 1e12"]);
    assert_refused(
        "bake far.gltf --out {dir}/out --set texel_m=0.5",
        2,
        &["'wall/", "reaches 1000000", "origin"],
    );
}

#[test]
fn check_refuses_what_a_bake_would_with_its_words_and_code() {
    assert_refused("check absent.glb", 2, &["absent.glb"]);
    assert_refused("check bright.gltf", 2, &["cannot be imported", "1e30"]);
    assert_refused("check {scene} --set texel_m=0.0001", 2, &["raise"]);
    assert_refused("check {scene} --preset best", 2, &["best", "draft"]);
}

#[test]
fn check_tells_what_a_bake_then_takes() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (cornell().display().to_string(), folder.path().join("out").display().to_string());
    let told = |arguments: &[&str]| -> serde_json::Value {
        let answer = run(kiln(&folder.path().join("state")), arguments, 0).stdout();
        serde_json::from_str(answer.lines().last().unwrap()).unwrap()
    };
    let baked = |texel: &str| {
        let settings = ["--set", texel, "--preset", "draft", "--json"];
        let check = told(&[["check", &scene].as_slice(), &settings].concat());
        (check, told(&[["bake", &scene, "--out", &out].as_slice(), &settings].concat()))
    };
    let close = |told: &serde_json::Value, found: &serde_json::Value, factor: f64| {
        let (told, found) = (told.as_f64().unwrap(), found.as_f64().unwrap());
        assert!(told <= factor * found && found <= factor * told, "{told} was told, {found} found");
    };
    // Both boxes are much smaller than a texel, and have receivers all the same.
    let (check, bake) = baked("texel_m=2");
    close(&check["lightmap"]["receivers"], &bake["receivers"], 1.5);
    let (check, bake) = baked("texel_m=0.5");
    close(&check["lightmap"]["receivers"], &bake["receivers"], 1.3);
    close(&check["costs"]["tasks"], &bake["tasks_run"], 2.0);
    close(&check["costs"]["bundle_bytes"], &bake["bytes_total"], 10.0);
    assert_eq!(check["warnings"].as_array().map(Vec::len), Some(0));
    let words = run(kiln(&folder.path().join("state")), &["check", &scene], 0).stdout();
    assert!(words.contains("receivers") && words.contains("processor time"), "{words}");
}

#[test]
fn check_warns_in_the_lines_of_a_bake() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("named.gltf");
    let named = triangle(0.0, 1.0).replacen('{', r#"{"extensionsUsed":["a\nbundle: b"],"#, 1);
    fs::write(&scene, named).unwrap();
    let words = run(kiln(&folder.path().join("state")), &["check", scene.to_str().unwrap()], 0).stdout();
    let line = "warning: a bundle: b: not understood, the scene is read without (extension-ignored)";
    assert!(words.lines().any(|told| told == line), "{words}");
}

#[test]
fn server_that_does_not_answer_exits_with_3() {
    // Port 9 is the discard service's, which no test machine runs.
    assert_refused(
        "bake {scene} --patience 0 --server http://127.0.0.1:9",
        3,
        &["http://127.0.0.1:9", "try: "],
    );
    assert_refused("list --server http://127.0.0.1:9", 3, &["http://127.0.0.1:9", "kiln server"]);
    assert_refused("list --server farm", 2, &["http://host:port"]);
}

#[test]
fn state_folder_in_use_is_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let _server = super::processes::Server::start(folder.path());
    let state = folder.path().join("server").display().to_string();
    let scene = cornell().display().to_string();
    let out = folder.path().join("out").display().to_string();
    let refused = run(kiln(folder.path()), &["bake", &scene, "--state", &state, "--out", &out], 2);
    assert!(
        refused.stderr().contains("in use") && refused.stderr().contains("--server"),
        "{}",
        refused.stderr()
    );
}
