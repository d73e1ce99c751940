//! A frame that changes draws what a new one draws, and makes nothing for it.
//!
//! Ignored by default, as all tests of the adapter: `cargo test -p lightkiln-client --lib -- --ignored adapter`.

use std::time::{Duration, Instant};

use lightkiln_proto::relight::Limit;
use lightkiln_proto::scene::{SceneCamera, SceneLight};

use super::*;
use crate::fixture;
use crate::lights::parse_light;
use crate::passes::compare::Difference;
use crate::passes::shade;
use crate::passes::shadow::ShadowRoom;
use crate::picture::Picture;
use crate::preview::{Backend, View, ViewPath, render_path};
use crate::scene::Recolour;
use crate::tests::{facing, view_of};

const LIMIT: Limit = Limit { bounces_max: 64, change_max: 1e-5 };
/// Bounces end when a change is below the limit, from wherever they came.
const TOLERANCE: f32 = 2e-3;

fn room() -> FrameRoom {
    FrameRoom { size: [160, 120], shadows: ShadowRoom { lights: 4, faces: 16, side: 256 } }
}

fn lights(words: &[&str]) -> Vec<SceneLight> {
    words.iter().map(|words| parse_light(words).unwrap()).collect()
}

/// Lights, emitters and camera of a frame.
struct State {
    lights: Vec<SceneLight>,
    emitters: Vec<f32>,
    camera: SceneCamera,
}

impl State {
    fn set(&self, frame: &mut Frame<'_>) {
        frame.set_lights(&self.lights).unwrap();
        frame.set_emitters(&self.emitters).unwrap();
        frame.set_camera(self.camera.clone()).unwrap();
    }
}

/// Lights of every kind, fewer and more of them, emitters, and the eye.
fn states(camera: &SceneCamera) -> Vec<State> {
    let beside = SceneCamera { eye_m: [1.5, 1.0, 1.2], ..camera.clone() };
    let of = |words: &[&str], emitters: &[f32], camera: &SceneCamera| State {
        lights: lights(words),
        emitters: emitters.to_vec(),
        camera: camera.clone(),
    };
    let sun = "sun dir=0.3,-0.8,0.4 irradiance=3";
    vec![
        of(&["point pos=1,1.5,1 power=20"], &[1.0], camera),
        of(&[sun, "sky zenith=1,1,1 horizon=0.5,0.5,0.5"], &[0.0], camera),
        of(&[sun], &[0.5], &beside),
        of(
            &[
                "point pos=1,0.5,1 color=1,0.2,0 power=15",
                "spot pos=1,1.5,1 target=1,0,1.1 outer=30 power=20",
            ],
            &[2.0],
            camera,
        ),
        of(&[], &[1.5], &beside),
        // Nothing shines: light that goes out leaves none behind.
        of(&[], &[0.0], camera),
        of(&["sky strength=2"], &[0.0], camera),
        of(&["rect pos=1,1.5,1 dir=0.2,-1,0 size=0.6,0.4 power=20 points=3"], &[0.0], camera),
    ]
}

fn drawn(frame: &mut Frame<'_>) -> Vec<Vec4> {
    frame.draw([0.0; 2]).unwrap();
    frame.read().unwrap()
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_the_same_after_changes_as_anew_and_makes_nothing_for_them() {
    let gpu = Gpu::open().unwrap();
    let bakes = [
        (fixture::prt_bake(&fixture::prt_contents()), 8),
        (fixture::sh_bake(), 3),
        (facing::glazed_bake(), 3),
    ];
    for (bake, count) in bakes {
        let camera = view_of(&bake).camera;
        let mut kept = Frame::new(&gpu, &bake, room(), camera.clone()).unwrap();
        for state in states(&camera).into_iter().take(count) {
            let before = gpu.created();
            state.set(&mut kept);
            let (bounces, converged) = kept.settle(LIMIT).unwrap();
            assert!(converged, "{bounces} bounces");
            kept.draw([0.25, 0.0]).unwrap();
            assert_eq!(gpu.created(), before, "what changes makes nothing");
            let got = drawn(&mut kept);
            let mut anew = Frame::new(&gpu, &bake, room(), state.camera.clone()).unwrap();
            state.set(&mut anew);
            anew.settle(LIMIT).unwrap();
            let wanted = drawn(&mut anew);
            let difference = Difference::of_mean(&got, &wanted, TOLERANCE);
            println!("{difference}");
            let is_dark = state.lights.is_empty() && state.emitters == [0.0];
            assert!(is_dark && got == wanted || difference.agrees(0.0), "{difference}");
        }
    }
}

/// Frames go on without a wait: light of the first bounces is drawn, and after some frames it has converged.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_says_without_a_wait_when_bounces_have_converged() {
    let gpu = Gpu::open().unwrap();
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let camera = view_of(&bake).camera;
    let mut frame = Frame::new(&gpu, &bake, room(), camera.clone()).unwrap();
    for state in states(&camera) {
        state.set(&mut frame);
        assert_eq!(frame.change(), None);
        let before = gpu.created();
        let start = Instant::now();
        let is_settled = |frame: &Frame<'_>| frame.change().is_some_and(|change| change < LIMIT.change_max);
        while !is_settled(&frame) {
            frame.advance().unwrap();
            frame.draw([0.0; 2]).unwrap();
            assert!(start.elapsed() < Duration::from_secs(60), "{:?}", frame.change());
        }
        assert_eq!(gpu.created(), before);
        let got = drawn(&mut frame);
        frame.settle(LIMIT).unwrap();
        let settled = drawn(&mut frame);
        let difference = Difference::of_mean(&got, &settled, TOLERANCE);
        assert!(got == settled || difference.agrees(0.0), "{difference}");
    }
}

/// How many frames it takes until other lights are seen: as the window goes, a bounce for each picture.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_shows_most_of_other_lights_in_the_next_frame_and_nearly_all_in_the_one_after() {
    let gpu = Gpu::open().unwrap();
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let mut frame = Frame::new(&gpu, &bake, room(), view_of(&bake).camera).unwrap();
    let sum = |a: &[Vec4], b: &[Vec4]| {
        a.iter().zip(b).map(|(a, b)| (*a - *b).truncate().abs().element_sum()).sum::<f32>()
    };
    let [before, after] =
        [&["point pos=1,1.5,1 power=20"], &["sun dir=0.3,-0.8,0.4 irradiance=3"]].map(|of| lights(of));
    frame.set_lights(&before).unwrap();
    frame.settle(LIMIT).unwrap();
    let old = drawn(&mut frame);
    frame.set_lights(&after).unwrap();
    let pictures: Vec<Vec<Vec4>> = (0..3)
        .map(|_| {
            frame.advance().unwrap();
            drawn(&mut frame)
        })
        .collect();
    frame.settle(LIMIT).unwrap();
    let settled = drawn(&mut frame);
    let all = sum(&old, &settled);
    let left: Vec<f32> = pictures.iter().map(|picture| sum(picture, &settled) / all).collect();
    println!("of the change of the picture {left:?} is left after one, two and three frames");
    assert!(all > 0.1 * sum(&settled, &vec![Vec4::ZERO; settled.len()]), "the lights are alike: {all}");
    assert!(left[0] < 0.15 && left[1] < 0.06, "{left:?}");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_refuses_lights_beyond_the_room_and_keeps_those_it_has() {
    let gpu = Gpu::open().unwrap();
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let camera = view_of(&bake).camera;
    let mut frame = Frame::new(&gpu, &bake, room(), camera.clone()).unwrap();
    frame.set_lights(&lights(&["point pos=1,1.5,1 power=20"])).unwrap();
    frame.settle(LIMIT).unwrap();
    let before = drawn(&mut frame);
    for (count, word) in [(3, "18 shadow maps"), (5, "30 shadow maps")] {
        let many = vec![parse_light("point pos=1,1.5,1 power=20").unwrap(); count];
        let problem = frame.set_lights(&many).unwrap_err().to_string();
        assert!(problem.contains(word), "{problem}");
    }
    let spots = vec![parse_light("spot pos=1,1.5,1 target=1,0,1.1 outer=30 power=20").unwrap(); 5];
    let problem = frame.set_lights(&spots).unwrap_err().to_string();
    assert!(problem.contains("room for 4"), "{problem}");
    for scale in [-1.0, f32::NAN] {
        assert!(frame.set_emitters(&[scale]).is_err());
    }
    for shadows in [
        ShadowRoom { faces: 300, ..room().shadows },
        ShadowRoom { side: 8, ..room().shadows },
        ShadowRoom { faces: 100, side: 4096, lights: 1 },
    ] {
        let refused = Frame::new(&gpu, &bake, FrameRoom { shadows, ..room() }, camera.clone());
        let problem = refused.err().unwrap().to_string();
        assert!(problem.contains("powers of two"), "{problem}");
    }
    let blind = SceneCamera { target_m: camera.eye_m, ..camera };
    assert!(frame.set_camera(blind).is_err());
    assert_eq!(drawn(&mut frame), before);
}

/// Room for more lights of fewer maps holds the lights that there are, until the others are set.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_makes_room_for_other_lights_beside_those_it_has() {
    let gpu = Gpu::open().unwrap();
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let camera = view_of(&bake).camera;
    let room = FrameRoom { shadows: ShadowRoom { lights: 1, faces: 6, side: 256 }, ..room() };
    let mut frame = Frame::new(&gpu, &bake, room, camera).unwrap();
    frame.set_lights(&lights(&["point pos=1,1.5,1 power=20"])).unwrap();
    let spots = lights(&["spot pos=1,1.5,1 target=1,0,1.1 outer=30 power=20"; 3]);
    assert!(frame.set_lights(&spots).is_err());
    let before = drawn(&mut frame);
    frame.make_room(&spots, 256).unwrap();
    assert_eq!(drawn(&mut frame), before);
    frame.set_lights(&spots).unwrap();
    assert_ne!(drawn(&mut frame), before);
}

/// A path on the adapter, whose frame is kept from picture to picture, looks as the processor's, which starts anew for each.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_a_path_as_the_processor_does() {
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let base = View { limit: LIMIT, ..view_of(&bake) };
    let key = |picture: u32, x: f32, power: u32, irradiance: u32| {
        let lights = [
            format!("point pos={x},1.5,1 power={power}"),
            format!("sun dir=0.{picture},-1,0.2 irradiance={irradiance}"),
        ];
        serde_json::json!({ "picture": picture, "lights": lights })
    };
    // Black at first: its exposure is not that of the others.
    let keys = serde_json::json!({ "keys": [key(1, 0.5, 0, 0), key(2, 0.5, 20, 0), key(4, 1.5, 10, 3)] });
    let path = ViewPath::parse(keys.to_string().as_bytes()).unwrap();
    let base = View { emitter_scale: vec![0.0], ..base };
    let drawn = |backend: Backend| {
        let mut all = Vec::new();
        render_path(&bake, &path, &base, backend, |index, picture| {
            assert_eq!(index, all.len());
            assert!(picture.converged, "picture {index}");
            all.push(picture);
            Ok(())
        })
        .unwrap();
        all
    };
    let [got, wanted] = [Backend::Gpu, Backend::Cpu].map(drawn);
    assert_eq!((got.len(), wanted.len()), (4, 4));
    let black = |picture: &Picture| picture.linear.iter().all(|radiance| *radiance == [0.0; 3]);
    assert!(black(&got[0]) && black(&wanted[0]));
    for (got, wanted) in got.iter().zip(&wanted).skip(1) {
        let four = |picture: &Picture| -> Vec<Vec4> {
            picture.linear.iter().map(|radiance| Vec3::from(*radiance).extend(0.0)).collect()
        };
        let difference = Difference::of_mean(&four(got), &four(wanted), shade::TOLERANCE);
        println!("{difference}");
        assert!(difference.agrees(2.0 * shade::OUTLIERS), "{difference}");
        assert!((got.exposure / wanted.exposure - 1.0).abs() < 0.02);
    }
    assert_eq!(got[1].exposure, got[3].exposure);
    assert_ne!(got[0].exposure, got[1].exposure);
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_other_colours_as_a_bake_that_has_them_and_makes_nothing_for_them() {
    let gpu = Gpu::open().unwrap();
    for make in [|| fixture::prt_bake(&fixture::narrow_contents()), fixture::sh_bake] {
        let bake = make();
        let camera = view_of(&bake).camera;
        let lamps = lights(&["point pos=1,1.5,1 power=20"]);
        let mut kept = Frame::new(&gpu, &bake, room(), camera.clone()).unwrap();
        kept.set_lights(&lamps).unwrap();
        kept.settle(LIMIT).unwrap();
        let before = drawn(&mut kept);
        let name = bake.scene.manifest.materials[0].name.clone();
        let colours = [Recolour { material: name, base_colour: [0.05, 0.6, 0.2] }];
        let created = gpu.created();
        kept.set_materials(&colours).unwrap();
        assert!(kept.settle(LIMIT).unwrap().1);
        kept.draw([0.25, 0.0]).unwrap();
        assert_eq!(gpu.created(), created, "what changes makes nothing");
        let got = drawn(&mut kept);
        let mut recoloured = make();
        recoloured.recolour(&colours).unwrap();
        let mut anew = Frame::new(&gpu, &recoloured, room(), camera).unwrap();
        anew.set_lights(&lamps).unwrap();
        anew.settle(LIMIT).unwrap();
        let difference = Difference::of_mean(&got, &drawn(&mut anew), TOLERANCE);
        assert!(difference.agrees(0.0), "{difference}");
        // Back again.
        kept.set_materials(&[]).unwrap();
        kept.settle(LIMIT).unwrap();
        let back = Difference::of_mean(&drawn(&mut kept), &before, TOLERANCE);
        assert!(back.agrees(0.0), "{back}");
        let other = Difference::of_mean(&got, &before, TOLERANCE);
        assert!(!other.agrees(0.1), "colours are seen: {other}");
    }
}
