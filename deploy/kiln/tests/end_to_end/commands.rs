//! The smaller commands, over one server with one finished bake.

use lightkiln_proto::kinds::Kinds;

use lightkiln_proto::ids::Digest;

use super::processes::{Server, kiln, run};
use super::{SMALL, cornell};

#[test]
fn bake_can_be_listed_shown_watched_fetched_inspected_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let _worker = server.worker(folder.path(), "worker", 2);
    let call = |arguments: &[&str]| {
        let with_server = [arguments, &["--server", &server.url]].concat();
        run(kiln(folder.path()), &with_server, 0)
    };
    let scene = cornell().display().to_string();
    let submitted = call(&[&["submit", &scene, "--wait"], &SMALL[..]].concat());
    let bake = submitted.stdout().trim().to_owned();
    assert!(call(&["list"]).stdout().contains(&bake));
    assert_eq!(call(&["list", "--json"]).json()["bakes"][0]["id"], bake.as_str());
    assert!(call(&["show", &bake]).stdout().contains("done"));
    assert_eq!(call(&["show", &bake, "--json"]).json()["state"], "done");
    call(&["watch", &bake]);
    let bundle = folder.path().join("bundle").display().to_string();
    call(&["fetch", &bake, "--out", &bundle]);
    let report = std::fs::read(folder.path().join("bundle/report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["run"]["bake"], bake.as_str());
    std::fs::write(folder.path().join("bundle/manifest.part-1"), "half").unwrap();
    let other = Digest::of(b"of an earlier bake").to_string();
    for left_over in [other.clone(), format!("{other}.part-1")] {
        std::fs::write(folder.path().join("bundle/chunks").join(left_over), "old").unwrap();
    }
    call(&["fetch", &bake, "--out", &bundle]);
    let names = super::bundle(&folder.path().join("bundle"));
    assert!(names.keys().all(|name| !name.contains("part-") && !name.contains(&other)), "{names:?}");
    let foreign = folder.path().display().to_string();
    run(kiln(folder.path()), &["fetch", &bake, "--out", &foreign, "--server", &server.url], 2);
    let png = folder.path().join("picture.png").display().to_string();
    call(&["preview", &bake, "--out", &png, "--size", "64x48", "--backend", "cpu"]);
    let whole = std::fs::read(&png).unwrap();
    assert!(whole.starts_with(b"\x89PNG"));
    // Fetched chunks are kept, unless that is not wanted.
    let kept = std::fs::read_dir(folder.path().join("chunks")).unwrap().count();
    assert!(kept > 3, "{kept} folders of chunks");
    let (none, nowhere) = (["--cache-gib", "0", "--cache"], folder.path().join("nowhere"));
    let uncached =
        [&["preview", &bake, "--out", &png, "--size", "64x48", "--backend", "cpu"], &none[..]].concat();
    call(&[&uncached[..], &[nowhere.to_str().unwrap()]].concat());
    assert!(!nowhere.exists() && std::fs::read(&png).unwrap() == whole);
    let streamed = |bytes: &str, code: i32| {
        let of_picture = ["--out", &png, "--size", "64x48", "--backend", "cpu", "--server", &server.url];
        run(kiln(folder.path()), &[&["preview", &bake, "--max-bytes", bytes], &of_picture[..]].concat(), code)
    };
    assert!(streamed("1G", 0).stderr().contains("(100.0 %)"));
    assert_eq!(std::fs::read(&png).unwrap(), whole);
    let refused = streamed("10", 2).stderr().to_owned();
    let least = refused.split_whitespace().filter_map(|word| word.parse::<u64>().ok()).max().unwrap();
    assert!(streamed(&least.to_string(), 0).stderr().contains("the overview, and 0 of"), "{refused}");
    assert_ne!(std::fs::read(&png).unwrap(), whole);
    streamed("2MB", 2);
    let bounded = |memory: &str, code: i32| {
        let of_picture = ["--out", &png, "--size", "64x48", "--backend", "cpu", "--json"];
        run(
            kiln(folder.path()),
            &[&["preview", &bundle, "--max-memory", memory], &of_picture[..]].concat(),
            code,
        )
    };
    assert!(bounded("10G", 0).stdout().contains("light_memory"));
    assert_eq!(std::fs::read(&png).unwrap(), whole);
    assert!(bounded("10", 2).stderr().contains("patches and overview alone"));
    let path = folder.path().join("path.json");
    let key = |picture: u32, x: f32, power: u32| {
        let lights = [format!("point pos={x},1,0.5 power={power}")];
        serde_json::json!({ "picture": picture, "lights": lights })
    };
    let keys = serde_json::json!({ "keys": [key(1, 0.3, 5), key(3, 0.7, 50)] });
    std::fs::write(&path, keys.to_string()).unwrap();
    let along = |code: i32| {
        let of_picture = ["--size", "64x48", "--backend", "cpu", "--json", "--path", path.to_str().unwrap()];
        run(kiln(folder.path()), &[&["preview", &bundle, "--out", &png], &of_picture[..]].concat(), code)
    };
    let drawn = along(0).json();
    let files: Vec<&str> =
        drawn["pictures"].as_array().unwrap().iter().map(|file| file.as_str().unwrap()).collect();
    assert!(files.len() == 3 && files[1].ends_with("picture-0002.png"), "{drawn}");
    let mean = |file: &&str| {
        let bytes = image::open(file).unwrap().into_luma8();
        bytes.iter().map(|value| f64::from(*value)).sum::<f64>() / bytes.len() as f64
    };
    // All have the first picture's exposure.
    let brightness: Vec<f64> = files.iter().map(mean).collect();
    assert!(brightness[0] + 2.0 < brightness[1] && brightness[1] + 2.0 < brightness[2], "{brightness:?}");
    let with = |more: &[&str], code: i32| {
        let of_picture = ["--size", "64x48", "--backend", "cpu", "--json", "--path", path.to_str().unwrap()];
        run(
            kiln(folder.path()),
            &[&["preview", &bundle, "--out", &png], &of_picture[..], more].concat(),
            code,
        )
    };
    assert!(with(&["--light", "sky"], 2).stderr().contains("--light"), "both say it");
    let least = with(&["--max-bytes", "1G"], 0).json();
    assert_eq!(least["light_bytes"], least["light_bytes_all"], "{least}");
    // Lights that are switched off stay off along a path.
    let lit =
        serde_json::json!({ "keys": [{ "picture": 1, "lights": ["sky strength=5", "emitters scale=2"] }] });
    std::fs::write(&path, lit.to_string()).unwrap();
    with(&[], 0);
    assert!(mean(&files[0]) > 5.0);
    with(&["--no-sky", "--no-emitters"], 0);
    assert_eq!(mean(&files[0]), 0.0);
    std::fs::write(&path, r#"{"keys": [{"picture": 1, "lights": ["lamp"]}]}"#).unwrap();
    let words = along(2).stderr().to_owned();
    assert!(words.contains("path.json") && words.contains("'lamp'"), "{words}");

    let figures = run(kiln(folder.path()), &["inspect", &bundle, "--json"], 0).json();
    assert!(figures["receivers"].as_u64().unwrap() > 0, "{figures}");
    assert!(run(kiln(folder.path()), &["inspect", &bundle], 0).stdout().contains("worst truncated"));
    let chunks = std::fs::read_dir(folder.path().join("bundle/chunks")).unwrap();
    let chunk = chunks.map(|chunk| chunk.unwrap().path().display().to_string()).min().unwrap();
    let figures = run(kiln(folder.path()), &["inspect", &chunk, "--json"], 0).json();
    assert!(figures["kind"].is_string(), "{figures}");
}

#[test]
fn cancelled_bake_is_cancelled_and_its_watch_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let scene = cornell().display().to_string();
    let submitted = run(kiln(folder.path()), &["submit", &scene, "--server", &server.url], 0);
    let bake = submitted.stdout().trim().to_owned();
    run(kiln(folder.path()), &["cancel", &bake, "--server", &server.url], 0);
    let watched = run(kiln(folder.path()), &["watch", &bake, "--server", &server.url], 130);
    assert!(watched.stderr().contains("was cancelled"), "{}", watched.stderr());
}

#[test]
fn help_names_the_exit_codes_and_settings_lists_every_setting() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["--help"][..], &["bake", "--help"]] {
        let help = run(kiln(folder.path()), arguments, 0).stdout();
        assert!(help.contains("130  interrupted"), "{help}");
    }
    for kind in Kinds::new().iter() {
        let table = run(kiln(folder.path()), &["settings", "--kind", kind.name()], 0).stdout();
        let rows = kind.settings();
        assert!(rows.len() >= 10);
        for row in rows {
            assert!(table.contains(row.name), "{} is not in:\n{table}", row.name);
        }
    }
}
