//! A toy of a glTF: nodes in a hierarchy, a mesh without normals under a mirrored node, morph targets, a skin, textures, animations.

use serde_json::{Value, json};

const BYTES: u32 = 5121;
const SHORTS: u32 = 5123;
const FLOATS: u32 = 5126;

/// A glTF under construction: JSON and one binary buffer.
#[derive(Clone)]
pub struct Document {
    /// The JSON.
    pub json: Value,
    bin: Vec<u8>,
}

impl Document {
    /// A document without anything.
    pub fn new() -> Self {
        let json = json!({
            "asset": { "version": "2.0" }, "accessors": [], "bufferViews": [], "buffers": [{ "byteLength": 0 }], "scene": 0,
        });
        Self { json, bin: Vec::new() }
    }

    /// Adds a thing to a list, and gives its index.
    pub fn push(&mut self, list: &str, thing: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(thing);
        list.len() - 1
    }

    /// A view of bytes of the file's own buffer.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        self.bin.extend_from_slice(bytes);
        self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        self.push("bufferViews", view)
    }

    /// An accessor of packed components, all bytes of a view of their own.
    pub fn accessor(&mut self, kind: &str, component: u32, bytes: &[u8]) -> usize {
        let width = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let size = match component {
            BYTES => 1,
            SHORTS => 2,
            _ => 4,
        };
        let view = self.view(bytes);
        let count = bytes.len() / (width * size);
        let accessor =
            json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
        self.push("accessors", accessor)
    }

    /// An accessor of f32.
    pub fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(kind, FLOATS, &bytes)
    }

    /// The file.
    pub fn glb(&self) -> Vec<u8> {
        let (mut json, mut bin) = (self.json.to_string().into_bytes(), self.bin.clone());
        json.resize(json.len().next_multiple_of(4), b' ');
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut file = b"glTF\x02\0\0\0".to_vec();
        file.extend(((12 + 8 + json.len() + 8 + bin.len()) as u32).to_le_bytes());
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &bin)] {
            file.extend((chunk.len() as u32).to_le_bytes());
            file.extend(kind);
            file.extend(chunk);
        }
        file
    }
}

/// Positions, normals, texture coordinates and indices of a box of half sides, faces outwards.
fn faces(half: [f32; 3]) -> ([Vec<f32>; 3], Vec<u16>) {
    let (mut positions, mut normals, mut uvs, mut indices) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in [-1.0_f32, 1.0] {
            let first = (positions.len() / 3) as u16;
            for [s, t] in [[-1.0_f32, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
                let [mut place, mut normal] = [[0.0_f32; 3]; 2];
                (place[axis], place[(axis + 1) % 3], place[(axis + 2) % 3]) = (side, s, side * t);
                normal[axis] = side;
                positions.extend((0..3).map(|axis| place[axis] * half[axis]));
                normals.extend(normal);
                uvs.extend([0.5 + 0.5 * s, 0.5 + 0.5 * t]);
            }
            indices.extend([0, 1, 2, 0, 2, 3].map(|corner| first + corner));
        }
    }
    ([positions, normals, uvs], indices)
}

/// The toy, of some 0.5 m, standing on the plane y = 0; `image` is the PNG of its body, `alpha` that of its vane, which is glass below 1.
pub fn toy(image: Option<&[u8]>, alpha: f32) -> Document {
    let mut toy = Document::new();
    let texture = image.map(|png| {
        let view = toy.view(png);
        toy.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
        toy.json["samplers"] = json!([{ "wrapS": 33648, "wrapT": 10497 }]);
        toy.json["textures"] = json!([{ "source": 0, "sampler": 0 }]);
        let transform = json!({ "offset": [0.1, 0.2], "rotation": 0.3, "scale": [0.4, 0.3] });
        json!({ "index": 0, "extensions": { "KHR_texture_transform": transform } })
    });
    let body = json!({ "baseColorFactor": [0.9, 0.8, 0.7, 1.0], "baseColorTexture": texture });
    toy.json["materials"] = json!([
        { "name": "body", "pbrMetallicRoughness": body },
        {
            "name": "vane", "doubleSided": true, "alphaMode": if alpha < 1.0 { "BLEND" } else { "OPAQUE" },
            "pbrMetallicRoughness": { "baseColorFactor": [0.2, 0.3, 0.9, alpha] },
        },
        { "name": "white", "doubleSided": true, "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.7, 0.2, 1.0] } },
    ]);
    toy.json["nodes"] = json!([
        { "name": "body", "mesh": 0, "children": [1, 2], "translation": [0.0, 0.15, 0.0] },
        { "name": "vane", "mesh": 1, "translation": [0.0, 0.15, 0.0], "scale": [-1.0, 1.2, 1.0] },
        { "name": "joint", "children": [3], "translation": [0.15, 0.0, 0.0] },
        { "name": "tip", "translation": [0.0, 0.2, 0.0], "rotation": [0.0, 0.0, -0.2, 0.98] },
        { "name": "tail", "mesh": 2, "skin": 0, "translation": [9.0, 9.0, 9.0] },
    ]);
    toy.json["scenes"] = json!([{ "nodes": [0, 4] }]);
    let meshes = [toy_body(&mut toy), toy_vane(&mut toy), toy_tail(&mut toy)];
    toy.json["meshes"] = json!(meshes);
    animate(&mut toy);
    toy
}

fn toy_body(toy: &mut Document) -> Value {
    let ([positions, normals, uvs], indices) = faces([0.15, 0.15, 0.1]);
    let positions = toy.floats("VEC3", &positions);
    let normals = toy.floats("VEC3", &normals);
    let uvs = toy.floats("VEC2", &uvs);
    let bytes: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
    let indices = toy.accessor("SCALAR", SHORTS, &bytes);
    let attributes = json!({ "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs });
    json!({ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] })
}

/// Two triangles without normals, of which a target moves one corner, with colours.
fn toy_vane(toy: &mut Document) -> Value {
    let positions = toy.floats("VEC3", &[-0.2, 0.0, 0.0, 0.2, 0.0, 0.05, 0.2, 0.2, 0.0, -0.2, 0.2, 0.05]);
    let moved = toy.floats("VEC3", &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0]);
    let colours =
        toy.accessor("VEC4", BYTES, &[255, 255, 255, 255, 255, 0, 255, 255, 99, 255, 255, 255, 9, 9, 9, 255]);
    let indices = toy.accessor("SCALAR", BYTES, &[0, 1, 2, 0, 2, 3]);
    let attributes = json!({ "POSITION": positions, "COLOR_0": colours });
    let targets = json!([{ "POSITION": moved }]);
    json!({
        "weights": [0.25],
        "primitives": [{ "attributes": attributes, "indices": indices, "material": 1, "targets": targets }],
    })
}

/// A strip that two joints bend.
fn toy_tail(toy: &mut Document) -> Value {
    let rows = [0.0_f32, 0.2, 0.4];
    let positions: Vec<f32> = rows.iter().flat_map(|y| [-0.04, *y, 0.0, 0.04, *y, 0.0]).collect();
    let weights: Vec<f32> =
        [0.0_f32, 0.5, 1.0].iter().flat_map(|share| [[1.0 - share, *share, 0.0, 0.0]; 2]).flatten().collect();
    let binds: Vec<f32> = [0.0_f32, -0.2]
        .iter()
        .flat_map(|y| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, *y, 0.0, 1.0])
        .collect();
    let positions = toy.floats("VEC3", &positions);
    let normals = toy.floats("VEC3", &[0.0, 0.0, 1.0].repeat(6));
    let joints = toy.accessor("VEC4", BYTES, &[0, 1, 0, 0].repeat(6));
    let weights = toy.floats("VEC4", &weights);
    let binds = toy.floats("MAT4", &binds);
    toy.json["skins"] = json!([{ "joints": [2, 3], "inverseBindMatrices": binds }]);
    let attributes =
        json!({ "POSITION": positions, "NORMAL": normals, "JOINTS_0": joints, "WEIGHTS_0": weights });
    json!({ "primitives": [{ "attributes": attributes, "mode": 5, "material": 2 }] })
}

/// Node, path, interpolation, kind of value, times and values of a channel.
pub type Channel<'a> = (usize, &'a str, &'a str, &'a str, &'a [f32], &'a [f32]);

/// Two animations: of every path and kind of interpolation, and a turn by a spline.
fn animate(toy: &mut Document) {
    let all: [Channel; 5] = [
        (
            0,
            "translation",
            "CUBICSPLINE",
            "VEC3",
            &[0.5, 2.0],
            &[0.0, 0.0, 0.0, 0.0, 0.15, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, -0.5, 0.3, 0.15, 0.2, 0.0, 0.0, 0.0],
        ),
        (0, "scale", "STEP", "VEC3", &[0.0, 1.0], &[1.0, 1.0, 1.0, 0.8, 1.0, 1.1]),
        (1, "rotation", "LINEAR", "VEC4", &[0.0, 2.0], &[0.0, 0.0, 0.0, 1.0, 0.0, -0.9, 0.0, -0.436]),
        (1, "weights", "LINEAR", "SCALAR", &[0.0, 1.5], &[0.0, 1.0]),
        (3, "rotation", "LINEAR", "VEC4", &[0.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 0.3, 0.0, 0.0, 0.954]),
    ];
    let turn: [f32; 24] = [
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.7, 0.0, 0.714,
        0.0, 0.0, 0.0, 0.0,
    ];
    let spline: [Channel; 1] = [(0, "rotation", "CUBICSPLINE", "VEC4", &[0.0, 3.0], &turn)];
    animated(toy, &[&all[..], &spline[..]]);
}

/// Adds animations with these channels.
pub fn animated(toy: &mut Document, clips_of: &[&[Channel<'_>]]) {
    let mut clips = Vec::new();
    for clip in clips_of {
        let (mut channels, mut samplers) = (Vec::new(), Vec::new());
        for (node, path, interpolation, kind, times, values) in *clip {
            let input = toy.floats("SCALAR", times);
            let output = toy.floats(kind, values);
            channels.push(json!({ "sampler": samplers.len(), "target": { "node": node, "path": path } }));
            samplers.push(json!({ "input": input, "output": output, "interpolation": interpolation }));
        }
        clips.push(json!({ "channels": channels, "samplers": samplers }));
    }
    toy.json["animations"] = json!(clips);
}
