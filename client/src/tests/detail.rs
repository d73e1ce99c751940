//! Levels of detail: the adapter's bounces against the processor's, and frames that take them without making anything.

use lightkiln_proto::relight::{Limit, Lod, LodDistance, LodLevel};
use lightkiln_proto::scene::SceneCamera;
use lightkiln_proto::words::lod_from_text;

use super::{prepared, view_of};
use crate::bake::{LoadedBake, Overlay};
use crate::fixture;
use crate::frame::{Frame, FrameRoom, lod_eye};
use crate::lights::parse_light;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::lod;
use crate::passes::shadow::ShadowRoom;
use crate::passes::shadow::reference::draw;
use crate::preview::{Backend, View, ViewPath, render_path};

/// Levels that meet within the fixture's room, each of them otherwise.
const SETTINGS: [&str; 6] = [
    "level0=0,0,all,0,1 level1=0.3,1,16,1,1 level2=0.5,1,8,2,2 level3=0.7,1,8,3,4",
    "level0=0,1,8,0,2",
    "level0=0,0,all,3,1 level1=0,0,all,3,1 level2=0,0,all,3,1 level3=0,0,all,3,1 blend=0",
    "level0=0,0,all,0,1 level1=2.5m,0,all,2,1 blend=1 beside=3 behind=9",
    "level0=0,0,all,0,4 level1=0.4,0,16,1,4 blend=0.4",
    "level0=0,0,24,1,16 level1=0.5,1,16,1,16",
];

fn room() -> FrameRoom {
    FrameRoom { size: [160, 120], shadows: ShadowRoom { lights: 2, faces: 12, side: 256 } }
}

/// A view under a sky and the lamp of the room, whose light no shadow map has: both sides start from the same numbers.
fn unshadowed_view(bake: &LoadedBake, lod: Option<Lod>) -> View {
    let sky = parse_light("sky zenith=1,0.8,0.6 horizon=0.3,0.5,0.9").unwrap();
    let camera = SceneCamera { eye_m: [0.4, 1.0, 0.4], target_m: [2.0, 1.0, 3.0], ..view_of(bake).camera };
    View { camera, lights: vec![sky], lod, ..view_of(bake) }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_bounces_in_detail_as_the_processor_does() {
    let mut gpu = Gpu::open().unwrap();
    // With room for everything, and with every array paged.
    for binding_max in [gpu.binding_max, 16 << 10] {
        gpu.binding_max = binding_max;
        for bake in [fixture::prt_bake(&fixture::narrow_contents()), fixture::sh_bake()] {
            for settings in SETTINGS {
                bounces_agree(&gpu, &bake, settings);
            }
        }
    }
}

fn bounces_agree(gpu: &Gpu, bake: &LoadedBake, settings: &str) {
    let view = unshadowed_view(bake, Some(lod_from_text(settings).unwrap()));
    let prepared = prepared(bake, &view);
    let maps = draw(&prepared.scene, &prepared.plan);
    let after = |bounces_max, has_detail: bool| {
        let lit = prepared.lit(&maps);
        let lit = crate::bake::LitScene { lod: lit.lod.filter(|_| has_detail), ..lit };
        let limit = Limit { bounces_max, change_max: 0.0 };
        bake.light.at_receivers(&lit, &Default::default(), limit).unwrap().light.indirect
    };
    let mut frame = Frame::new(gpu, bake, room(), view.camera.clone()).unwrap();
    frame.set_emitters(&view.emitter_scale).unwrap();
    frame.set_lights(&view.lights).unwrap();
    frame.set_lod(view.lod).unwrap();
    for bounce in 1..=6 {
        frame.advance().unwrap();
        let got = frame.read_receivers().unwrap().unwrap().indirect;
        let difference = Difference::of(&got, &after(bounce, true), lod::TOLERANCE);
        assert!(difference.agrees(0.0), "'{settings}', bounce {bounce}: {difference}");
        // All detail is told from it.
        let other = Difference::of(&got, &after(bounce, false), lod::TOLERANCE);
        assert!(!other.agrees(0.0), "'{settings}', bounce {bounce}: {other}");
    }
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_takes_levels_of_detail_without_making_anything_and_gives_all_of_it_back() {
    let gpu = Gpu::open().unwrap();
    let bake = fixture::prt_bake(&fixture::narrow_contents());
    let view = view_of(&bake);
    let lights = [parse_light("point pos=1,1.5,1 power=20").unwrap()];
    let light = |lod: &[Option<&str>]| {
        let mut frame = Frame::new(&gpu, &bake, room(), view.camera.clone()).unwrap();
        frame.set_lights(&lights).unwrap();
        for settings in lod {
            frame.set_lod(settings.map(|settings| lod_from_text(settings).unwrap())).unwrap();
            frame.advance().unwrap();
        }
        frame.set_lod(None).unwrap();
        assert!(frame.lod_counts().is_none());
        for _ in 0..60 {
            frame.advance().unwrap();
        }
        frame.read_receivers().unwrap().unwrap().indirect
    };
    // Bounces that began with other light end within their own rounding.
    let difference = Difference::of(&light(&SETTINGS.map(Some)), &light(&[]), 1e-6);
    assert!(difference.agrees(0.0), "all detail comes back: {difference}");

    let mut frame = Frame::new(&gpu, &bake, room(), view.camera.clone()).unwrap();
    frame.set_lights(&lights).unwrap();
    frame.set_lod(Lod::preset("coarse")).unwrap();
    frame.set_overlay(Some(Overlay::Lod)).unwrap();
    let before = gpu.created();
    for settings in SETTINGS {
        frame.set_lod(Some(lod_from_text(settings).unwrap())).unwrap();
        assert_eq!(frame.change(), None, "other detail is a change of light");
        for x in [0.5, 1.5, 2.5] {
            let camera = SceneCamera { eye_m: [x, 1.2, 0.5], ..view.camera.clone() };
            frame.set_camera(camera).unwrap();
            frame.advance().unwrap();
            frame.draw([0.0; 2]).unwrap();
        }
    }
    frame.set_lod(None).unwrap();
    assert_eq!(gpu.created(), before, "what changes makes nothing");
}

/// Clusters that take turns have settled when each has had one: not when the first of them changes nothing.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_settles_in_detail_where_it_does_without_turns() {
    let gpu = Gpu::open().unwrap();
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let view = view_of(&bake);
    let settled = |interval| {
        let mut lod = Lod::preset("balanced").unwrap();
        lod.levels = [LodLevel { interval, ..LodLevel::full(LodDistance::Metres(0.0)) }; 4];
        let mut frame = Frame::new(&gpu, &bake, room(), view.camera.clone()).unwrap();
        frame.set_lights(&[parse_light("point pos=1,1.5,1 power=20").unwrap()]).unwrap();
        frame.set_lod(Some(lod)).unwrap();
        let (bounces, converged) = frame.settle(Limit { bounces_max: 400, change_max: 1e-5 }).unwrap();
        assert!(converged && bounces >= interval, "{bounces} bounces");
        frame.read_receivers().unwrap().unwrap().indirect
    };
    let wanted = settled(1);
    for interval in [2, 16] {
        let difference = Difference::of(&settled(interval), &wanted, 1e-4);
        assert!(difference.agrees(0.0), "{difference}");
    }
}

/// On the adapter too, which keeps a frame from picture to picture, and a plan as long as an eye moves on.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_plans_each_picture_of_a_path_for_its_own_eye() {
    let bake = fixture::prt_bake(&fixture::narrow_contents());
    let lod = lod_from_text("level1=0.5,1,all,1,1 margin=1").unwrap();
    let base = View { lod: Some(lod), ..view_of(&bake) };
    let key = |picture: u32, z: f32| {
        let camera = format!("eye=2,1.5,{z} target=2,1.5,4 fov=60");
        serde_json::json!({ "picture": picture, "camera": camera })
    };
    let keys = serde_json::json!({ "keys": [key(1, -1.0), key(5, -9.0)] });
    let path = ViewPath::parse(keys.to_string().as_bytes()).unwrap();
    let counts = |backend: Backend| {
        let mut counts = Vec::new();
        render_path(&bake, &path, &base, backend, |_, picture| {
            counts.push(picture.lod.unwrap());
            Ok(())
        })
        .unwrap();
        counts
    };
    let [got, wanted] = [Backend::Gpu, Backend::Cpu].map(counts);
    assert_eq!((got.len(), &got), (5, &wanted));
    // Plans that know of each other would keep the first levels for longer.
    let mut before = None;
    let kept = (1..=5).map(|picture| {
        let view = path.view(picture, &base);
        let eye = lod_eye(&bake, &view.camera, [view.width, view.height]).unwrap();
        before = bake.light.plan_lod(&lod, eye, before.as_ref());
        bake.light.count_lod(before.as_ref().unwrap()).unwrap()
    });
    assert_ne!(kept.collect::<Vec<_>>(), wanted);
}

#[test]
fn levels_follow_the_eye_and_its_view() {
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let lod =
        lod_from_text("level0=0,0,all,0,1 level1=0.25,1,16,1,1 level2=0.5,1,8,2,1 level3=1,1,8,3,1").unwrap();
    let computed = |eye_m: [f32; 3], target_m: [f32; 3]| {
        let camera = SceneCamera { eye_m, target_m, ..view_of(&bake).camera };
        let view = View { camera, lod: Some(lod), ..view_of(&bake) };
        let plan = prepared(&bake, &view).lod.unwrap();
        let counts = bake.light.count_lod(&plan).unwrap();
        counts.iter().map(|count| count.receivers_computed).sum::<u64>()
    };
    let within = computed([2.0, 1.5, 0.5], [2.0, 1.5, 4.0]);
    let [before, away] = [4.0, -30.0].map(|z| computed([2.0, 1.5, -2.0], [2.0, 1.5, z]));
    assert!(within > before && before > away, "{within} {before} {away}");
    // A parallel camera sees all alike.
    let parallel = SceneCamera { orthographic_half_height_m: Some(2.0), ..view_of(&bake).camera };
    let view = View { camera: parallel, lod: Some(lod), ..view_of(&bake) };
    assert!(prepared(&bake, &view).lod.is_none());
}
