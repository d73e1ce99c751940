//! A glTF written anew from parts of another one: each thing once, under the number of its first use, with its bytes packed.

use std::collections::{BTreeMap, BTreeSet};

use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};
use serde_json::{Map, Value, json};

use super::super::accessor::{Reader, Wanted};
use super::super::context::Context;
use super::super::document::primitive_place;
use super::super::error::{ImportError, Result};
use super::super::glb;
use super::super::images::image_bytes;
use super::super::limits::{self, Budget};
use super::super::{draco, meshopt};

/// The extension of lights.
pub(super) const LIGHTS: &str = "KHR_lights_punctual";
/// That of meshes in whole numbers.
const QUANTIZED: &str = "KHR_mesh_quantization";
/// Attributes of vertices that bakes read.
const ATTRIBUTES: [&str; 9] = [
    "COLOR_0",
    "JOINTS_0",
    "JOINTS_1",
    "NORMAL",
    "POSITION",
    "TEXCOORD_0",
    "TEXCOORD_1",
    "WEIGHTS_0",
    "WEIGHTS_1",
];
/// Those of morph targets.
const TARGETS: [&str; 2] = ["NORMAL", "POSITION"];
/// Attributes that are floats without [`QUANTIZED`].
const FLOATS: [&str; 2] = ["NORMAL", "POSITION"];
/// All types of elements.
const TYPES: [Type; 7] =
    [Type::Scalar, Type::Vec2, Type::Vec3, Type::Vec4, Type::Mat2, Type::Mat3, Type::Mat4];
/// Bytes of which elements of vertices have a multiple, and from which views begin.
const ALIGNMENT: usize = 4;

/// Things of a list, by their numbers in the file.
#[derive(Default)]
struct Listed {
    numbers: BTreeMap<(usize, bool), usize>,
    values: Vec<Value>,
}

impl Listed {
    fn add(&mut self, old: (usize, bool), value: Value) -> usize {
        self.values.push(value);
        self.numbers.insert(old, self.values.len() - 1);
        self.values.len() - 1
    }
}

/// A glTF under construction.
pub(super) struct Writer<'a> {
    context: &'a Context<'a>,
    root: &'a Root,
    json: &'a Value,
    /// An object has no names of its own in the scene.
    is_object: bool,
    lists: BTreeMap<&'static str, Listed>,
    bin: Vec<u8>,
    is_quantized: bool,
}

impl<'a> Writer<'a> {
    /// Nothing yet, from a file's JSON.
    pub(super) fn new(context: &'a Context<'a>, json: &'a Value, is_object: bool) -> Self {
        let (lists, bin) = (BTreeMap::new(), Vec::new());
        Self { context, root: context.root, json, is_object, lists, bin, is_quantized: false }
    }

    /// The file's JSON of one of its things.
    pub(super) fn stated(&self, list: &'static str, old: usize) -> Result<&'a Value> {
        let all = &self.json[list];
        all.get(old).ok_or_else(|| missing(list, old, all))
    }

    /// The new number of a thing, if it has one.
    fn known(&self, list: &'static str, old: (usize, bool)) -> Option<usize> {
        self.lists.get(list)?.numbers.get(&old).copied()
    }

    fn add(&mut self, list: &'static str, old: usize, value: Value) -> usize {
        self.lists.entry(list).or_default().add((old, false), value)
    }

    /// A mesh with all that it names.
    pub(super) fn mesh(&mut self, old: usize, budget: &mut Budget) -> Result<usize> {
        if let Some(known) = self.known("meshes", (old, false)) {
            return Ok(known);
        }
        let stated = self.stated("meshes", old)?;
        let mut mesh = picked(stated, if self.is_object { &["weights"] } else { &["name", "weights"] });
        let mut primitives = Vec::new();
        for (index, primitive) in stated["primitives"].as_array().into_iter().flatten().enumerate() {
            let root = self.root;
            let place = move || primitive_place(root, old, index);
            let mut written = picked(primitive, &["mode"]);
            let attributes = self.attributes(&primitive["attributes"], &ATTRIBUTES, &place, budget)?;
            written.insert("attributes".to_owned(), attributes);
            if let Some(indices) = number(&primitive["indices"]) {
                let indices = self.accessor(indices, false, &place, budget)?;
                written.insert("indices".to_owned(), json!(indices));
            }
            if let Some(material) = number(&primitive["material"]) {
                written.insert("material".to_owned(), json!(self.material(material, budget)?));
            }
            let targets = primitive["targets"].as_array().into_iter().flatten();
            let targets = targets.map(|target| self.attributes(target, &TARGETS, &place, budget));
            let targets: Vec<Value> = targets.collect::<Result<_>>()?;
            if !targets.is_empty() {
                written.insert("targets".to_owned(), json!(targets));
            }
            primitives.push(written);
        }
        mesh.insert("primitives".to_owned(), json!(primitives));
        Ok(self.add("meshes", old, mesh.into()))
    }

    /// Accessors of those attributes that are wanted.
    fn attributes(
        &mut self,
        stated: &Value,
        wanted: &[&str],
        place: &dyn Fn() -> String,
        budget: &mut Budget,
    ) -> Result<Value> {
        let mut written = Map::new();
        for name in wanted {
            let Some(old) = number(&stated[*name]) else { continue };
            let new = self.accessor(old, true, place, budget)?;
            let is_float = self.root.accessors.get(old).is_some_and(|accessor| {
                matches!(accessor.component_type, Checked::Valid(component) if component.0 == ComponentType::F32)
            });
            self.is_quantized |= FLOATS.contains(name) && !is_float;
            written.insert((*name).to_owned(), json!(new));
        }
        Ok(written.into())
    }

    /// An accessor in a view of its own, without gaps; elements of vertices begin at multiples of four bytes.
    fn accessor(
        &mut self,
        old: usize,
        is_vertex: bool,
        place: &dyn Fn() -> String,
        budget: &mut Budget,
    ) -> Result<usize> {
        if let Some(known) = self.known("accessors", (old, is_vertex)) {
            return Ok(known);
        }
        let limits = self.context.limits;
        let mut sparse = Budget::new(limits::SPARSE_ELEMENTS, limits.sparse_elements);
        let wanted = Wanted { place, types: &TYPES, min_count: 0, is_always_normalized: false };
        let index = Index::new(u32::try_from(old).unwrap_or(u32::MAX));
        let reader = Reader::open(self.root, self.context.buffers, &mut sparse, index, &wanted)?;
        let element = reader.element_bytes();
        let stride = if is_vertex { element.next_multiple_of(ALIGNMENT) } else { element };
        budget.spend((reader.count() as u64).saturating_mul(stride as u64))?;
        let mut view = self.view(|bin| reader.pack(stride, bin));
        if stride != element {
            view["byteStride"] = json!(stride);
        }
        let view = self.lists.entry("bufferViews").or_default().add((old, is_vertex), view);
        let stated = self.stated("accessors", old)?;
        let mut accessor = picked(stated, &["componentType", "count", "max", "min", "normalized", "type"]);
        accessor.insert("bufferView".to_owned(), json!(view));
        Ok(self.lists.entry("accessors").or_default().add((old, is_vertex), accessor.into()))
    }

    /// A buffer view over bytes that are added to the buffer.
    fn view(&mut self, add: impl FnOnce(&mut Vec<u8>)) -> Value {
        self.bin.resize(self.bin.len().next_multiple_of(ALIGNMENT), 0);
        let offset = self.bin.len();
        add(&mut self.bin);
        json!({"buffer": 0, "byteLength": self.bin.len() - offset, "byteOffset": offset})
    }

    /// A skin whose joints have new numbers.
    pub(super) fn skin(
        &mut self,
        old: usize,
        numbers: &BTreeMap<usize, usize>,
        budget: &mut Budget,
    ) -> Result<usize> {
        if let Some(known) = self.known("skins", (old, false)) {
            return Ok(known);
        }
        let stated = self.stated("skins", old)?;
        let joints = stated["joints"].as_array().into_iter().flatten().filter_map(number);
        let joint = |joint: usize| {
            numbers.get(&joint).copied().ok_or_else(|| missing("nodes", joint, &self.json["nodes"]))
        };
        let joints = joints.map(joint).collect::<Result<Vec<usize>>>()?;
        let mut skin = if self.is_object { Map::new() } else { picked(stated, &["name"]) };
        skin.insert("joints".to_owned(), json!(joints));
        if let Some(bound) = number(&stated["inverseBindMatrices"]) {
            let place = || format!("inverse bind matrices of skin {old}");
            let bound = self.accessor(bound, false, &place, budget)?;
            skin.insert("inverseBindMatrices".to_owned(), json!(bound));
        }
        Ok(self.add("skins", old, skin.into()))
    }

    /// A material with its textures.
    fn material(&mut self, old: usize, budget: &mut Budget) -> Result<usize> {
        if let Some(known) = self.known("materials", (old, false)) {
            return Ok(known);
        }
        let mut material = self.stated("materials", old)?.clone();
        if let Value::Object(members) = &mut material {
            members.remove("extras");
            if !self.is_object {
                // Its number in the file is its name to people.
                members.entry("name").or_insert_with(|| json!(format!("material {old}")));
            }
        }
        self.renumber_textures(&mut material, budget)?;
        Ok(self.add("materials", old, material))
    }

    /// Gives textures in a material or an extension of it their new numbers.
    fn renumber_textures(&mut self, value: &mut Value, budget: &mut Budget) -> Result<()> {
        let Value::Object(members) = value else { return Ok(()) };
        for (name, member) in members {
            if let Some(old) = number(&member["index"]).filter(|_| name.ends_with("Texture")) {
                member["index"] = json!(self.texture(old, budget)?);
            }
            self.renumber_textures(member, budget)?;
        }
        Ok(())
    }

    fn texture(&mut self, old: usize, budget: &mut Budget) -> Result<usize> {
        if let Some(known) = self.known("textures", (old, false)) {
            return Ok(known);
        }
        let stated = self.stated("textures", old)?;
        let mut texture = Map::new();
        if let Some(image) = number(&stated["source"]) {
            texture.insert("source".to_owned(), json!(self.image(image, budget)?));
        }
        if let Some(sampler) = number(&stated["sampler"]) {
            let new = match self.known("samplers", (sampler, false)) {
                Some(known) => known,
                None => {
                    let modes = ["magFilter", "minFilter", "wrapS", "wrapT"];
                    let value = picked(self.stated("samplers", sampler)?, &modes);
                    self.add("samplers", sampler, value.into())
                }
            };
            texture.insert("sampler".to_owned(), json!(new));
        }
        Ok(self.add("textures", old, texture.into()))
    }

    fn image(&mut self, old: usize, budget: &mut Budget) -> Result<usize> {
        if let Some(known) = self.known("images", (old, false)) {
            return Ok(known);
        }
        let stated = self.stated("images", old)?;
        let bytes = image_bytes(self.context, old)?;
        budget.spend(bytes.len() as u64)?;
        let view = self.view(|bin| bin.extend_from_slice(&bytes));
        let view = self.lists.entry("bufferViews").or_default().add((old, false), view);
        let mut image = picked(stated, &["mimeType", "name"]);
        // A guess where the file has none: images are known by their bytes.
        image.entry("mimeType").or_insert_with(|| json!("image/png"));
        if let Some(uri) = stated["uri"].as_str().filter(|uri| !uri.starts_with("data:")) {
            let file = uri.rsplit(['/', '\\']).next().unwrap_or(uri);
            image.entry("name").or_insert_with(|| json!(file));
        }
        image.insert("bufferView".to_owned(), json!(view));
        Ok(self.add("images", old, image.into()))
    }

    /// A camera.
    pub(super) fn camera(&mut self, old: usize) -> Result<usize> {
        if let Some(known) = self.known("cameras", (old, false)) {
            return Ok(known);
        }
        let camera = self.stated("cameras", old)?.clone();
        Ok(self.add("cameras", old, camera))
    }

    /// A light.
    pub(super) fn light(&mut self, old: usize) -> Result<usize> {
        if let Some(known) = self.known("lights", (old, false)) {
            return Ok(known);
        }
        let all = &self.json["extensions"][LIGHTS]["lights"];
        let light = all.get(old).ok_or_else(|| missing("lights", old, all))?.clone();
        Ok(self.add("lights", old, light))
    }

    /// The GLB, with the top nodes of its scene and all nodes.
    pub(super) fn finish(mut self, tops: Value, nodes: Value, budget: &mut Budget) -> Result<Vec<u8>> {
        let mut document = json!({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": tops}]});
        document["nodes"] = nodes;
        for (name, list) in std::mem::take(&mut self.lists) {
            match name {
                "lights" => document["extensions"] = json!({LIGHTS: {name: list.values}}),
                name => document[name] = list.values.into(),
            }
        }
        if !self.bin.is_empty() {
            document["buffers"] = json!([{"byteLength": self.bin.len()}]);
        }
        let used = self.extensions("extensionsUsed", &document);
        let required: Vec<String> = self
            .extensions("extensionsRequired", &document)
            .into_iter()
            .filter(|name| used.contains(name))
            .collect();
        for (name, list) in [("extensionsUsed", used), ("extensionsRequired", required)] {
            if !list.is_empty() {
                document[name] = json!(list);
            }
        }
        // The same bytes whatever the order of keys in the file.
        document.sort_all_objects();
        let json = serde_json::to_vec(&document).map_err(|source| ImportError::Json { source })?;
        budget.spend(json.len() as u64)?;
        Ok(glb::joined(json, &self.bin))
    }

    /// Extensions that a list of the file names: of an object those that are left in it, of a scene all but compression, so that
    /// its import warns as ever.
    fn extensions(&self, list: &str, document: &Value) -> Vec<String> {
        let mut left = BTreeSet::new();
        collect_extensions(document, &mut left);
        if self.is_quantized {
            left.insert(QUANTIZED);
        }
        let compression = [&meshopt::EXTENSIONS[..], &[draco::EXTENSION]].concat();
        let stated: BTreeSet<&str> =
            self.json[list].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let is_kept = |name: &&str| !compression.contains(name) && (!self.is_object || left.contains(name));
        stated.into_iter().filter(is_kept).map(str::to_owned).collect()
    }
}

/// Names of the extensions of a value and of all in it.
fn collect_extensions<'v>(value: &'v Value, names: &mut BTreeSet<&'v str>) {
    match value {
        Value::Array(list) => list.iter().for_each(|value| collect_extensions(value, names)),
        Value::Object(members) => {
            let own = members.get("extensions").and_then(Value::as_object);
            names.extend(own.into_iter().flatten().map(|(name, _)| name.as_str()));
            members.iter().for_each(|(_, value)| collect_extensions(value, names));
        }
        _ => {}
    }
}

/// Those members of an object that are there.
pub(super) fn picked(stated: &Value, names: &[&str]) -> Map<String, Value> {
    let member = |name: &&str| Some(((*name).to_owned(), stated.get(*name)?.clone()));
    names.iter().filter_map(member).collect()
}

/// A number of a thing.
pub(super) fn number(value: &Value) -> Option<usize> {
    usize::try_from(value.as_u64()?).ok()
}

/// A thing that is named and is not there.
fn missing(kind: &'static str, index: usize, all: &Value) -> ImportError {
    let count = all.as_array().map_or(0, Vec::len);
    ImportError::MissingReference { place: "the scene".to_owned(), kind, index, count }
}
