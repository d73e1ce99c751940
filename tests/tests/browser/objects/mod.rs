//! Objects in the browser: files are read as the native client reads them at every time, and light and pictures with them are the native
//! ones.

pub mod toy;

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
use lightkiln_worker::scene::{Bundle as Upload, Limits};
use serde_json::{Value, json};

use super::bundle::Bundle;
use super::files::Answer;
use super::mutations::Mutator;
use super::{browser_at, bundle_opened, bytes_of_hex, served};
use toy::{Document, toy};

const MODULE: &str = "/pages/objects.js";
/// Animations and times in seconds: before, at, between and behind keys.
const TIMES: [(u32, f32); 9] =
    [(0, 0.0), (0, 0.5), (0, 0.7), (0, 1.0), (0, 1.4), (0, 9.0), (1, 0.0), (1, 1.3), (1, 3.0)];
/// Largest difference of places in metres, and of parts of unit normals: sums in f64 of factors that are rounded to f32.
const PLACES_TOLERANCE: f32 = 2e-6;
/// Those of the browser's comparisons of light and pictures, see `relighting`.
const INDIRECT_TOLERANCE: f32 = 2e-3;
const INDIRECT_OUTLIERS: f32 = 2e-3;
const PICTURE_OUTLIERS: f32 = 3.0 * shade::OUTLIERS;
const SIZE: [u32; 2] = [192, 128];
const ROOM: ShadowRoom = ShadowRoom { lights: 4, faces: 20, side: 512 };
const LIMIT: Limit = Limit { bounces_max: 256, change_max: 1e-5 };
const CAMERA: &str = "eye=0,1,3.2 target=0,0.8,0 fov=45";
/// Mutated files.
const MUTATIONS: u64 = 3000;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn floats(hex: &Value) -> Vec<f32> {
    let number = |four: &[u8]| f32::from_le_bytes(four.try_into().unwrap());
    bytes_of_hex(hex).chunks_exact(4).map(number).collect()
}

fn opened(file: &[u8]) -> Result<ObjectFile, String> {
    let upload = Upload::from_bytes(file.to_vec(), &Limits::default());
    upload.and_then(ObjectFile::open).map(|(object, _)| object).map_err(|error| error.to_string())
}

/// Corners of a draw's triangles as the page tells them.
fn corners(draw: &Draw) -> Vec<f32> {
    let corner = |vertex: &u32| {
        let vertex = *vertex as usize;
        let uv = draw.uv.get(vertex).copied().unwrap_or_default();
        let colour = draw.colour.get(vertex).copied().unwrap_or([1.0; 4]);
        [&draw.position_m[vertex][..], &draw.normal[vertex], &uv, &colour].concat()
    };
    draw.triangles.as_flattened().iter().flat_map(corner).collect()
}

/// Largest difference of what the page and the native client draw; infinite where it is of another shape.
fn difference(told: &Value, wanted: &[Draw]) -> f32 {
    let Some(told) = told.as_array().filter(|told| told.len() == wanted.len()) else { return f32::INFINITY };
    let of_draw = |(told, wanted): (&Value, &Draw)| {
        let (got, wanted_ones) = (floats(&told["corners"]), corners(wanted));
        if told["material"] != wanted.material || got.len() != wanted_ones.len() {
            return f32::INFINITY;
        }
        let apart = got.iter().zip(&wanted_ones).map(|(a, b)| (a - b).abs() / (1.0 + b.abs()));
        apart.fold(0.0, f32::max)
    };
    told.iter().zip(wanted).map(of_draw).fold(0.0, f32::max)
}

/// Members of JSON that is none are left out, and names in `snake_case`.
fn plain(json: &Value) -> Value {
    let snake = |name: &str| {
        let parts = name.chars().map(|letter| match letter {
            upper if upper.is_ascii_uppercase() => format!("_{}", upper.to_ascii_lowercase()),
            other => other.to_string(),
        });
        parts.collect::<String>()
    };
    match json {
        Value::Object(members) => members
            .iter()
            .filter(|(_, value)| !value.is_null())
            .map(|(name, value)| (snake(name), plain(value)))
            .collect(),
        Value::Array(values) => values.iter().map(plain).collect(),
        Value::Number(number) => json!(number.as_f64().map(|number| f64::from(number as f32))),
        other => other.clone(),
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_reads_objects_at_every_time_as_the_native_client_does() {
    let files = [toy(Some(&tiles(16, [200; 3], [20; 3], [90; 3])), 0.5).glb(), toy(None, 1.0).glb()];
    let server = served(|_| None);
    let sent: Vec<String> = files.iter().map(|file| hex(file)).collect();
    let told = browser_at(&server).run(MODULE, "read", json!([sent, TIMES]));
    for (file, told) in files.iter().zip(told.as_array().unwrap()) {
        assert!(told["draws"].is_array(), "{told}");
        let object = opened(file).unwrap();
        assert_eq!(plain(&told["lengthsS"]), plain(&json!(object.lengths_s())));
        assert_eq!(told["textures"], object.images().len());
        assert_eq!(plain(&told["materials"]), plain(&serde_json::to_value(object.materials()).unwrap()));
        for (at, (clip, time_s)) in TIMES.iter().enumerate() {
            let draws = object.draws(Some(*clip as usize), *time_s).unwrap();
            assert!(draws.len() == 3 && draws.iter().all(|draw| !draw.triangles.is_empty()));
            let apart = difference(&told["draws"][at], &draws);
            println!("animation {clip} at {time_s} s: {apart}");
            assert!(apart < PLACES_TOLERANCE, "animation {clip} at {time_s} s: {apart}");
            // Another time, or rest, is seen, but where the last key holds.
            let other = object.draws(Some(*clip as usize), time_s + 0.05).unwrap();
            let holds = *time_s >= object.lengths_s()[*clip as usize];
            assert!(holds || difference(&told["draws"][at], &other) > 1e-3);
            let rest = object.draws(None, 0.0).unwrap();
            assert!(*time_s == 0.0 || difference(&told["draws"][at], &rest) > 1e-3);
        }
    }
}

/// Files that lie, with a word of their refusal.
fn lying() -> Vec<(Vec<u8>, &'static str)> {
    let change = |change: &dyn Fn(&mut Document)| {
        let mut document = toy(None, 1.0);
        change(&mut document);
        document.glb()
    };
    let set = |path: &'static str, value: Value| {
        change(&|document| *document.json.pointer_mut(path).unwrap() = value.clone())
    };
    let good = toy(None, 1.0).glb();
    let with = |at: usize, bytes: &[u8]| {
        let mut file = good.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    };
    vec![
        (with(4, &[1, 0, 0, 0]), "version"),
        (with(8, &[255; 4]), "states"),
        (with(12, &[255; 4]), "chunk states"),
        (with(16, b"BIN\0"), "not JSON"),
        (good[..11].to_vec(), "header"),
        (b"no glTF".to_vec(), "no .glb"),
        (b"{}".to_vec(), "not glTF"),
        (set("/asset/version", json!("1.0")), "version"),
        (set("/asset", json!({ "version": "2.0", "minVersion": "3.0" })), "version"),
        (
            change(&|of| of.json["extensionsRequired"] = json!(["EXT_meshopt_compression", "KHR_no"])),
            "gltf-transform",
        ),
        (set("/buffers/0/byteLength", json!(99_999_999)), "states"),
        (
            change(&|of| of.json["buffers"] = json!([{ "byteLength": 9, "uri": "far.bin" }])),
            "not in the file",
        ),
        (set("/bufferViews/0/byteLength", json!(9_007_199_254_740_991_u64)), "spans"),
        (set("/bufferViews/0/buffer", json!(7)), "names buffer 7"),
        (set("/accessors/0/count", json!(4_000_000_000_u64)), "do not fit"),
        (set("/accessors/0/type", json!("VEC9")), "not one of glTF's"),
        (set("/accessors/0/type", json!("VEC2")), "do not fit here"),
        (set("/accessors/0/bufferView", json!(999)), "names buffer view 999"),
        (
            change(&|of| {
                of.json["accessors"][0] =
                    json!({ "componentType": 5126, "count": 9_000_000, "type": "VEC3" });
            }),
            "without bytes",
        ),
        (set("/meshes/0/primitives/0/indices", json!(0)), "do not fit here"),
        (change(&|of| of.json["meshes"][0]["primitives"][0]["mode"] = json!(9)), "mode"),
        (set("/meshes/0/primitives/0/material", json!(3)), "names material 3"),
        (set("/meshes/2/primitives/0/attributes/JOINTS_0", json!(999)), "names accessor 999"),
        (set("/nodes/0/mesh", json!(9)), "names mesh 9"),
        (set("/nodes/0/children", json!([1, 9])), "names node 9"),
        (set("/nodes/1", json!({ "mesh": 1, "children": [0] })), "reached twice"),
        (set("/nodes/0/children", json!([1, 1])), "reached twice"),
        (change(&|of| of.json["nodes"][2]["translation"] = json!([1e39, 0, 0])), "not finite"),
        (set("/skins/0/joints", json!([2, 9])), "names node 9"),
        (set("/skins/0/joints", json!([2])), "names joint 1"),
        (set("/scenes/0/nodes", json!([])), "no triangles"),
        (
            change(&|of| {
                of.json["nodes"] = (0..300).map(|at| json!({ "children": [at + 1] })).collect();
                of.json["nodes"][299] = json!({ "mesh": 0 });
                of.json["scenes"] = json!([{ "nodes": [0] }]);
                of.json["animations"] = json!([]);
                of.json["skins"] = json!([]);
            }),
            "levels of nodes",
        ),
    ]
}

#[test]
#[ignore = "needs chromium"]
fn chromium_refuses_files_that_lie_and_says_where() {
    let lying = lying();
    let server = served(|_| None);
    let sent: Vec<String> = lying.iter().map(|(file, _)| hex(file)).collect();
    let told = browser_at(&server).run(MODULE, "read", json!([sent, [(0, 0.0)]]));
    for ((file, words), told) in lying.iter().zip(told.as_array().unwrap()) {
        let native =
            opened(file).and_then(|file| file.draws(Some(0), 0.0).map_err(|error| error.to_string()));
        let nothing = native.as_ref().is_ok_and(Vec::is_empty);
        assert!(native.is_err() || nothing, "the native client takes what lies about '{words}'");
        // A file of nothing is no fault of its own: who adds it is told.
        let is_told = told["error"].as_str().is_some_and(|error| error.contains(words));
        let is_empty = nothing && told["draws"] == json!([[]]);
        assert!(is_told || is_empty, "'{words}' is wanted: {told}; natively {native:?}");
    }
}

#[test]
#[ignore = "needs chromium"]
fn chromium_survives_truncated_and_mutated_objects_and_reads_none_that_the_native_client_refuses() {
    let good = toy(None, 1.0).glb();
    let mut files: Vec<Vec<u8>> = (0..good.len()).step_by(7).map(|length| good[..length].to_vec()).collect();
    files.extend((0..MUTATIONS).map(|seed| Mutator::new(seed).mutated(std::slice::from_ref(&good))));
    files.push(good);
    let together: Vec<u8> = files
        .iter()
        .flat_map(|file| (file.len() as u32).to_le_bytes().into_iter().chain(file.iter().copied()))
        .collect();
    let server = served(move |request| (request.path == "/files").then(|| Answer::of(together.clone())));
    let found = browser_at(&server).run(MODULE, "readAll", json!(["/files", [(0, 0.7)]]));
    let told = found["told"].as_array().unwrap();
    assert_eq!(told.len(), files.len());
    let mut faults = Vec::new();
    let [mut both, mut refused, mut looser] = [0, 0, 0];
    for (at, (file, told)) in files.iter().zip(told).enumerate() {
        let clip = |object: &ObjectFile| (!object.lengths_s().is_empty()).then_some(0);
        let native = opened(file).and_then(|object| {
            let draws = object.draws(clip(&object), 0.7).map_err(|error| error.to_string())?;
            Ok((draws, object.lengths_s().iter().any(|length| *length > 0.0)))
        });
        match (native, &told["error"], &told["draws"]) {
            (Ok((draws, _)), Value::Null, Value::Array(own))
                if difference(&own[0], &draws) < PLACES_TOLERANCE =>
            {
                both += 1;
            }
            (Err(_), Value::String(_), _) => refused += 1,
            // Of JSON with any member that its typed reader refuses, the native client reads all but the animations.
            (Ok((_, false)), ..) => looser += 1,
            // It also refuses members that have another type and are never read.
            (Err(error), Value::Null, Value::Array(_)) if error.contains("is not glTF 2.0") => looser += 1,
            (native, error, _) => {
                let native = native.map(|(draws, _)| difference(&told["draws"][0], &draws));
                faults.push(format!("{at}: natively {native:?}; {error} {}", told["thrown"]));
            }
        }
    }
    let thrown = told.iter().filter(|told| !told["thrown"].is_null()).count();
    println!(
        "{both} taken by both, {refused} refused by both, {looser} else, the longest took {} ms",
        found["longestMs"]
    );
    assert_eq!(thrown, 0, "{faults:#?}");
    assert!(both > 100 && refused > 1000 && looser < 40, "{both} taken, {refused} refused, {looser} else");
    assert!(faults.is_empty(), "{} faults: {:#?}", faults.len(), &faults[..faults.len().min(20)]);
}

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
    Stance { position_m, turn_deg, scale, clip, time_s }
}

/// A lamp, a spot and a sun in turn, with two toys that go about, one of which comes to rest.
fn states() -> Vec<State> {
    let lamp = "point pos=0.1,1.5,0.6 color=1,0.9,0.7 power=60";
    vec![
        State {
            light: lamp,
            stances: vec![
                stance([-0.3, 0.6, 0.5], [30.0, 10.0, 0.0], 1.4, (0, 1.2)),
                stance([0.4, 0.0, 0.8], [200.0, 0.0, 0.0], 1.0, (1, 2.0)),
            ],
        },
        State { light: lamp, stances: vec![stance([0.2, 0.9, 0.3], [75.0, 0.0, 20.0], 1.0, (0, 0.7))] },
        State {
            light: "spot pos=0.3,1.9,0.8 target=0,0.3,0 outer=38 color=0.6,0.8,1 power=90",
            stances: vec![
                stance([0.1, 0.8, 0.4], [15.0, 0.0, 0.0], 1.2, (0, 1.7)),
                stance([-0.5, 0.2, 0.6], [0.0; 3], 1.0, (1, 1.0)),
            ],
        },
        State {
            light: "sun dir=0.15,-0.5,-0.85 color=1,0.9,0.8 irradiance=8",
            stances: vec![
                stance([0.0, 0.7, 0.7], [0.0, 0.0, 45.0], 1.3, (0, 0.4)),
                stance([0.3, 0.1, 1.6], [0.0; 3], 1.0, (1, 0.0)),
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

/// Draws a bake with two toys, of which one has a vane of this alpha, and holds light and pictures against the native ones.
fn browser_agrees(bundle: &Bundle, alpha: f32) {
    let image = tiles(16, [220, 120, 90], [40, 60, 120], [240; 3]);
    let files = [toy(Some(&image), alpha).glb(), toy(None, 1.0).glb()];
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
        assert!(
            !agrees("picture", &radiance, &native.picture(&later, Backend::Cpu)),
            "state {at}: times are one"
        );
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
    browser_agrees(&Bundle::cornell(), 1.0);
}

#[test]
#[ignore = "needs chromium and a graphics adapter"]
fn chromium_draws_the_first_glass_that_an_object_brings_as_the_native_client_does() {
    browser_agrees(&Bundle::cornell(), 0.4);
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
