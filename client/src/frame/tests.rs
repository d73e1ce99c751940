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
use crate::passes::shadow::ShadowRoom;
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

/// What a frame can be set to.
struct State {
    lights: Vec<SceneLight>,
    emitters: Vec<f32>,
    camera: SceneCamera,
}

impl State {
    fn set(&self, frame: &mut Frame<'_>) {
        frame.set_lights(&self.lights).unwrap();
        frame.set_emitters(&self.emitters);
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
    for bake in [fixture::prt_bake(&fixture::prt_contents()), fixture::sh_bake(), facing::glazed_bake()] {
        let camera = view_of(&bake).camera;
        let mut kept = Frame::new(&gpu, &bake, room(), camera.clone()).unwrap();
        for state in states(&camera) {
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
            assert!(difference.agrees(0.0), "{difference}");
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
        let difference = Difference::of_mean(&got, &drawn(&mut frame), TOLERANCE);
        assert!(difference.agrees(0.0), "{difference}");
    }
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
    let blind = SceneCamera { target_m: camera.eye_m, ..camera };
    assert!(frame.set_camera(blind).is_err());
    assert_eq!(drawn(&mut frame), before);
}
