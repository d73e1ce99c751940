//! The viewer without a window: input moves the picture, at once, and states go where they should.
//!
//! Ignored where there is no adapter: `cargo test -p lightkiln-client --features view --lib -- --ignored adapter`.

use std::sync::Arc;

use glam::Vec2;
use lightkiln_proto::scene::LightKind;

use super::edits::new_light;
use super::input::{Button, Input, Key};
use super::viewer::Viewer;
use crate::bake::{COLUMNS, LoadedBake, MeasuredErrors, Overlay};
use crate::fixture;
use crate::passes::gpu::Gpu;
use crate::picture::Exposure;
use crate::preview::{Backend, View, render};
use crate::tests::objects::{cube_at, lamp_view, with_cube};
use crate::tests::{fixture_view, view_of};

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Bgra8Unorm;
/// Pictures until light must have settled.
const PATIENCE: usize = 400;

fn fixture_viewer() -> (Viewer, View) {
    let (bake, view) = fixture_view();
    (viewer(bake, &view), view)
}

fn viewer(bake: LoadedBake, view: &View) -> Viewer {
    let gpu = Arc::new(Gpu::open().unwrap());
    Viewer::new((gpu, FORMAT), Arc::new(bake), view.clone(), &[]).unwrap()
}

/// Goes on until nothing is left to do.
fn settle(viewer: &mut Viewer) {
    for _ in 0..PATIENCE {
        if !viewer.is_busy() {
            return;
        }
        viewer.step(0.01).unwrap();
        // Reading a picture waits for the adapter: an answer of its light meter may be all that is to come.
        viewer.picture().unwrap();
    }
    panic!("busy after {PATIENCE} pictures: {:?}", viewer.settling());
}

/// Mean difference of two pictures' channels, of 255.
fn difference(one: &[[u8; 4]], other: &[[u8; 4]]) -> f64 {
    assert_eq!(one.len(), other.len());
    let of = |(a, b): (&[u8; 4], &[u8; 4])| -> u64 { (0..3).map(|i| u64::from(a[i].abs_diff(b[i]))).sum() };
    one.iter().zip(other).map(of).sum::<u64>() as f64 / (3 * one.len()) as f64
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_shows_the_picture_that_preview_draws() {
    for bake in [fixture::prt_bake(&fixture::prt_contents()), fixture::sh_bake()] {
        let view = view_of(&bake);
        let wanted = render(&bake, &view, Backend::Gpu).unwrap();
        let mut viewer = viewer(bake, &view);
        settle(&mut viewer);
        let got = viewer.picture().unwrap();
        let off = difference(&got, &wanted.ldr);
        assert!(off < 0.5, "{off} of 255");
        viewer.edits.exposure = Exposure::Fixed(0.5 * wanted.exposure);
        settle(&mut viewer);
        assert!(difference(&viewer.picture().unwrap(), &wanted.ldr) > 5.0, "exposure is seen");
    }
}

/// A light that is dragged is seen in the very next picture, and its bounced light in the one after.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_shows_a_dragged_light_in_the_next_picture() {
    let (mut viewer, _) = fixture_viewer();
    viewer.edits.exposure = Exposure::Fixed(viewer.exposure());
    settle(&mut viewer);
    let before = viewer.picture().unwrap();
    let handle = viewer.handles()[0];
    viewer.input(Input::Pointer(handle.pixel));
    viewer.input(Input::Button(Button::Left, true));
    assert_eq!(viewer.chosen, Some(handle.light));
    let to = handle.pixel + Vec2::new(-30.0, 20.0);
    viewer.input(Input::Pointer(to));
    viewer.input(Input::Button(Button::Left, false));
    viewer.input(Input::Pointer(Vec2::ZERO));
    assert!(viewer.handles()[0].pixel.distance(to) < 0.05, "it stays where it was let go");
    assert!(viewer.is_busy());
    viewer.step(0.01).unwrap();
    let first = viewer.picture().unwrap();
    assert!(difference(&before, &first) > 2.0, "seen in the first picture");
    assert_eq!(viewer.settling().bounces, 1);
    settle(&mut viewer);
    let settled = viewer.picture().unwrap();
    let (of_first, of_before) = (difference(&first, &settled), difference(&before, &settled));
    assert!(of_first < 0.5 * of_before, "most of it in the first picture: {of_first} of {of_before}");
    assert!(viewer.settling().is_settled && !viewer.is_busy());
}

/// Objects that are moved in the panel are seen in the very next picture, which previews draw alike.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_shows_moved_objects_as_previews_do() {
    let (bake, view) = lamp_view();
    let bake = with_cube(bake, None);
    let [near, other] = [cube_at([1.0, 0.4, 1.0], 0.5), cube_at([0.6, 0.5, 1.3], 0.3)];
    let view = View { objects: near, ..view };
    let mut viewer = viewer(bake, &view);
    viewer.edits.exposure = Exposure::Fixed(viewer.exposure());
    settle(&mut viewer);
    let before = viewer.picture().unwrap();
    viewer.edits.objects[0].stance = other[0];
    assert!(viewer.is_busy());
    viewer.step(0.01).unwrap();
    assert!(difference(&before, &viewer.picture().unwrap()) > 0.5, "seen in the first picture");
    settle(&mut viewer);
    let wanted = render(viewer.bake(), &viewer.view(), Backend::Gpu).unwrap();
    let off = difference(&viewer.picture().unwrap(), &wanted.ldr);
    assert!(off < 0.5, "{off} of 255");
    (viewer.edits.objects[0].plays, viewer.edits.objects[0].length_s) = (true, 2.0);
    viewer.step(0.25).unwrap();
    assert!(viewer.is_busy() && viewer.edits.objects[0].stance.time_s == 0.25);
    viewer.edits.objects[0].plays = false;
    // An invalid place is refused, with a notice.
    viewer.edits.objects[0].stance.position_m[0] = f32::NAN;
    viewer.step(0.01).unwrap();
    assert_eq!(viewer.edits.objects[0].stance.position_m, other[0].position_m);
    assert!(
        viewer.notice.as_ref().is_some_and(|notice| notice.contains("not finite")),
        "{:?}",
        viewer.notice
    );
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_shows_flight_and_looks_and_comes_home() {
    let (mut viewer, _) = fixture_viewer();
    settle(&mut viewer);
    let home = viewer.picture().unwrap();
    viewer.input(Input::Key(Key::Forward, true));
    viewer.step(0.2).unwrap();
    viewer.input(Input::Release);
    viewer.input(Input::Pointer(Vec2::new(50.0, 50.0)));
    viewer.input(Input::Button(Button::Right, true));
    viewer.input(Input::Pointer(Vec2::new(80.0, 40.0)));
    viewer.input(Input::Button(Button::Right, false));
    viewer.input(Input::Pointer(Vec2::new(0.0, 0.0)));
    settle(&mut viewer);
    let away = viewer.picture().unwrap();
    assert!(difference(&home, &away) > 5.0);
    viewer.input(Input::Key(Key::Home, true));
    assert!(viewer.is_busy());
    settle(&mut viewer);
    assert!(difference(&home, &viewer.picture().unwrap()) < 0.5);
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_follows_lights_that_come_and_go_colours_and_overlays() {
    let (mut viewer, view) = fixture_viewer();
    settle(&mut viewer);
    let before = viewer.picture().unwrap();
    // More lights than there was room for.
    for number in 0..4 {
        let mut light = new_light("point", number, [2.0, 1.5, 2.5], 2.0);
        light.strength = [20.0, 2.0, 2.0];
        viewer.edits.lights.push(light);
    }
    settle(&mut viewer);
    assert_eq!(viewer.notice, None);
    assert!(difference(&before, &viewer.picture().unwrap()) > 2.0);
    while viewer.edits.lights.len() > view.lights.len() {
        viewer.chosen = Some(viewer.edits.lights.len() - 1);
        viewer.input(Input::Key(Key::Delete, true));
    }
    settle(&mut viewer);
    assert!(difference(&before, &viewer.picture().unwrap()) < 1.0, "shadow maps of fewer texels stay");
    let mut seen = vec![viewer.picture().unwrap()];
    for overlay in [Overlay::Clusters, Overlay::Patches, Overlay::Residency { clusters: 1 }] {
        viewer.edits.overlay = Some(overlay);
        settle(&mut viewer);
        let picture = viewer.picture().unwrap();
        assert!(seen.iter().all(|other| difference(other, &picture) > 5.0), "{overlay:?}");
        seen.push(picture);
    }
    // One place with too much light.
    let [low, high] = viewer.bake().scene.manifest.bounds_m.map(glam::Vec3::from);
    let at = 0.5 * (low + high);
    let mut text = format!("{}\n", COLUMNS.join(","));
    for normal in ["1,0,0", "-1,0,0", "0,1,0", "0,-1,0", "0,0,1", "0,0,-1"] {
        text += &format!("sun,{},{},{},{normal},1,3,3,3,1,1,1,1\n", at.x, at.y, at.z);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("places.csv");
    std::fs::write(&path, text).unwrap();
    viewer.show_errors(MeasuredErrors::read(&path).unwrap()).unwrap();
    settle(&mut viewer);
    let picture = viewer.picture().unwrap();
    assert!(seen.iter().all(|other| difference(other, &picture) > 5.0));
    let is_red = |pixel: &&[u8; 4]| i32::from(pixel[0]) > i32::from(pixel[1]) + 100;
    assert!(picture.iter().filter(is_red).count() > picture.len() / 4, "errors are not seen");
    viewer.edits.overlay = Some(Overlay::Errors { light: 7 });
    settle(&mut viewer);
    assert!(viewer.notice.take().is_some_and(|notice| notice.contains("Errors")));
    assert_eq!(viewer.edits.overlay, Some(Overlay::Errors { light: 0 }));
    viewer.edits.overlay = None;
    viewer.edits.colours[0].now = [0.9, 0.05, 0.05];
    settle(&mut viewer);
    assert!(difference(&seen[0], &viewer.picture().unwrap()) > 2.0);
    // An edit that cannot be is refused, said, and taken back.
    viewer.edits.emitters = vec![-1.0];
    settle(&mut viewer);
    assert!(viewer.notice.take().is_some_and(|notice| notice.contains("negative")));
    assert_eq!(viewer.edits.emitters, view.emitter_scale);
    for light in &viewer.edits.lights.clone() {
        viewer.edits.lights.extend(vec![light.clone(); 60]);
    }
    settle(&mut viewer);
    assert!(viewer.notice.is_some());
    assert_eq!(viewer.edits.lights.len(), view.lights.len());
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_nothing_for_a_window_without_size_and_all_of_one_that_grows() {
    let (mut viewer, view) = fixture_viewer();
    for size in [[0, 0], [0, 50], [50, 0]] {
        viewer.resize(size).unwrap();
        assert_eq!(viewer.size(), [view.width, view.height]);
    }
    settle(&mut viewer);
    viewer.resize([320, 90]).unwrap();
    settle(&mut viewer);
    let got = viewer.picture().unwrap();
    let (bake, _) = fixture_view();
    let wanted = render(&bake, &View { width: 320, height: 90, ..view }, Backend::Gpu).unwrap();
    let off = difference(&got, &wanted.ldr);
    assert!(off < 0.5, "{off} of 255");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_that_is_lost_is_an_error_that_says_so() {
    let (bake, view) = fixture_view();
    let gpu = Arc::new(Gpu::open().unwrap());
    let mut viewer = Viewer::new((Arc::clone(&gpu), FORMAT), Arc::new(bake), view, &[]).unwrap();
    gpu.device.destroy();
    let mut problem = None;
    for _ in 0..10 {
        viewer.input(Input::Wheel(1.0));
        viewer.edits.lights[0].strength[0] *= 1.5;
        problem = problem.or(viewer.step(0.01).err());
    }
    let problem = problem.unwrap().to_string();
    assert!(problem.contains("is lost") && problem.contains("start again"), "{problem}");
}

/// Light that gets better while one looks keeps everything that was set.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_takes_better_light_without_losing_edits() {
    let (mut viewer, view) = fixture_viewer();
    viewer.edits.emitters = vec![0.5];
    viewer.edits.colours[0].now = [0.3, 0.4, 0.5];
    viewer.input(Input::Key(Key::Forward, true));
    viewer.step(0.1).unwrap();
    viewer.input(Input::Release);
    settle(&mut viewer);
    let wanted = viewer.picture().unwrap();
    let scene = Arc::clone(&fixture_view().0.scene);
    let light = Box::new(fixture::prt_light(&fixture::narrow_contents()).1);
    viewer.set_bake(Arc::new(LoadedBake::new(Arc::clone(&scene), light))).unwrap();
    settle(&mut viewer);
    let other = viewer.picture().unwrap();
    let light = Box::new(fixture::prt_light(&fixture::prt_contents()).1);
    viewer.set_bake(Arc::new(LoadedBake::new(scene, light))).unwrap();
    settle(&mut viewer);
    let got = viewer.picture().unwrap();
    assert!(difference(&got, &wanted) < 0.5, "{}", difference(&got, &wanted));
    println!("other light differs by {} of 255", difference(&other, &wanted));
    assert_eq!(viewer.edits.lights, view.lights);
    assert!(matches!(viewer.edits.lights[0].kind, LightKind::Point { .. }));
}
