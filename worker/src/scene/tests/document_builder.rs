//! Builds small glTFs for tests.

use serde_json::{Value, json};

use crate::scene::model::{Imported, MeshInstance};
use crate::scene::{Bundle, ImportError, Limits, import};

pub(super) const BYTE: u32 = 5120;
pub(super) const UNSIGNED_BYTE: u32 = 5121;
pub(super) const UNSIGNED_SHORT: u32 = 5123;
pub(super) const UNSIGNED_INT: u32 = 5125;
pub(super) const FLOAT: u32 = 5126;

/// A unit right triangle in the xy plane, counter-clockwise seen from +z.
pub(super) const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

/// A glTF under construction: JSON and one binary buffer.
#[derive(Clone)]
pub(super) struct Document {
    pub(super) json: Value,
    bin: Vec<u8>,
}

impl Document {
    /// No meshes yet; one scene with one node, which holds mesh 0.
    pub(super) fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{"byteLength": 0}],
        });
        Self { json, bin: Vec::new() }
    }

    /// [`TRIANGLE`] without normals.
    pub(super) fn triangle() -> Self {
        let mut document = Self::new();
        let position = document.floats("VEC3", &TRIANGLE);
        document.json["meshes"] =
            json!([{"name": "tri", "primitives": [{"attributes": {"POSITION": position}}]}]);
        document
    }

    /// [`TRIANGLE`] with normals along +z.
    pub(super) fn triangle_with_normals() -> Self {
        let mut document = Self::triangle();
        let normal = document.floats("VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        document.attributes()["NORMAL"] = json!(normal);
        document
    }

    /// The attributes of the first primitive.
    pub(super) fn attributes(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]["attributes"]
    }

    /// The first primitive.
    pub(super) fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }

    /// Appends bytes as a buffer view.
    pub(super) fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend_from_slice(bytes);
        self.json["buffers"][0]["byteLength"] = json!(self.bin.len());
        push(&mut self.json["bufferViews"], view)
    }

    /// Appends an accessor over its own view.
    pub(super) fn accessor(&mut self, kind: &str, component: u32, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessor = json!({"bufferView": view, "componentType": component, "count": count, "type": kind});
        push(&mut self.json["accessors"], accessor)
    }

    /// Appends an accessor of f32.
    pub(super) fn floats(&mut self, kind: &str, values: &[f32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let width = match kind {
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 1,
        };
        self.accessor(kind, FLOAT, values.len() / width, &bytes)
    }

    /// Appends an index list of u16.
    pub(super) fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor("SCALAR", UNSIGNED_SHORT, values.len(), &bytes)
    }

    /// Appends an element to one of the document's lists.
    pub(super) fn push(&mut self, list: &str, element: Value) -> usize {
        if self.json[list].is_null() {
            self.json[list] = json!([]);
        }
        push(&mut self.json[list], element)
    }

    /// The GLB.
    pub(super) fn glb(&self) -> Vec<u8> {
        let mut json = serde_json::to_vec(&self.json).unwrap();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let total = 12 + 8 + json.len() + 8 + bin.len();
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend((total as u32).to_le_bytes());
        for (kind, body) in [(b"JSON", json), (b"BIN\0", bin)] {
            glb.extend((body.len() as u32).to_le_bytes());
            glb.extend(kind);
            glb.extend(body);
        }
        glb
    }

    /// Imports it as a GLB under the default limits.
    pub(super) fn import(&self) -> Result<Imported, ImportError> {
        import_bytes(self.glb())
    }

    /// Imports it, expecting success and exactly one instance.
    pub(super) fn import_one(&self) -> MeshInstance {
        let mut imported = self.import().unwrap();
        assert_eq!(imported.scene.instances.len(), 1);
        imported.scene.instances.remove(0)
    }
}

fn push(list: &mut Value, element: Value) -> usize {
    let list = list.as_array_mut().unwrap();
    list.push(element);
    list.len() - 1
}

/// Imports an upload under the default limits.
pub(super) fn import_bytes(bytes: Vec<u8>) -> Result<Imported, ImportError> {
    let limits = Limits::default();
    import(&Bundle::from_bytes(bytes, &limits)?, &limits)
}

/// The codes of an import's warnings.
pub(super) fn codes(imported: &Imported) -> Vec<&str> {
    imported.warnings.iter().map(|warning| warning.code.as_str()).collect()
}

/// A PNG of the given pixels, row by row.
pub(super) fn png(width: u32, height: u32, pixels: &[[u8; 4]]) -> Vec<u8> {
    let image = image::RgbaImage::from_raw(width, height, pixels.concat()).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}
