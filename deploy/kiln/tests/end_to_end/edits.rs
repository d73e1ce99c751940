//! Edits of a scene that are shown before they are baked.

use std::path::Path;
use std::process::Command;

use super::cornell;
use super::processes::{kiln, run};

const LOOK: [&str; 6] = ["--size", "64x48", "--backend", "cpu", "--out", "a.png"];

fn within(folder: &Path) -> Command {
    let mut command = kiln(&folder.join("state"));
    command.current_dir(folder).env("KILN_STATE", folder.join("cache"));
    command
}

#[test]
fn edit_is_drawn_beside_the_bake_of_before_and_refused_where_that_cannot_be() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = cornell().display().to_string();
    let few = ["--preset", "draft", "--set", "receivers_target=3000", "--set", "transport_rays=32"];
    for (kind, more) in [("prt", &["--set", "voxels=on"][..]), ("sh", &[])] {
        let out = format!("{kind}.kiln");
        let rest = ["--kind", kind, "--out", &out];
        run(within(at), &[&["bake", &scene][..], &few[..4], &rest, more].concat(), 0);
    }
    let shown = |bundle: &str, scene: &str, exit: i32| {
        run(within(at), &[&["preview", bundle, "--edit", scene, "--json"][..], &LOOK].concat(), exit)
    };
    let same = shown("prt.kiln", &scene, 0);
    assert_eq!(same.json()["provisional"], 0.0, "{}", same.json());
    assert!(same.stderr().contains("0 have all of their light from walks, 0 some"), "{}", same.stderr());
    for (bundle, scene, word) in [
        ("prt.kiln", "none.glb", "none.glb"),
        ("sh.kiln", &scene, "no edits"),
        ("none.kiln", &scene, "none.kiln"),
    ] {
        let refused = shown(bundle, scene, 2);
        assert!(refused.stderr().contains(word), "{}", refused.stderr());
    }
}
