//! The browser's frame, in Chromium: light at receivers and pictures are those of the references on the processor and of the
//! adapter, for the same shaders run on all of them.
//!
//! Ignored by default: `cargo test -p lightkiln-tests --test frame -- --ignored browser`.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod browser;
mod expected;
mod scene;

use glam::Vec4;
use lightkiln_client::passes::compare::Difference;
use serde_json::{Value, json};

use browser::Page;
use expected::{Expected, Light};
use scene::Bundle;

/// Width and height of the pictures in pixels.
const SIZE: [u32; 2] = [192, 128];
/// Largest difference of E_ind, relative to the largest: sums in other orders, and shadow maps that adapters round otherwise.
const INDIRECT_TOLERANCE: f32 = 2e-3;
/// Share of receivers that may differ more.
const INDIRECT_OUTLIERS: f32 = 2e-3;
/// As of the shading pass (`passes::shade`), relative to the picture's mean.
const PICTURE_TOLERANCE: f32 = lightkiln_client::passes::shade::TOLERANCE;
/// As of the shading pass, and as many again: textures are decoded by the browser.
const PICTURE_OUTLIERS: f32 = 2.0 * lightkiln_client::passes::shade::OUTLIERS;
/// Steps of 8 bits by which a channel on the screen may differ for the same radiance.
const SCREEN_STEPS: u8 = 1;

/// Lights of each state that a frame goes through; the first is the bake's own.
fn states() -> Vec<Light> {
    let of = |name, words: &[&str], emitters, camera: Option<&str>| Light {
        name,
        lights: (!words.is_empty()).then(|| words.iter().map(|word| (*word).to_owned()).collect()),
        emitters,
        camera: camera.map(str::to_owned),
    };
    vec![
        of("own", &[], 1.0, None),
        of("moved", &["point pos=-0.6,1.5,0.5 color=1,0.6,0.3 power=60"], 0.25, None),
        of(
            "many",
            &[
                "sun dir=0.4,-0.8,-0.45 color=1,0.9,0.8 irradiance=6",
                "spot pos=0.5,1.9,0.5 target=-0.3,0,-0.3 outer=35 color=0.4,0.6,1 power=80",
                "sky zenith=0.3,0.5,0.9 horizon=0.8,0.8,0.7 strength=1.5",
            ],
            0.0,
            Some("eye=0.9,1.2,1.9 target=-0.2,0.7,-0.5 fov=70"),
        ),
    ]
}

/// Bakes a scene, draws its states in the browser, and holds them against both references.
fn browser_agrees(bundle: &Bundle) {
    let states = states();
    let told: Vec<Value> = states.iter().map(Light::to_json).collect();
    let room = expected::ROOM;
    let job = json!({
        "size": SIZE, "states": told,
        "shadows": { "lights": room.lights, "faces": room.faces, "side": room.side },
    });
    let answers = browser::run(&Page { job, bundle: bundle.folder() });
    let expected = Expected::new(bundle.folder());
    for state in &states {
        let drawn = &answers.states[state.name];
        assert!(drawn.converged, "{}: {} bounces", state.name, drawn.bounces);
        let [indirect, picture] = expected.on_processor(state);
        agrees("E_ind, processor", state.name, &drawn.indirect, &indirect);
        picture_agrees("picture, processor", state.name, &drawn.radiance, &picture);
        let [on_adapter, drawn_by_adapter] = expected.on_adapter(state);
        agrees("E_ind, adapter", state.name, &drawn.indirect, &on_adapter);
        picture_agrees("picture, adapter", state.name, &drawn.radiance, &drawn_by_adapter);
        let screen = expected::on_screen(&drawn.radiance, drawn.exposure);
        let steps = screen.iter().zip(&drawn.screen).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(steps.is_some_and(|steps| steps <= SCREEN_STEPS), "{}: {steps:?} steps", state.name);
        assert_wrong_light_is_seen(drawn, &indirect, &picture);
    }
    assert_eq!(answers.created[0], answers.created[1], "what changes makes nothing");
    assert!(answers.errors.is_empty(), "{:?}", answers.errors);
}

fn agrees(what: &str, state: &str, got: &[Vec4], wanted: &[Vec4]) {
    let difference = Difference::of(got, wanted, INDIRECT_TOLERANCE);
    println!("{state}: {what}: {difference}");
    assert!(difference.agrees(INDIRECT_OUTLIERS), "{state}: {what}: {difference}");
}

fn picture_agrees(what: &str, state: &str, got: &[Vec4], wanted: &[Vec4]) {
    let difference = Difference::of_mean(got, wanted, PICTURE_TOLERANCE);
    println!("{state}: {what}: {difference}");
    assert!(difference.agrees(PICTURE_OUTLIERS), "{state}: {what}: {difference}");
}

/// The comparisons fail for light of another colour, and where a hundredth of it is lost.
fn assert_wrong_light_is_seen(drawn: &browser::Drawn, indirect: &[Vec4], picture: &[Vec4]) {
    let swapped = |of: &[Vec4]| -> Vec<Vec4> { of.iter().map(|v| Vec4::new(v.z, v.y, v.x, v.w)).collect() };
    let dimmed = |of: &[Vec4]| -> Vec<Vec4> { of.iter().map(|v| *v * 0.99).collect() };
    for wrong in [swapped(indirect), dimmed(indirect)] {
        assert!(!Difference::of(&drawn.indirect, &wrong, INDIRECT_TOLERANCE).agrees(INDIRECT_OUTLIERS));
    }
    let wrong = swapped(picture);
    assert!(!Difference::of_mean(&drawn.radiance, &wrong, PICTURE_TOLERANCE).agrees(PICTURE_OUTLIERS));
}

#[test]
#[ignore = "needs Chromium and a graphics adapter"]
fn browser_draws_cornell_as_the_references_do() {
    browser_agrees(&Bundle::cornell());
}

#[test]
#[ignore = "needs Chromium and a graphics adapter"]
fn browser_draws_glass_textures_and_near_hits_as_the_references_do() {
    browser_agrees(&Bundle::flat());
}
