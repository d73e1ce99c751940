//! Light and pictures with objects, and refusals of frames.

use std::error::Error;
use std::sync::Arc;

use glam::Vec4;
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::lights::{parse_camera, parse_lights};
use lightkiln_client::passes::compare::Difference;
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shade;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::preview::{Backend, View, render};
use lightkiln_client::scene::{Object, ObjectShape, Stance, Texture};
use lightkiln_proto::content::Draw;
use lightkiln_proto::relight::Limit;
use lightkiln_tests::scenes::texture::tiles;
use lightkiln_worker::objects::ObjectFile;
use serde_json::{Value, json};

use super::rare::rare;
use super::toy::toy;
use super::{MODULE, floats, hex, opened};
use crate::bundle::Bundle;
use crate::bundle_opened;

/// Those of the browser's comparisons of light and pictures, see `relighting`.
const INDIRECT_TOLERANCE: f32 = 2e-3;
const INDIRECT_OUTLIERS: f32 = 2e-3;
const PICTURE_OUTLIERS: f32 = 3.0 * shade::OUTLIERS;
const SIZE: [u32; 2] = [192, 128];
const ROOM: ShadowRoom = ShadowRoom { lights: 4, faces: 20, side: 512 };
const LIMIT: Limit = Limit { bounces_max: 256, change_max: 1e-5 };
const CAMERA: &str = "eye=0.3,2.6,4.5 target=0,2.1,-2.5 fov=50";

/// An [`ObjectFile`] as the native client takes it.
#[derive(Debug)]
struct Shape(ObjectFile);

impl ObjectShape for Shape {
    fn draws(&self, clip: u32, time_s: f32) -> Result<Vec<Draw>, Box<dyn Error + Send + Sync>> {
        Ok(self.0.draws(Some(clip as usize), time_s)?)
    }
}

fn object(file: &[u8]) -> Object {
    let object = opened(file).unwrap();
    let textures = object.images().iter().map(|image| Texture::decode(&image.bytes).unwrap()).collect();
    let materials = object.materials();
    Object { name: "toy".to_owned(), materials, textures, shape: Arc::new(Shape(object)) }
}

/// A state of lights and objects.
struct State {
    light: &'static str,
    stances: Vec<Stance>,
}

fn stance(position_m: [f32; 3], turn_deg: [f32; 3], scale: f32, (clip, time_s): (u32, f32)) -> Stance {
    Stance { position_m, turn_deg, scale, clip, time_s, ..Stance::default() }
}

/// A lamp, a spot and a sun in turn, with two toys that go about in the box and before it, one of which comes to rest.
fn states() -> Vec<State> {
    let lamp = "point pos=0.3,4.4,-1.2 color=1,0.9,0.7 power=400";
    vec![
        State {
            light: lamp,
            stances: vec![
                stance([-0.9, 1.6, -1.5], [30.0, 10.0, 0.0], 3.5, (0, 1.2)),
                stance([1.0, 0.0, -0.9], [200.0, 0.0, 0.0], 2.5, (1, 2.0)),
            ],
        },
        State { light: lamp, stances: vec![stance([0.4, 2.2, -1.0], [75.0, 0.0, 20.0], 3.0, (0, 0.7))] },
        State {
            light: "spot pos=0.6,5,-1 target=0,0.5,-2 outer=38 color=0.6,0.8,1 power=600",
            stances: vec![
                stance([0.2, 2.0, -1.6], [15.0, 0.0, 0.0], 3.0, (0, 1.7)),
                stance([-1.2, 0.5, -1.0], [0.0; 3], 2.5, (1, 1.0)),
            ],
        },
        State {
            light: "sun dir=0.15,-0.5,-0.85 color=1,0.9,0.8 irradiance=8",
            stances: vec![
                stance([0.0, 1.8, -0.8], [0.0, 0.0, 45.0], 3.2, (0, 0.4)),
                stance([0.8, 0.2, 0.6], [0.0; 3], 2.5, (1, 0.0)),
            ],
        },
    ]
}

fn job(files: &[Vec<u8>], states: &[State]) -> Value {
    let stance = |of: &Stance| json!({ "positionM": of.position_m, "turnDeg": of.turn_deg, "scale": of.scale, "clip": of.clip, "timeS": of.time_s });
    let state = |of: &State| json!({ "lights": [of.light], "stances": of.stances.iter().map(stance).collect::<Vec<_>>() });
    json!({
        "files": files.iter().map(|file| hex(file)).collect::<Vec<_>>(),
        "size": SIZE,
        "camera": CAMERA,
        "emitters": 0.0,
        "limit": { "bouncesMax": LIMIT.bounces_max, "changeMax": LIMIT.change_max },
        "shadows": { "lights": ROOM.lights, "faces": ROOM.faces, "side": ROOM.side },
        "states": states.iter().map(state).collect::<Vec<_>>(),
    })
}

fn vectors(hex: &Value) -> Vec<Vec4> {
    floats(hex).chunks_exact(4).map(Vec4::from_slice).collect()
}

/// E_ind by the native frame on the adapter, and pictures by the processor and the adapter.
struct Native {
    bake: LoadedBake,
    gpu: Gpu,
}

impl Native {
    fn new(bundle: &Bundle, files: &[Vec<u8>]) -> Self {
        let source = Source::bundle(bundle.folder()).unwrap();
        let mut bake = LoadedBake::load(&source, &lightkiln_client::kinds::all()).unwrap();
        files.iter().for_each(|file| bake.add_object(object(file)).unwrap());
        Self { bake, gpu: Gpu::open().unwrap() }
    }

    fn emitters(&self) -> Vec<f32> {
        vec![0.0; self.bake.scene.manifest.emitters.len()]
    }

    fn indirect(&self, State { light, stances }: &State) -> Vec<Vec4> {
        let room = FrameRoom { size: SIZE, shadows: ROOM };
        let mut frame = Frame::new(&self.gpu, &self.bake, room, parse_camera(CAMERA).unwrap()).unwrap();
        frame.set_emitters(&self.emitters()).unwrap();
        frame.set_lights(&parse_lights(&[*light]).unwrap().lights).unwrap();
        frame.set_objects(stances).unwrap();
        assert!(frame.settle(LIMIT).unwrap().1);
        frame.read_receivers().unwrap().unwrap().indirect
    }

    fn picture(&self, State { light, stances }: &State, backend: Backend) -> Vec<Vec4> {
        let lights = parse_lights(&[*light]).unwrap().lights;
        let view = View {
            width: SIZE[0],
            height: SIZE[1],
            samples: 1,
            shadow_side: ROOM.side,
            limit: LIMIT,
            emitter_scale: self.emitters(),
            objects: stances.clone(),
            ..View::new(parse_camera(CAMERA).unwrap(), lights)
        };
        let picture = render(&self.bake, &view, backend).unwrap();
        picture.linear.iter().map(|[r, g, b]| Vec4::new(*r, *g, *b, 1.0)).collect()
    }
}

/// Two toys, of which the first has a vane of this alpha.
fn toys(alpha: f32) -> [Vec<u8>; 2] {
    let image = tiles(16, [220, 120, 90], [40, 60, 120], [240; 3]);
    [toy(Some(&image), alpha).glb(), toy(None, 1.0).glb()]
}

/// Draws a bake with two objects, and holds light and pictures against the native ones.
fn browser_agrees(bundle: &Bundle, files: [Vec<u8>; 2]) {
    let states = states();
    let (_files, browser) = bundle_opened(bundle, |_| None);
    let told = browser.run(MODULE, "draw", json!([job(&files, &states)]));
    assert_eq!(told["errors"], json!([]));
    assert_eq!(told["created"], json!(vec![0; states.len()]), "objects that move make nothing");
    let (native, bare) = (Native::new(bundle, &files), Native::new(bundle, &[]));
    let agrees = |what: &str, got: &[Vec4], wanted: &[Vec4]| {
        let (difference, outliers) = match what {
            "E_ind" => (Difference::of(got, wanted, INDIRECT_TOLERANCE), INDIRECT_OUTLIERS),
            _ => (Difference::of_mean(got, wanted, shade::TOLERANCE), PICTURE_OUTLIERS),
        };
        println!("{what}: {difference}");
        difference.agrees(outliers)
    };
    let mut wrong = Vec::new();
    for (at, (state, drawn)) in states.iter().zip(told["found"].as_array().unwrap()).enumerate() {
        assert_eq!(drawn["converged"], true);
        let [indirect, radiance] = ["indirect", "radiance"].map(|name| vectors(&drawn[name]));
        if !agrees("E_ind", &indirect, &native.indirect(state)) {
            wrong.push(format!("state {at}: E_ind"));
        }
        for backend in [Backend::Cpu, Backend::Gpu] {
            if !agrees("picture", &radiance, &native.picture(state, backend)) {
                wrong.push(format!("state {at}: picture of {backend:?}"));
            }
        }
        // The comparisons fail where the objects are not there, and where they stand elsewhere.
        let absent = State { light: state.light, stances: Vec::new() };
        assert!(!agrees("E_ind", &indirect, &bare.indirect(&absent)), "state {at}: no shadow bounces");
        assert!(
            !agrees("picture", &radiance, &bare.picture(&absent, Backend::Cpu)),
            "state {at}: none is seen"
        );
        let mut later = State { light: state.light, stances: state.stances.clone() };
        later.stances[0].time_s += 0.4;
        // A small part that moves shows in one of the two alone.
        let is_same = agrees("picture", &radiance, &native.picture(&later, Backend::Cpu))
            && agrees("E_ind", &indirect, &native.indirect(&later));
        assert!(!is_same, "state {at}: times are one");
    }
    let first = State { light: states[0].light, stances: Vec::new() };
    for without in told["without"].as_array().unwrap() {
        let [indirect, radiance] = ["indirect", "radiance"].map(|name| vectors(&without[name]));
        let is_bare = agrees("E_ind", &indirect, &bare.indirect(&first))
            && agrees("picture", &radiance, &bare.picture(&first, Backend::Cpu));
        assert!(is_bare, "without objects the bake is another");
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_draws_objects_in_cornell_as_the_native_client_does() {
    browser_agrees(&Bundle::cornell(), toys(1.0));
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_draws_the_first_glass_that_an_object_brings_as_the_native_client_does() {
    browser_agrees(&Bundle::cornell(), toys(0.4));
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_draws_an_object_of_rarer_parts_as_the_native_client_does() {
    browser_agrees(&Bundle::cornell(), [rare(true).glb(), toy(None, 1.0).glb()]);
}

#[test]
#[ignore = "needs chromium"]
fn chromium_ends_the_settling_of_light_while_an_object_plays() {
    let bundle = Bundle::cornell();
    let (_files, browser) = bundle_opened(&bundle, |_| None);
    let told = browser.run(MODULE, "play", json!([job(&[toy(None, 1.0).glb()], &states()), 100]));
    assert_eq!(told["errors"], json!([]));
    for call in ["settle", "setLight"] {
        assert!(told[call].as_u64().is_some_and(|bounces| (1..=40).contains(&bounces)), "{call}: {told}");
    }
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_keeps_the_picture_where_objects_and_stances_are_refused() {
    let bundle = Bundle::cornell();
    let image = tiles(16, [220, 120, 90], [40, 60, 120], [240; 3]);
    // Of a picture, its header alone is right.
    let broken = toy(Some(&image[..40]), 1.0).glb();
    let (_files, browser) = bundle_opened(&bundle, |_| None);
    let told =
        browser.run(MODULE, "refuse", json!([job(&[toy(Some(&image), 1.0).glb()], &states()), hex(&broken)]));
    assert_eq!(told["errors"], json!([]));
    let words = [
        "2 stances",
        "stance 1",
        "stance 1",
        "object 1 is to move",
        "animation 8",
        "too large",
        "vertex above 3",
        "material 1 of 1",
        "differ in length",
        "not finite",
        "names texture 0 of 0",
        "no triangles",
        "no picture",
        "too many",
    ];
    let messages = told["messages"].as_array().unwrap();
    assert_eq!(messages.len(), words.len());
    for (message, words) in messages.iter().zip(words) {
        assert!(message.as_str().is_some_and(|message| message.contains(words)), "'{words}': {message}");
    }
    let kept = &told["kept"];
    assert_eq!(kept["objects"], 1);
    let [before, after] = [0, 1].map(|at| vectors(&kept["radiance"][at]));
    let difference = Difference::of_mean(&after, &before, 2e-3);
    assert!(difference.agrees(0.0), "the picture is another after a refusal: {difference}");
    // An object that stays keeps its stance, and a new one stands at the origin.
    let stances = told["stances"].as_array().unwrap();
    assert_eq!((&stances[0]["timeS"], &stances[1]["positionM"]), (&json!(1.2_f32), &json!([0, 0, 0])));
}
