//! Nodes of a scene that are baked as objects of their own, and drawn where the scene has them.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use super::processes::{Finished, kiln, run};
use super::{bundle, cornell_with};

/// Node of the box that moves.
const BOX: &str = "short box";
/// Few rays: seconds.
const FEW: [&str; 14] = [
    "--preset",
    "draft",
    "--set",
    "receivers_target=3000",
    "--set",
    "transport_rays=64",
    "--mover-set",
    "receivers_target=600",
    "--mover-set",
    "transport_rays=64",
    "--mover-set",
    "transfer_nodes=8",
    "--mover-set",
    "transfer_rays=128",
];

fn within(folder: &Path) -> Command {
    let mut command = kiln(&folder.join("state"));
    command.current_dir(folder).env("KILN_STATE", folder.join("cache"));
    command
}

fn bake(folder: &Path, scene: &str, more: &[&str], exit: i32) -> Finished {
    run(within(folder), &[&["bake", scene, "--json"][..], &FEW, more].concat(), exit)
}

/// A Cornell box whose short box stands at a place, turned; its walls as `change` has them.
fn room(folder: &Path, name: &str, place: [f32; 3], change: impl FnOnce(&mut Value)) {
    cornell_with(&folder.join(name), |json| {
        let node = json["nodes"].as_array_mut().unwrap().iter_mut().find(|node| node["name"] == BOX).unwrap();
        node["translation"] = json!(place);
        node["rotation"] = json!([0.0, 0.382_683_43, 0.0, 0.923_879_5]);
        change(json);
    });
}

/// Pixels of a picture of a bundle from the front.
fn picture(folder: &Path, bundle: &str, objects: &[&str]) -> Vec<u8> {
    let mut look = vec!["preview", bundle, "--size", "64x64", "--backend", "cpu", "--out", "a.png"];
    look.extend(objects.iter().flat_map(|object| ["--object", object]));
    run(within(folder), &look, 0);
    image::open(folder.join("a.png")).unwrap().to_rgb8().into_raw()
}

/// Pixels that something changes much.
fn outline(with: &[u8], without: &[u8]) -> Vec<bool> {
    let is_other = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 60);
    with.chunks_exact(3).zip(without.chunks_exact(3)).map(is_other).collect()
}

#[test]
fn mover_is_baked_once_and_stands_in_pictures_where_the_scene_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    room(at, "room.glb", [0.15, 0.0, 0.1], |_| {});
    let baked = bake(
        at,
        "room.glb",
        &["--mover", BOX, "--preview", "whole.png", "--size", "64x64", "--backend", "cpu"],
        0,
    );
    let summary = baked.json();
    let mover = &summary["movers"][0];
    assert_eq!((&mover["node"], &mover["out"]), (&json!(BOX), &json!("room.short_box.kiln")), "{summary}");
    assert!(mover["tasks_run"].as_u64().unwrap() > 5, "{summary}");
    let words = mover["object"].as_str().unwrap();
    assert_eq!(words, "room.short_box.kiln pos=0.15,0,0.1 turn=45,0,0");
    assert!(baked.stderr().contains(&format!("--object '{words}'")), "{}", baked.stderr());

    // The picture of the bake has it, and so has one with those words; another place changes it.
    let shown = picture(at, "room.kiln", &[words]);
    assert_eq!(image::open(at.join("whole.png")).unwrap().to_rgb8().into_raw(), shown);
    run(within(at), &[&["bake", "room.glb", "--out", "static.kiln"][..], &FEW[..6]].concat(), 0);
    let whole = picture(at, "static.kiln", &[]);
    // Of these few receivers the static box is told more coarsely than the object: its outline is compared.
    let without = picture(at, "room.kiln", &[]);
    let overlap = |of: &[u8]| {
        let [is_there, is_due] = [of, &whole].map(|of| outline(of, &without));
        let both = is_there.iter().zip(&is_due);
        let count = |is: fn(bool, bool) -> bool| both.clone().filter(|(a, b)| is(**a, **b)).count() as f64;
        count(|a, b| a && b) / count(|a, b| a || b)
    };
    let aside = picture(at, "room.kiln", &[&words.replace("0.15,0,0.1", "-0.1,0,0.4")]);
    let [shown, aside] = [&shown, &aside].map(|of| overlap(of));
    assert!(shown > 0.85 && aside < 0.8, "{shown} of the box where it is, {aside} elsewhere");

    // An evaluation finds the scene without its mover.
    run(
        within(at),
        &["evaluate", "room.kiln", "--receivers", "50", "--pixels", "0", "--rel-error", "0.5"],
        0,
    );

    measured_amid_its_scene(at, words);

    // Elsewhere in the room, and in another room, it is the same object; the room without it is the same, too.
    room(at, "moved.glb", [-0.2, 0.1, 0.3], |_| {});
    let moved = bake(at, "moved.glb", &["--mover", BOX], 0).json();
    assert_eq!((&moved["tasks_run"], &moved["movers"][0]["tasks_run"]), (&json!(0), &json!(0)), "{moved}");
    room(at, "other.glb", [0.15, 0.0, 0.1], |json| {
        json["nodes"].as_array_mut().unwrap().remove(0);
        let nodes: Vec<usize> = (0..json["nodes"].as_array().unwrap().len()).collect();
        json["scenes"][0]["nodes"] = json!(nodes);
    });
    let other = bake(at, "other.glb", &["--mover", BOX], 0).json();
    assert_eq!(other["movers"][0]["tasks_run"], 0, "{other}");
    assert!(other["tasks_run"].as_u64().unwrap() > 5, "{other}");
    assert_eq!(bundle(&at.join("room.short_box.kiln")), bundle(&at.join("other.short_box.kiln")));
}

/// An evaluation of an object finds its scene and that of the bake around, and measures where it is said to stand, or on floor and wall.
fn measured_amid_its_scene(at: &Path, words: &str) {
    let lights = json!({"lights": [{"name": "lamp", "type": "point", "position_m": [0.0, 2.5, -2.0], "strength": [9, 9, 9]}]});
    std::fs::write(at.join("lights.json"), lights.to_string()).unwrap();
    let evaluate = |objects: &str, more: &[&str], exit: i32| {
        let few = ["--receivers", "120", "--rel-error", "0.2", "--lights", "lights.json", "--json"];
        let arguments = [&["evaluate", "room.kiln", "--objects", objects][..], &few, more].concat();
        run(within(at), &arguments, exit)
    };
    let pictures = ["--out", "page", "--size", "16x12", "--fail-if", "lamp.near_ratio>3"];
    let figures = evaluate(words, &pictures, 0).json();
    let row = &figures["objects"][0];
    let number = |name: &str, figure: &str| row["lights"][0][name][figure].as_f64().unwrap();
    assert_eq!((&row["place"], &row["stance"]), (&json!("said"), &json!("pos=0.15,0,0.1 turn=45,0,0")));
    assert!((0.7..1.3).contains(&number("near", "energy_ratio")), "{row}");
    assert!((0.5..2.0).contains(&number("own", "energy_ratio")), "{row}");
    assert!(number("near", "rel_rmse") < number("near_ignored", "rel_rmse"), "{row}");
    let page = std::fs::read_to_string(at.join("page/objects.html")).unwrap();
    assert!(page.contains("data:image/png;base64,") && !page.contains("http"));
    let strip = image::open(at.join("page/0-said-lamp.png")).unwrap();
    assert_eq!([strip.width(), strip.height()], [5 * 16, 12]);
    let file = words.split(' ').next().unwrap();
    let broken = evaluate(file, &["--fail-if", "near_energy_ratio>0.1"], 4);
    let places = broken.json()["objects"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["place"].clone())
        .collect::<Vec<_>>();
    assert_eq!(places, ["floor", "wall"]);
    for told in ["near_energy_ratio>0.1 of room.short_box.kiln at wall", "no doorway was found"] {
        assert!(broken.stderr().contains(told), "{}", broken.stderr());
    }
    for (objects, more, told) in [
        ("room.glb", &[][..], "is no bundle of an object"),
        ("room.kiln", &[], "bake it with --kind transfer"),
        (words, &["--fail-if", "rel_rmse>0.1"], "names no figure"),
        (words, &["--pixels", "3"], "--pixels"),
    ] {
        let refused = evaluate(objects, more, 2);
        assert!(refused.stderr().contains(told), "{}", refused.stderr());
    }
}

#[test]
fn movers_that_cannot_be_are_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    room(at, "room.glb", [0.0; 3], |_| {});
    std::fs::create_dir(at.join("room.tall_box.kiln")).unwrap();
    std::fs::write(at.join("room.tall_box.kiln/diary.txt"), "dear diary").unwrap();
    for (more, words) in [
        (&["--mover", "Short Box"][..], &["\"Short Box\"", "there are \"short box\""][..]),
        (&["--mover", BOX, "--mover", BOX], &["named twice"]),
        (&["--mover", "front"], &["has no mesh"]),
        (&["--mover", "animated"], &["no animation"]),
        (&["--mover", BOX, "--kind", "transfer"], &["bakes a file as one object", "try: it without --mover"]),
        (&["--mover", BOX, "--kind", "sh"], &["kind sh has none", "another --kind"]),
        (&["--mover", BOX, "--set", "voxels=off"], &["switched off", "--set voxels=on"]),
        (&["--mover", BOX, "--mover-set", "voxels=on"], &["voxels", "kiln settings --kind transfer"]),
        (&["--mover", BOX, "--mover-set", "texel_m"], &["--mover-set 'texel_m'", "SETTING=VALUE"]),
        (&["--mover", "tall box"], &["room.tall_box.kiln holds other files"]),
    ] {
        let refused = bake(at, "room.glb", more, 2).stderr();
        assert!(words.iter().all(|word| refused.contains(word)), "{more:?}: {refused}");
        assert!(!at.join("room.kiln").exists() && !at.join("cache").exists(), "{more:?}: {refused}");
    }
    let alone = run(within(at), &["bake", "room.glb", "--mover-set", "texel_m=0.1"], 2).stderr();
    assert!(alone.contains("--mover <NODE>"), "{alone}");
}
