//! A GLB file under construction: arrays of glTF by name, and the one buffer.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read};

use serde::Deserialize;
use serde_json::{Map, Value, json};

use crate::error::{ClientError, Result};

/// First word of the program that files name as theirs.
const GENERATOR: &str = "Lightkiln";
const MAGIC: u32 = 0x4654_6C67;
const VERSION: u32 = 2;
const JSON: u32 = 0x4E4F_534A;
const BIN: u32 = 0x004E_4942;
/// Header of the file, and of its two chunks.
const HEADERS_BYTES: u64 = 12 + 8 + 8;
/// Kind of a number: `FLOAT` and `UNSIGNED_INT` of glTF.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
/// Use of a view: `ARRAY_BUFFER` and `ELEMENT_ARRAY_BUFFER` of glTF.
const VERTICES: u32 = 34_962;
const INDICES: u32 = 34_963;

/// A file under construction. Equal calls in equal order give equal bytes.
#[derive(Debug, Default)]
pub struct Glb {
    arrays: BTreeMap<&'static str, Vec<Value>>,
    extensions: BTreeSet<&'static str>,
    buffer: Vec<u8>,
}

impl Glb {
    /// Adds an element to an array of glTF: its index.
    pub fn push(&mut self, array: &'static str, element: Value) -> usize {
        let array = self.arrays.entry(array).or_default();
        array.push(element);
        array.len() - 1
    }

    /// Names an extension as one that the file uses and can be read without.
    pub fn uses(&mut self, extension: &'static str) {
        self.extensions.insert(extension);
    }

    /// An accessor of vertices, of which `N` is 2 to 4; with bounds for positions.
    pub fn vertices<const N: usize>(&mut self, values: &[[f32; N]], bounded: bool) -> usize {
        let view = self.view(bytemuck::cast_slice(values.as_flattened()), Some(VERTICES));
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "count": values.len(), "type": format!("VEC{N}"),
        });
        if bounded {
            let bound = |start: f32, outer: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|axis| values.iter().map(|value| value[axis]).fold(start, outer)).collect()
            };
            accessor["min"] = json!(bound(f32::INFINITY, f32::min));
            accessor["max"] = json!(bound(f32::NEG_INFINITY, f32::max));
        }
        self.push("accessors", accessor)
    }

    /// An accessor of triangles' corners.
    pub fn triangles(&mut self, triangles: &[[u32; 3]]) -> usize {
        let view = self.view(bytemuck::cast_slice(triangles.as_flattened()), Some(INDICES));
        let count = 3 * triangles.len();
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": UNSIGNED_INT, "count": count, "type": "SCALAR" }),
        )
    }

    /// A picture inside the file.
    pub fn picture(&mut self, media_type: &str, bytes: &[u8]) -> usize {
        let view = self.view(bytes, None);
        self.push("images", json!({ "bufferView": view, "mimeType": media_type }))
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.buffer.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.buffer.extend(bytes);
        self.buffer.resize(self.buffer.len().next_multiple_of(4), 0);
        self.push("bufferViews", view)
    }

    /// The file, with one scene of all nodes; `extras` are the asset's. Errs where it is longer than a GLB can be.
    pub fn finish(mut self, extras: Value) -> Result<Vec<u8>> {
        if !self.arrays.contains_key("nodes") {
            // A scene lists at least one.
            self.push("nodes", json!({ "name": "empty" }));
        }
        let nodes: Vec<usize> = (0..self.arrays["nodes"].len()).collect();
        self.push("scenes", json!({ "nodes": nodes }));
        if !self.buffer.is_empty() {
            let bytes = self.buffer.len();
            self.push("buffers", json!({ "byteLength": bytes }));
        }
        let generator = format!("{GENERATOR} {}", env!("CARGO_PKG_VERSION"));
        let mut root = Map::new();
        root.insert(
            "asset".to_owned(),
            json!({ "version": "2.0", "generator": generator, "extras": extras }),
        );
        root.insert("scene".to_owned(), json!(0));
        if !self.extensions.is_empty() {
            root.insert("extensionsUsed".to_owned(), json!(self.extensions));
        }
        root.extend(self.arrays.into_iter().map(|(name, array)| (name.to_owned(), Value::Array(array))));
        let mut text = Value::Object(root).to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        joined(&text, &self.buffer)
    }
}

/// Whether a file is a GLB that names Lightkiln as its generator. Errs where it cannot be read.
pub fn is_own(mut file: impl Read) -> io::Result<bool> {
    #[derive(Deserialize)]
    struct Root {
        asset: Asset,
    }
    #[derive(Deserialize)]
    struct Asset {
        generator: String,
    }
    // Headers of the file and of its first chunk.
    let mut start = Vec::new();
    file.by_ref().take(20).read_to_end(&mut start)?;
    let words: Vec<u32> = start.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let [MAGIC, VERSION, _, bytes, JSON] = words[..] else { return Ok(false) };
    let mut text = Vec::new();
    file.take(bytes.into()).read_to_end(&mut text)?;
    let root = serde_json::from_slice::<Root>(&text);
    Ok(root.is_ok_and(|root| root.asset.generator.starts_with(GENERATOR)))
}

/// Header and chunks of a file; the second one is left out where there is no buffer.
fn joined(text: &[u8], buffer: &[u8]) -> Result<Vec<u8>> {
    let all = HEADERS_BYTES + text.len() as u64 + buffer.len() as u64;
    if all > u64::from(u32::MAX) {
        let what = format!("a GLB of {all} bytes");
        let problem = "is longer than the 4 GiB of the format: export the scene in parts".to_owned();
        return Err(ClientError::Argument { what, problem });
    }
    let mut file = Vec::with_capacity(all as usize);
    let chunk = |file: &mut Vec<u8>, kind: u32, bytes: &[u8]| {
        file.extend((bytes.len() as u32).to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(bytes);
    };
    let own = if buffer.is_empty() { all - 8 } else { all };
    [MAGIC, VERSION, own as u32].iter().for_each(|word| file.extend(word.to_le_bytes()));
    chunk(&mut file, JSON, text);
    if !buffer.is_empty() {
        chunk(&mut file, BIN, buffer);
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_of_nothing_is_valid() {
        let file = Glb::default().finish(Value::Null).unwrap();
        let read = gltf::Gltf::from_slice(&file).unwrap();
        assert_eq!((read.scenes().count(), read.nodes().count()), (1, 1));
    }

    #[test]
    fn vertices_and_triangles_come_back() {
        let mut glb = Glb::default();
        let corners = [[0.1, -2.0, 3.0], [1.0, 5.5, 0.0], [0.25, 0.5, -1e-3]];
        let position = glb.vertices(&corners, true);
        let indices = glb.triangles(&[[0, 2, 1]]);
        let primitive = json!({ "attributes": { "POSITION": position }, "indices": indices });
        let mesh = glb.push("meshes", json!({ "primitives": [primitive] }));
        glb.push("nodes", json!({ "mesh": mesh }));
        let file = glb.finish(json!({ "unit": "W/m2" })).unwrap();
        let read = gltf::Gltf::from_slice(&file).unwrap();
        let blob = read.blob.clone().unwrap();
        let primitive = read.meshes().next().unwrap().primitives().next().unwrap();
        let bounds = primitive.bounding_box();
        assert_eq!((bounds.min, bounds.max), ([0.1, -2.0, -1e-3], [1.0, 5.5, 3.0]));
        let reader = primitive.reader(|_| Some(&blob));
        assert_eq!(reader.read_positions().unwrap().collect::<Vec<_>>(), corners);
        assert_eq!(reader.read_indices().unwrap().into_u32().collect::<Vec<_>>(), [0, 2, 1]);
    }
}
