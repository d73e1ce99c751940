//! The browser's frame: light at receivers and pictures are those of the references on the processor and of the native adapter,
//! which runs the same shaders.

mod expected;

use glam::Vec4;
use lightkiln_client::passes::compare::Difference;
use lightkiln_client::passes::shade;
use lightkiln_client::picture::automatic_exposure;
use lightkiln_client::scene::Recolour;
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::driver::Browser;
use super::files::{Answer, Files};
use super::{bundle_opened, bytes_of_hex as bytes, skies};
use expected::{Expected, LIMIT, ROOM, State};

const MODULE: &str = "/pages/relight.js";
/// The state with other colours of materials.
const PAINTED: &str = "painted";
/// The state in levels of detail.
const DETAILED: &str = "detailed";
/// The state under a panorama.
const UNDER_SKY: &str = "under a sky";
/// Its levels, which meet within small scenes, each of them otherwise.
const LEVELS: &str = "level0=0,0,all,0,1 level1=0.3,1,16,1,1 level2=0.5,1,8,2,2 level3=0.7,1,8,3,4";
/// Width and height of the pictures in pixels.
const SIZE: [u32; 2] = [192, 128];
/// Samples per pixel of the smooth pictures.
const SAMPLES: u32 = 4;
/// Largest difference of E_ind, relative to the largest: sums in other orders, and shadow maps that adapters round otherwise.
const INDIRECT_TOLERANCE: f32 = 2e-3;
/// Share of receivers that may differ more.
const INDIRECT_OUTLIERS: f32 = 2e-3;
/// Thrice those of the shading pass: textures are decoded by the browser, and its software adapter moves outlines by 1/32 pixel.
const PICTURE_OUTLIERS: f32 = 3.0 * shade::OUTLIERS;
/// Steps of 8 bits by which a channel on the screen may differ for the same radiance.
const SCREEN_STEPS: u8 = 1;
/// Steps of 8 bits that the screen makes of the picture's tolerance.
const SMOOTH_STEPS: u8 = 6;

/// Light and pictures of one state, as a page drew them.
struct Drawn {
    /// E_ind by slot.
    indirect: Vec<Vec4>,
    /// Radiance of pixels.
    radiance: Vec<Vec4>,
    /// The screen, four bytes a pixel: one sample, and many.
    screens: [Vec<u8>; 2],
    /// Factor on radiance.
    exposure: f32,
}

impl Drawn {
    fn new(told: &Value) -> Self {
        assert_eq!(told["converged"], true, "{} bounces", told["bounces"]);
        Self {
            indirect: vectors(&told["indirect"]),
            radiance: vectors(&told["radiance"]),
            screens: ["screen", "smooth"].map(|name| bytes(&told[name])),
            exposure: told["exposure"].as_f64().expect("a number") as f32,
        }
    }
}

fn vectors(hex: &Value) -> Vec<Vec4> {
    let number = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let vector = |of: &[u8]| Vec4::from_array([0, 4, 8, 12].map(|at| number(&of[at..])));
    bytes(hex).chunks_exact(16).map(vector).collect()
}

/// Colours of Cornell's materials.
fn of_cornell() -> Vec<Recolour> {
    vec![colour("red", [0.1, 0.2, 0.7]), colour("white", [0.3, 0.55, 0.4])]
}

/// Colours of the flat's: one whiter than albedo may be, and of a floor with a texture.
fn of_flat() -> Vec<Recolour> {
    vec![
        colour("colour 0", [1.0, 1.0, 0.9]),
        colour("colour 2", [0.25, 0.6, 0.5]),
        colour("floor", [0.3, 0.6, 0.9]),
    ]
}

fn colour(material: &str, base_colour: [f32; 3]) -> Recolour {
    Recolour { material: material.to_owned(), base_colour }
}

/// States that a frame goes through: the bake's own, a lamp elsewhere, other lights and another eye, other colours, a rectangle.
fn states(materials: &[Recolour]) -> Vec<State> {
    let of = |name, words: &[&str], emitters, camera: Option<&str>| State {
        materials: if name == PAINTED { materials.to_vec() } else { Vec::new() },
        lod: (name == DETAILED).then_some(LEVELS),
        sky: (name == UNDER_SKY).then_some([140.0, 1.5]),
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
        of(PAINTED, &[], 1.0, None),
        of(DETAILED, &[], 1.0, None),
        of(
            UNDER_SKY,
            &[
                "point pos=-0.6,1.5,0.5 color=1,0.6,0.3 power=60",
                "sky zenith=0.1,0.2,0.3 horizon=0.2,0.1,0.1",
            ],
            0.0,
            None,
        ),
        of(
            "rectangle",
            &["rect pos=0.1,1.6,0.2 dir=0.2,-1,0.1 size=0.5,0.3 color=1,0.8,0.5 power=40"],
            0.0,
            None,
        ),
    ]
}

fn job(states: &[State]) -> Value {
    json!({
        "size": SIZE,
        "samples": SAMPLES,
        "limit": { "bouncesMax": LIMIT.bounces_max, "changeMax": LIMIT.change_max },
        "shadows": { "lights": ROOM.lights, "faces": ROOM.faces, "side": ROOM.side },
        "states": states.iter().map(State::to_json).collect::<Vec<_>>(),
    })
}

/// A server of the modules, the shaders, a bundle and a panorama, and a browser there.
fn opened(bundle: &Bundle) -> (Files, Browser) {
    bundle_opened(bundle, |request| (request.path == "/sky.hdr").then(|| Answer::of(skies::file())))
}

/// Draws the states of a bake in the browser, that under a panorama from an eye of its own where there is one, and holds them against
/// both references.
fn browser_agrees(bundle: &Bundle, colours: &[Recolour], sky_camera: Option<&str>) {
    let (mut states, (_files, browser)) = (states(colours), opened(bundle));
    for state in states.iter_mut().filter(|state| state.sky.is_some()) {
        state.camera = sky_camera.map(str::to_owned);
    }
    let told = browser.run(MODULE, "draw", json!([job(&states)]));
    assert_eq!(told["errors"], json!([]));
    let created = told["created"].as_array().expect("a list");
    assert!(
        created.len() == states.len() && created.iter().all(|made| made == 0),
        "changes make {created:?}"
    );
    let [baked, painted] = [&[], colours].map(|colours| Expected::new(bundle.folder(), colours));
    let mut wrong = Vec::new();
    for state in &states {
        let drawn = Drawn::new(&told["states"][state.name]);
        let expected = if state.materials.is_empty() { &baked } else { &painted };
        let on_processor = expected.on_processor(state);
        for (by, [indirect, picture]) in
            [("processor", &on_processor), ("adapter", &expected.on_adapter(state))]
        {
            let found = [
                ("E_ind", of_indirect(&drawn.indirect, indirect), INDIRECT_OUTLIERS),
                ("picture", of_picture(&drawn.radiance, picture), PICTURE_OUTLIERS),
            ];
            for (what, difference, outliers) in found {
                let text = format!("{}, {by}: {what}: {difference}", state.name);
                println!("{text}");
                if !difference.agrees(outliers) {
                    wrong.push(text);
                }
            }
        }
        screens_agree(expected, state, &drawn);
        wrong_light_is_seen(&drawn, &on_processor);
        if !state.materials.is_empty() {
            let [indirect, picture] = baked.on_processor(state);
            assert!(!of_indirect(&drawn.indirect, &indirect).agrees(INDIRECT_OUTLIERS));
            assert!(!of_picture(&drawn.radiance, &picture).agrees(PICTURE_OUTLIERS));
        }
        if let Some([turn_deg, strength]) = state.sky {
            let turned = State { sky: Some([turn_deg + 60.0, strength]), ..state.clone() };
            let [indirect, picture] = expected.on_processor(&turned);
            assert!(!of_indirect(&drawn.indirect, &indirect).agrees(INDIRECT_OUTLIERS));
            // The eye of a bake may see none of the sky.
            let sees_sky = sky_camera.is_some();
            assert!(!sees_sky || !of_picture(&drawn.radiance, &picture).agrees(PICTURE_OUTLIERS));
        }
        if state.lod.is_some() {
            let [indirect, _] = expected.on_processor(&State { lod: None, ..state.clone() });
            assert!(!of_indirect(&drawn.indirect, &indirect).agrees(INDIRECT_OUTLIERS));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

fn of_indirect(got: &[Vec4], wanted: &[Vec4]) -> Difference {
    Difference::of(got, wanted, INDIRECT_TOLERANCE)
}

fn of_picture(got: &[Vec4], wanted: &[Vec4]) -> Difference {
    Difference::of_mean(got, wanted, shade::TOLERANCE)
}

/// Exposure and tone mapping are Rust's, of the browser's own radiance and of many samples.
fn screens_agree(expected: &Expected, state: &State, drawn: &Drawn) {
    let (name, exposure) = (state.name, automatic_exposure(&drawn.radiance));
    assert!((drawn.exposure / exposure - 1.0).abs() < 1e-3, "{name}: {} for {exposure}", drawn.exposure);
    let [one, many] = &drawn.screens;
    let steps = expected::on_screen(&drawn.radiance, drawn.exposure);
    assert_eq!(differing(one, &steps, SCREEN_STEPS), 0.0, "{name}");
    let wanted = expected.on_screen_of_processor(state, drawn.exposure, SAMPLES);
    let share = differing(many, &wanted, SMOOTH_STEPS);
    println!("{name}: {share} of the screen's channels differ");
    assert!(share <= PICTURE_OUTLIERS, "{name}: {share}");
    assert!(differing(one, &wanted, 0) > 0.0, "{name}: one sample is as smooth as many");
}

/// Share of channels that differ by more than so many steps; all, where there are not as many.
fn differing(got: &[u8], wanted: &[u8], steps: u8) -> f32 {
    let pairs = got.iter().zip(wanted);
    let count = pairs.filter(|(got, wanted)| got.abs_diff(**wanted) > steps).count();
    if got.is_empty() || got.len() != wanted.len() { 1.0 } else { count as f32 / got.len() as f32 }
}

/// The comparisons fail for light of another colour, and where a hundredth of E_ind or a tenth of the picture is lost.
fn wrong_light_is_seen(drawn: &Drawn, [indirect, picture]: &[Vec<Vec4>; 2]) {
    let swapped = |of: &[Vec4]| -> Vec<Vec4> { of.iter().map(|v| Vec4::new(v.z, v.y, v.x, v.w)).collect() };
    let dimmed = |of: &[Vec4], by: f32| -> Vec<Vec4> { of.iter().map(|light| *light * by).collect() };
    for wrong in [swapped(indirect), dimmed(indirect, 0.99)] {
        assert!(!of_indirect(&drawn.indirect, &wrong).agrees(INDIRECT_OUTLIERS));
    }
    for wrong in [swapped(picture), dimmed(picture, 0.9)] {
        assert!(!of_picture(&drawn.radiance, &wrong).agrees(PICTURE_OUTLIERS));
    }
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_draws_cornell_as_the_references_do() {
    // From here the sky is seen beside the box.
    let beside = "eye=0.9,1.2,1.9 target=-0.2,1.2,-0.5 fov=110";
    browser_agrees(&Bundle::cornell(), &of_cornell(), Some(beside));
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_draws_glass_textures_and_near_hits_as_the_references_do() {
    browser_agrees(&Bundle::flat(), &of_flat(), None);
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_refines_the_light_of_the_overview_until_it_is_that_of_the_whole() {
    let bundle = Bundle::flat();
    // Colours stay while light comes.
    let mut states = states(&of_flat()).into_iter();
    let painted = states.find(|state| state.name == PAINTED).expect("a state of other colours");
    let (_files, browser) = opened(&bundle);
    let told = browser.run(MODULE, "refine", json!([job(std::slice::from_ref(&painted)), 3]));
    assert_eq!(told["errors"], json!([]));
    let found = told["found"].as_array().expect("a list");
    assert!(found.len() >= 3, "{} steps", found.len());
    let first = vectors(&found[0]["indirect"]);
    let [baked, colours] =
        [&[], &painted.materials[..]].map(|colours| Expected::new(bundle.folder(), colours));
    let difference = of_indirect(&first, &colours.of_overview(&painted));
    println!("overview: E_ind: {difference}");
    assert!(difference.agrees(INDIRECT_OUTLIERS), "{difference}");
    assert!(!of_indirect(&first, &baked.of_overview(&painted)).agrees(INDIRECT_OUTLIERS));
    let whole = vectors(&told["whole"]);
    assert_ne!(first.len(), whole.len(), "the overview is not the whole");
    assert_eq!(vectors(&found[found.len() - 1]["indirect"]), whole);
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_splits_arrays_into_bindings_and_says_where_it_cannot() {
    let bundle = Bundle::flat();
    let (states, (_files, browser)) = (states(&[]), opened(&bundle));
    let told = browser.run(MODULE, "narrow", json!([job(&states)]));
    assert_eq!(told["errors"], json!([]));
    let pages: Vec<u64> = serde_json::from_value(told["pages"].clone()).expect("numbers");
    println!("pages of points, near hits, ΣVᵀ, U: {pages:?}");
    assert!(pages[..2].iter().all(|count| *count > 1), "next to nothing was split: {pages:?}");
    let [whole, narrow] = [0, 1].map(|at| vectors(&told["found"][at]));
    assert!(whole.iter().any(|light| light.x > 0.0) && whole == narrow);
    let refusal = told["refusal"].as_str().expect("an error");
    assert!(refusal.contains("too large"), "{refusal}");
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_keeps_light_and_picture_where_the_device_refuses_others() {
    let bundle = Bundle::flat();
    let (states, (_files, browser)) = (states(&[]), opened(&bundle));
    let told = browser.run(MODULE, "keep", json!([job(&states)]));
    assert_eq!(told["errors"], json!([]));
    for refused in told["refused"].as_array().expect("a list") {
        assert!(refused.as_str().is_some_and(|words| words.contains("refuses")), "{refused}");
    }
    let found = told["found"].as_array().expect("a list");
    assert!(vectors(&found[0]["indirect"]).iter().any(|light| light.x > 0.0));
    for name in ["size", "buffers", "indirect", "radiance"] {
        let is_kept = found.iter().all(|later| later[name] == found[0][name]);
        assert!(is_kept, "{name} is another after a refusal, or after two calls at once");
    }
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_refuses_colours_that_cannot_be_in_the_words_of_the_native_client() {
    let bundle = Bundle::flat();
    let (_files, browser) = opened(&bundle);
    let refused = [
        colour("no such", [0.5; 3]),
        colour("floor", [1.5, 0.0, 0.0]),
        colour("floor", [0.5, -0.1, 0.0]),
        colour("glass", [0.5; 3]),
    ];
    let expected = Expected::new(bundle.folder(), &[]);
    let wanted: Vec<String> =
        refused.iter().map(|colour| expected.refusal(std::slice::from_ref(colour))).collect();
    let lists: Vec<_> = refused
        .iter()
        .map(
            |Recolour { material, base_colour }| json!([{ "material": material, "baseColour": base_colour }]),
        )
        .collect();
    let told = browser.run(MODULE, "refuse", json!([job(&states(&[])), lists]));
    assert_eq!(told, json!({ "messages": wanted, "settled": true, "errors": [] }));
}
