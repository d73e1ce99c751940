//! Files: the same meshes at every time, and the same refusals.

use lightkiln_proto::content::Draw;
use lightkiln_tests::scenes::texture::tiles;
use lightkiln_worker::objects::ObjectFile;
use serde_json::{Value, json};

use super::packed::{FILTERED_TOLERANCE, packed};
use super::rare::rare;
use super::toy::{Document, toy};
use super::{MODULE, floats, hex, opened};
use crate::files::Answer;
use crate::mutations::Mutator;
use crate::{browser_at, served};

/// Animations and times in seconds: before, at, between and behind keys.
const TIMES: [(u32, f32); 9] =
    [(0, 0.0), (0, 0.5), (0, 0.7), (0, 1.0), (0, 1.4), (0, 9.0), (1, 0.0), (1, 1.3), (1, 3.0)];
/// Largest difference of places in metres, and of parts of unit normals: sums in f64 of factors that are rounded to f32.
const PLACES_TOLERANCE: f32 = 2e-6;
/// Mutated files.
const MUTATIONS: u64 = 3000;

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
pub fn difference(told: &Value, wanted: &[Draw]) -> f32 {
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
    let files = [
        toy(Some(&tiles(16, [200; 3], [20; 3], [90; 3])), 0.5).glb(),
        toy(None, 1.0).glb(),
        rare(true).glb(),
    ];
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
            change(&|of| of.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression", "KHR_no"])),
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
        (set("/accessors/0/type", json!("constructor")), "not one of glTF's"),
        (
            change(&|of| {
                of.json["accessors"][0] =
                    json!({ "componentType": "constructor", "count": 999, "type": "VEC3" });
            }),
            "not one of glTF's",
        ),
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
    let good = [
        (toy(None, 1.0).glb(), PLACES_TOLERANCE),
        (rare(false).glb(), PLACES_TOLERANCE),
        (packed().glb(), FILTERED_TOLERANCE),
    ];
    let mut files: Vec<(Vec<u8>, f32)> = good
        .iter()
        .flat_map(|(good, tolerance)| {
            (0..good.len()).step_by(7).map(|length| (good[..length].to_vec(), *tolerance))
        })
        .collect();
    files.extend((0..MUTATIONS).map(|seed| {
        let (good, tolerance) = &good[seed as usize % good.len()];
        (Mutator::new(seed).mutated(std::slice::from_ref(good)), *tolerance)
    }));
    files.extend(good);
    let together: Vec<u8> = files
        .iter()
        .flat_map(|(file, _)| (file.len() as u32).to_le_bytes().into_iter().chain(file.iter().copied()))
        .collect();
    let server = served(move |request| (request.path == "/files").then(|| Answer::of(together.clone())));
    let found = browser_at(&server).run(MODULE, "readAll", json!(["/files", [(0, 0.7)]]));
    let told = found["told"].as_array().unwrap();
    assert_eq!(told.len(), files.len());
    let mut faults = Vec::new();
    let [mut both, mut refused, mut looser] = [0, 0, 0];
    for (at, ((file, tolerance), told)) in files.iter().zip(told).enumerate() {
        let clip = |object: &ObjectFile| (!object.lengths_s().is_empty()).then_some(0);
        let native = opened(file).and_then(|object| {
            let draws = object.draws(clip(&object), 0.7).map_err(|error| error.to_string())?;
            Ok((draws, object.lengths_s().iter().any(|length| *length > 0.0)))
        });
        match (native, &told["error"], &told["draws"]) {
            (Ok((draws, _)), Value::Null, Value::Array(own)) if difference(&own[0], &draws) < *tolerance => {
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
