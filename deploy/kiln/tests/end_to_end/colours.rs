//! Colours of materials in pictures: as those of a bake that has them.

use std::path::Path;
use std::process::Command;

use super::processes::{kiln, run};
use super::{SMALL, cornell, cornell_with};

/// `kiln` in a folder, which has its state too.
fn within(folder: &Path) -> Command {
    let mut command = kiln(folder);
    command.current_dir(folder);
    command
}

fn bake(folder: &Path, scene: &Path, out: &str) {
    let scene = scene.display().to_string();
    run(within(folder), &[&["bake", &scene, "--out", out][..], &SMALL].concat(), 0);
}

fn drawn(folder: &Path, bundle: &str, colours: &[&str]) -> Vec<u8> {
    let size = ["--size", "96x72", "--backend", "cpu", "--tone", "exposure"];
    let colours: Vec<&str> = colours.iter().flat_map(|colour| ["--material", colour]).collect();
    run(within(folder), &[&["preview", bundle, "--out", "a.png"][..], &size, &colours].concat(), 0);
    image::open(folder.join("a.png")).unwrap().into_rgb8().into_raw()
}

/// Mean difference of two pictures' channels, of 255.
fn difference(one: &[u8], other: &[u8]) -> f64 {
    assert_eq!(one.len(), other.len());
    let sum: u64 = one.iter().zip(other).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / one.len() as f64
}

#[test]
fn recoloured_picture_is_that_of_a_bake_with_the_colours() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let colours = [("white", [0.3, 0.5, 0.6]), ("red", [0.1, 0.06, 0.7])];
    let other = cornell_with(&folder.join("other.glb"), |json| {
        for (name, [r, g, b]) in colours {
            let materials = json["materials"].as_array_mut().unwrap();
            let material = materials.iter_mut().find(|material| material["name"] == name).unwrap();
            material["pbrMetallicRoughness"]["baseColorFactor"] = serde_json::json!([r, g, b, 1.0]);
        }
    });
    bake(folder, &cornell(), "own");
    bake(folder, &other, "other");
    let words = colours.map(|(name, [r, g, b])| format!("{name}={r},{g},{b}"));
    let recoloured = drawn(folder, "own", &words.each_ref().map(String::as_str));
    let wanted = drawn(folder, "other", &[]);
    let own = drawn(folder, "own", &[]);
    let (of_bakes, of_colours) = (difference(&recoloured, &wanted), difference(&own, &wanted));
    assert!(of_bakes < 0.5 && of_colours > 10.0, "{of_bakes} of 255, without colours {of_colours}");
    // Light that comes piece by piece has them too.
    assert_eq!(drawn_piece_by_piece(folder, &words[0]), drawn(folder, "own", &[&words[0]]));
    let refused = run(within(folder), &["preview", "own", "--out", "b.png", "--material", "blue=0,0,1"], 2);
    let said = refused.stderr();
    assert!(said.contains("'blue'") && said.contains("'green', 'panel', 'red', 'white'"), "{said}");
    assert!(!folder.join("b.png").exists());
}

fn drawn_piece_by_piece(folder: &Path, colour: &str) -> Vec<u8> {
    let size = ["--size", "96x72", "--backend", "cpu", "--tone", "exposure", "--max-bytes", "10M"];
    let arguments = [&["preview", "own", "--out", "c.png", "--material", colour][..], &size].concat();
    run(within(folder), &arguments, 0);
    image::open(folder.join("c.png")).unwrap().into_rgb8().into_raw()
}
