//! The preview end to end.

use std::sync::Arc;

use lightkiln_proto::manifest::Chosen;

use super::*;
use crate::lightmap::{ATLAS, CLUSTERS};
use crate::tests::fixture_view;

#[test]
fn processor_draws_a_picture_to_a_file() {
    let (bake, view) = fixture_view();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.png");
    let picture = render_png(&bake, &view, Backend::Cpu, &path).unwrap();
    assert!(picture.by_reference && picture.drawn_by.contains("slower"), "{}", picture.drawn_by);
    let read = image::open(&path).unwrap().into_rgba8();
    assert_eq!((read.width(), read.height()), (160, 120));
    assert!(read.pixels().zip(&picture.ldr).all(|(read, drawn)| read.0 == *drawn));
    let mut shades: Vec<_> = picture.ldr.clone();
    shades.sort();
    shades.dedup();
    assert!(shades.len() > 500, "{}", shades.len());
    if let Some(folder) = std::env::var_os("KILN_KEEP_PICTURES") {
        let large = View { width: 960, height: 720, ..view };
        let kept = Path::new(&folder).join("fixture-cpu.png");
        render_png(&bake, &large, Backend::Cpu, &kept).unwrap();
    }
}

#[test]
fn debug_pictures_show_the_atlas_and_its_clusters() {
    let (bake, view) = fixture_view();
    let irradiance = debug_picture(&bake, &view, ATLAS, 0).unwrap();
    assert_eq!((irradiance.width, irradiance.height), (40, 16));
    assert!(irradiance.linear.iter().any(|value| value[0] > 0.0));
    let clusters = debug_picture(&bake, &view, CLUSTERS, 1).unwrap();
    let colours = |picture: &Picture| {
        let mut colours: Vec<_> = picture.ldr.clone();
        colours.sort();
        colours.dedup();
        colours.len()
    };
    // Three blocks, each a cluster of its own, and black.
    assert_eq!(colours(&clusters), 4);
    let [unknown, beyond] = [("probes", 0), (ATLAS, 9)]
        .map(|(name, page)| debug_picture(&bake, &view, name, page).unwrap_err().to_string());
    assert!(unknown.contains("atlas, clusters") && beyond.contains("2 pages"), "{unknown}; {beyond}");
}

#[test]
fn camera_and_light_chosen_at_the_bake_are_used_and_said() {
    let (mut bake, _) = fixture_view();
    let manifest = &mut Arc::make_mut(&mut bake.scene).manifest;
    let (camera, light) = (manifest.cameras.remove(0), manifest.lights.remove(0));
    manifest.lights.clear();
    assert!(View::of_bake(&bake, None, None).unwrap_err().to_string().contains("--camera"));
    let manifest = &mut Arc::make_mut(&mut bake.scene).manifest;
    manifest.framing.camera = Some(Chosen { value: camera.clone(), note: "no camera".to_owned() });
    manifest.framing.light = Some(Chosen { value: light.clone(), note: "no light".to_owned() });
    // The fixture has an emitter: a light is chosen all the same where that lights next to nothing.
    assert!(!manifest.emitters.is_empty());
    let (view, notes) = View::of_bake(&bake, None, None).unwrap();
    assert_eq!((view.camera, view.lights), (camera.clone(), vec![light]));
    assert_eq!(notes, ["no camera", "no light"]);
    Arc::make_mut(&mut bake.scene).manifest.framing.light = None;
    let (view, notes) = View::of_bake(&bake, Some(camera), None).unwrap();
    assert!(view.lights.is_empty() && notes.is_empty(), "{notes:?}");
}

#[test]
fn views_that_cannot_be_drawn_are_errors() {
    let (bake, view) = fixture_view();
    let blind = SceneCamera { target_m: view.camera.eye_m, ..view.camera.clone() };
    let mut bad_light = view.lights.clone();
    bad_light[0].strength = [f32::NAN; 3];
    let many = vec![view.lights[0].clone(); 50];
    let views = [
        View { width: 0, ..view.clone() },
        View { height: MAX_SIDE + 1, ..view.clone() },
        View { samples: 0, ..view.clone() },
        View { camera: blind, ..view.clone() },
        View { lights: bad_light, ..view.clone() },
        View { lights: many, ..view.clone() },
    ];
    for bad in views {
        let error = render(&bake, &bad, Backend::Cpu).unwrap_err();
        assert!(matches!(error, ClientError::Argument { .. }), "{error}");
    }
}
