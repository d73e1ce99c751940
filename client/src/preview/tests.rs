//! The preview end to end.

use lightkiln_proto::prt::BasisKind;

use super::*;
use crate::fixture;
use crate::passes::tests::fixture_view;

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
    let irradiance = atlas_picture(&bake, &view, 0).unwrap();
    assert_eq!((irradiance.width, irradiance.height), (40, 16));
    assert!(irradiance.linear.iter().any(|value| value[0] > 0.0));
    let clusters = cluster_picture(&bake, &view, 1);
    let colours = |picture: &Picture| {
        let mut colours: Vec<_> = picture.ldr.clone();
        colours.sort();
        colours.dedup();
        colours.len()
    };
    // Three blocks, each a cluster of its own, and black.
    assert_eq!(colours(&clusters), 4);
}

#[test]
fn camera_and_sun_are_chosen_and_said_when_the_file_has_none() {
    let mut manifest = fixture::manifest(BasisKind::Sh);
    manifest.cameras.clear();
    manifest.lights.clear();
    let bake = LoadedBake::assemble(manifest, fixture::contents(BasisKind::Sh)).unwrap();
    let (_, notes) = View::of_bake(&bake, None, Vec::new());
    assert!(notes.iter().any(|note| note.contains("no camera")), "{notes:?}");
    // The fixture has an emitter: it is lit without a sun.
    assert!(!notes.iter().any(|note| note.contains("no light")), "{notes:?}");
    let (sun, note) = default_sun(&bake);
    assert!(matches!(sun.kind, LightKind::Sun { .. }) && note.contains("sun"), "{note}");
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
