//! An object of the rarer parts of glTF: buffers and an image in data URIs, interleaved and sparse accessors, fans, indexed strips,
//! quantised and morphed normals, mirrored nodes, glass by a texture, a normal map, rough metal, steps and splines.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use serde_json::{Value, json};

use super::toy::{Channel, Document, animated};

const INTEGERS: u32 = 5125;
const SIGNED_BYTES: u32 = 5120;
const SHORTS: u32 = 5123;
const FLOATS: u32 = 5126;

/// The object, of some 0.5 m, standing on the plane y = 0; with images, or with materials alone.
pub fn rare(has_images: bool) -> Document {
    let mut rare = Document::new();
    rare.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    if has_images {
        let uri = |png: &[u8]| format!("data:image/png;base64,{}", STANDARD.encode(png));
        let colours = uri(&png(|x, y| [36 * x, 255 - 30 * y, 90, 255]));
        // Of transmission red alone counts, also where nothing else is to be seen of a file. Its padding is left out.
        let reds = uri(&png(|x, _| [36 * x, 0, 0, 0]));
        let numbers = uri(&png(|x, y| [100 + 8 * x, 156 - 8 * y, 240 - 10 * x, 255]));
        let all = [colours.as_str(), reds.trim_end_matches('='), &numbers];
        rare.json["images"] = json!(all.map(|uri| json!({ "uri": uri })));
        rare.json["textures"] = json!([{ "source": 0 }, { "source": 1 }, { "source": 2 }]);
    }
    let texture = |index: usize| has_images.then(|| json!({ "index": index }));
    let moved = json!({ "KHR_texture_transform": { "scale": [2.0, 1.5], "rotation": 0.4 } });
    let bumps = has_images.then(|| json!({ "index": 2, "scale": 0.8, "extensions": moved }));
    let plate_of = json!({
        "baseColorTexture": texture(0), "metallicRoughnessTexture": texture(2),
        "metallicFactor": 0.7, "roughnessFactor": 0.8,
    });
    let transmission = json!({ "transmissionFactor": 0.9, "transmissionTexture": texture(1) });
    rare.json["materials"] = json!([
        { "name": "plate", "doubleSided": true, "normalTexture": bumps, "pbrMetallicRoughness": plate_of },
        { "name": "ribbon", "doubleSided": true, "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.3, 0.2, 1.0] } },
        {
            "name": "pane", "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorFactor": [0.7, 0.8, 0.9, 1.0], "metallicFactor": 0.0 },
            "extensions": { "KHR_materials_transmission": transmission },
        },
    ]);
    rare.json["nodes"] = json!([
        { "name": "stand", "children": [1, 2], "scale": [1.0, -1.0, 1.0], "translation": [0.0, 0.25, 0.0] },
        { "name": "plate", "mesh": 0, "translation": [0.0, 0.1, 0.0] },
        { "name": "ribbon", "mesh": 1, "translation": [0.05, 0.0, 0.1] },
        { "name": "pane", "mesh": 2, "scale": [-0.4, -0.4, -0.4], "translation": [0.2, 0.45, 0.2] },
    ]);
    rare.json["scenes"] = json!([{ "nodes": [0, 3] }]);
    let meshes = [plate(&mut rare), ribbon(&mut rare), pane(&mut rare)];
    rare.json["meshes"] = json!(meshes);
    let turn = [
        [[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.9, 0.2, 0.0]],
        [[0.1, 0.3, 0.0, 0.0], [0.2, 0.7, 0.1, 0.6], [0.0; 4]],
    ];
    let weights = [[0.0, 0.0, 0.1, 0.9, 0.8, 0.2], [0.1, 0.3, 0.9, 0.2, 0.0, 0.0]];
    let all: [Channel; 4] = [
        (1, "rotation", "CUBICSPLINE", "VEC4", &[0.0, 2.5], turn.as_flattened().as_flattened()),
        (
            1,
            "translation",
            "STEP",
            "VEC3",
            &[0.3, 0.9, 1.6],
            &[0.0, 0.1, 0.0, 0.1, 0.15, -0.1, -0.1, 0.1, 0.1],
        ),
        (2, "weights", "CUBICSPLINE", "SCALAR", &[0.2, 1.8], weights.as_flattened()),
        (3, "rotation", "STEP", "VEC4", &[0.0, 1.1], &[0.0, 0.0, 0.0, 1.0, 0.0, 0.38, 0.0, 0.92]),
    ];
    let sizes: [f32; 18] =
        [0.0, 0.0, 0.0, -0.4, -0.4, -0.4, 0.3, 0.0, -0.2, 0.1, 0.0, 0.0, -0.2, -0.5, 0.3, 0.0, 0.0, 0.0];
    let other: [Channel; 1] = [(3, "scale", "CUBICSPLINE", "VEC3", &[0.0, 3.0], &sizes)];
    animated(&mut rare, &[&all[..], &other[..]]);
    rare
}

/// A PNG of 8 × 8 texels with alpha.
fn png(texel: impl Fn(u8, u8) -> [u8; 4]) -> Vec<u8> {
    let texels: Vec<u8> = (0..64).flat_map(|at| texel(at % 8, at / 8)).collect();
    let mut png = Vec::new();
    PngEncoder::new(&mut png).write_image(&texels, 8, 8, ExtendedColorType::Rgba8).unwrap();
    png
}

/// A buffer under a URI, and a view of all of it.
fn view_of_uri(rare: &mut Document, uri: String, bytes: usize, more: &[(&str, Value)]) -> usize {
    let buffer = rare.push("buffers", json!({ "byteLength": bytes, "uri": uri }));
    let mut view = json!({ "buffer": buffer, "byteLength": bytes });
    more.iter().for_each(|(name, value)| view[*name] = value.clone());
    rare.push("bufferViews", view)
}

fn bytes_of(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// A fan of six corners, whose places, normals and texture coordinates stand beside each other.
fn plate(rare: &mut Document) -> Value {
    let corner = |at: u16| {
        let (sin, cos) = (f32::from(at) * 1.1).sin_cos();
        let normal = glam::Vec3::new(0.2 * sin, 0.1, 1.0).normalize().to_array();
        let place = [0.2 * cos, 0.12 * sin, 0.02 * f32::from(at)];
        [&place[..], &normal, &[0.5 + 0.5 * cos, 0.5 + 0.5 * sin]].concat()
    };
    let bytes = bytes_of(&(0..6).flat_map(corner).collect::<Vec<f32>>());
    let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&bytes));
    let view = view_of_uri(rare, uri, bytes.len(), &[("byteStride", json!(32))]);
    let mut part = |kind: &str, offset: usize| {
        let accessor = json!({ "bufferView": view, "byteOffset": offset, "componentType": FLOATS, "count": 6, "type": kind });
        rare.push("accessors", accessor)
    };
    let attributes =
        json!({ "POSITION": part("VEC3", 0), "NORMAL": part("VEC3", 12), "TEXCOORD_0": part("VEC2", 24) });
    json!({ "primitives": [{ "attributes": attributes, "mode": 6, "material": 0 }] })
}

/// An indexed strip: its places are zero but for sparse ones, its normals of a byte each, and two targets move both.
fn ribbon(rare: &mut Document) -> Value {
    let places: Vec<f32> = (1..8_u16)
        .flat_map(|at| [0.12 * f32::from(at % 2), 0.06 * f32::from(at), 0.01 * f32::from(at)])
        .collect();
    let places = sparse(rare, 8, &(1..8).collect::<Vec<u8>>(), &places);
    let normals: Vec<u8> = (0..8_i8).flat_map(|at| [10 * at, -20, 120, 0].map(|part| part as u8)).collect();
    let normals = {
        let view = rare.view(&normals);
        rare.json["bufferViews"][view]["byteStride"] = json!(4);
        let accessor = json!({
            "bufferView": view, "componentType": SIGNED_BYTES, "count": 8, "type": "VEC3", "normalized": true,
        });
        rare.push("accessors", accessor)
    };
    // Of bytes that are no text each is escaped.
    let indices: Vec<u8> =
        [0_u32, 1, 2, 3, 4, 5, 5, 6, 6, 7].iter().flat_map(|index| index.to_le_bytes()).collect();
    let moved: Vec<u8> = bytes_of(&(0..24).map(|at| 0.01 * (at % 5) as f32 - 0.02).collect::<Vec<f32>>());
    let bytes = [&indices[..], &moved].concat();
    let escaped: String = bytes.iter().map(|byte| format!("%{byte:02X}")).collect();
    let view = view_of_uri(rare, format!("data:application/octet-stream,{escaped}"), bytes.len(), &[]);
    let mut part = |kind: &str, component: u32, offset: usize, count: usize| {
        let accessor = json!({
            "bufferView": view, "byteOffset": offset, "componentType": component, "count": count, "type": kind,
        });
        rare.push("accessors", accessor)
    };
    let indices = part("SCALAR", INTEGERS, 0, 10);
    let moved = part("VEC3", FLOATS, 40, 8);
    let first_normals =
        rare.floats("VEC3", &(0..24).map(|at| 0.3 * (at % 3) as f32 - 0.2).collect::<Vec<f32>>());
    let places_of_second = sparse(rare, 8, &[2, 7], &[0.0, 0.1, 0.05, 0.1, 0.0, -0.05]);
    let normals_of_second = sparse(rare, 8, &[0, 5], &[0.5, 0.5, -0.4, -0.6, 0.1, 0.0]);
    json!({
        "weights": [0.3, 0.6],
        "primitives": [{
            "attributes": { "POSITION": places, "NORMAL": normals }, "indices": indices, "mode": 5, "material": 1,
            "targets": [
                { "POSITION": moved, "NORMAL": first_normals },
                { "POSITION": places_of_second, "NORMAL": normals_of_second },
            ],
        }],
    })
}

/// An accessor of vectors that are zero but for some.
fn sparse(rare: &mut Document, count: usize, places: &[u8], values: &[f32]) -> usize {
    let (indices, values) = (rare.view(places), rare.view(&bytes_of(values)));
    let sparse = json!({
        "count": places.len(),
        "indices": { "bufferView": indices, "componentType": 5121 },
        "values": { "bufferView": values },
    });
    rare.push(
        "accessors",
        json!({ "componentType": FLOATS, "count": count, "type": "VEC3", "sparse": sparse }),
    )
}

/// A square of glass, quantised: places of whole numbers are fractions.
fn pane(rare: &mut Document) -> Value {
    let bytes: Vec<u8> = [[0_u16, 0], [65535, 0], [65535, 65535], [0, 65535]]
        .iter()
        .flat_map(|[x, y]| [*x, *y, 20_000, 0])
        .flat_map(u16::to_le_bytes)
        .collect();
    let view = rare.view(&bytes);
    rare.json["bufferViews"][view]["byteStride"] = json!(8);
    let places = rare.push(
        "accessors",
        json!({ "bufferView": view, "componentType": SHORTS, "count": 4, "type": "VEC3", "normalized": true }),
    );
    let normals = rare.floats("VEC3", &[0.0, 0.0, 1.0].repeat(4));
    let uvs = rare.floats("VEC2", &[0.05, 0.0, 0.95, 0.0, 0.95, 1.0, 0.05, 1.0]);
    let indices = rare.accessor("SCALAR", SHORTS, &[0_u16, 1, 2, 0, 2, 3].map(u16::to_le_bytes).concat());
    let attributes = json!({ "POSITION": places, "NORMAL": normals, "TEXCOORD_0": uvs });
    json!({ "primitives": [{ "attributes": attributes, "indices": indices, "material": 2 }] })
}
