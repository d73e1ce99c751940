//! The glTF document: JSON to typed form, with its version, extensions and size checked first.

use gltf::json::{Index, Root, root::Get};
use serde_json::Value;

use super::Opening;
use super::error::{ImportError, Result, place_of, shown};
use super::limits::{self, Limits, within};
use super::outline;
use super::warnings::Warnings;
use super::{census, glb};

/// Extensions that are honoured, so that a file may require them.
const SUPPORTED_EXTENSIONS: [&str; 9] = [
    "EXT_meshopt_compression",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_transmission",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_transform",
];

/// Extensions without which a scene is still read as it is meant, but for their gloss or motion: by the start of their
/// names.
const HARMLESS_EXTENSIONS: [&str; 4] = ["KHR_animation_", "KHR_materials_", "KHR_xmp", "EXT_mesh_features"];

/// Code of the warning that animations are not played.
pub(super) const ANIMATIONS: &str = "animations-ignored";

/// How to do without an extension that a file requires.
const ADVICE: [(&str, &str); 4] = [
    (
        "KHR_texture_basisu",
        "convert its textures with 'npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb'",
    ),
    ("EXT_texture_webp", "convert its textures with 'npx @gltf-transform/cli png IN.glb OUT.glb'"),
    ("EXT_texture_avif", "convert its textures with 'npx @gltf-transform/cli png IN.glb OUT.glb'"),
    ("EXT_mesh_gpu_instancing", "export the scene with its instances as nodes"),
];

/// Parses a `.gltf` or `.glb` and checks version and required extensions. Gives the GLB's binary chunk beside it.
pub(super) fn parse<'a>(bytes: &'a [u8], limits: &Limits) -> Result<(Root, Option<&'a [u8]>)> {
    let (json, bin) = json_of(bytes)?;
    check_json_size(json, limits)?;
    census::check(json, limits)?;
    let root = outline::read(json)?;
    check_version(&root)?;
    check_required_extensions(&root)?;
    Ok((root, bin))
}

/// The JSON of a `.gltf` or `.glb`, and the GLB's binary chunk beside it.
fn json_of(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    let (json, bin) = match glb::is_glb(bytes) {
        true => glb::split(bytes).map(|parts| (parts.json, parts.bin))?,
        false => (bytes, None),
    };
    Ok((json.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(json), bin))
}

/// The JSON of a `.gltf` or `.glb` that [`parse`] has taken, untyped, its keys in order.
pub(super) fn values(bytes: &[u8]) -> Result<Value> {
    let mut values: Value =
        serde_json::from_slice(json_of(bytes)?.0).map_err(|source| ImportError::Json { source })?;
    values.sort_all_objects();
    Ok(values)
}

/// Bounds what parsing can allocate, by counting outside strings before anything is built.
fn check_json_size(json: &[u8], limits: &Limits) -> Result<()> {
    within(limits::JSON_BYTES, json.len() as u64, limits.json_bytes)?;
    let (mut object_count, mut value_count) = (0, 0);
    let (mut is_in_string, mut is_escaped) = (false, false);
    for &byte in json {
        if is_in_string {
            is_in_string = is_escaped || byte != b'"';
            is_escaped = !is_escaped && byte == b'\\';
            continue;
        }
        match byte {
            b'"' => is_in_string = true,
            b'{' => object_count += 1,
            b',' | b':' => value_count += 1,
            _ => {}
        }
    }
    within(limits::JSON_OBJECTS, object_count, limits.json_objects)?;
    within(limits::JSON_VALUES, value_count, limits.json_values)
}

fn check_version(root: &Root) -> Result<()> {
    let asset = &root.asset;
    let needed = asset.min_version.as_deref().unwrap_or(&asset.version);
    let is_2_0 = needed == "2.0" || (asset.min_version.is_none() && needed.starts_with("2."));
    if is_2_0 { Ok(()) } else { Err(ImportError::version(needed)) }
}

fn check_required_extensions(root: &Root) -> Result<()> {
    let is_fatal = |name: &&String| {
        let is_harmless = HARMLESS_EXTENSIONS.iter().any(|start| name.starts_with(start));
        !is_harmless && !SUPPORTED_EXTENSIONS.contains(&name.as_str())
    };
    let Some(name) = root.extensions_required.iter().find(is_fatal) else { return Ok(()) };
    let known = ADVICE.iter().find(|(extension, _)| extension == name);
    let advice = known.map_or("export the scene without it", |(_, advice)| advice);
    Err(ImportError::UnsupportedExtension { name: shown(name), advice })
}

/// Warns of extensions that the file uses and that are passed over, naming each.
pub(super) fn warn_of_ignored_extensions(root: &Root, opening: Opening, warnings: &mut Warnings) {
    let used = root.extensions_used.iter().map(String::as_str);
    let ignored: Vec<&str> = used.filter(|name| !SUPPORTED_EXTENSIONS.contains(name)).collect();
    if !ignored.is_empty() {
        let names = shown(&ignored.join(", "));
        warnings.add("extension-ignored", || format!("{names}: not understood, the scene is read without"));
    }
    if !root.animations.is_empty() && opening == Opening::Still {
        let count = root.animations.len();
        warnings.add(ANIMATIONS, || {
            format!("{count} animation(s) are not played: the scene is baked as it stands at rest")
        });
    }
}

/// Follows an index of the JSON, or says who named what does not exist.
pub(super) fn get<'a, T>(
    root: &'a Root,
    index: Index<T>,
    kind: &'static str,
    place: impl FnOnce() -> String,
) -> Result<&'a T>
where
    Root: Get<T> + AsRef<[T]>,
{
    Get::get(root, index).ok_or_else(|| ImportError::MissingReference {
        place: place(),
        kind,
        index: index.value(),
        count: AsRef::<[T]>::as_ref(root).len(),
    })
}

/// Name in messages of a buffer.
pub(super) fn buffer_place(root: &Root, index: usize) -> String {
    place_of("buffer", index, root.buffers.get(index).and_then(|buffer| buffer.name.as_deref()))
}

/// Name in messages of an image.
pub(super) fn image_place(root: &Root, index: usize) -> String {
    let image = root.images.get(index);
    let name = image.and_then(|image| image.name.as_deref());
    let uri = image.and_then(|image| image.uri.as_deref()).filter(|uri| !uri.starts_with("data:"));
    place_of("image", index, name.or(uri))
}

/// Name in messages of a node.
pub(super) fn node_place(root: &Root, index: usize) -> String {
    place_of("node", index, root.nodes.get(index).and_then(|node| node.name.as_deref()))
}

/// Name in messages of a mesh's primitive.
pub(super) fn primitive_place(root: &Root, mesh_index: usize, primitive_index: usize) -> String {
    let name = root.meshes.get(mesh_index).and_then(|mesh| mesh.name.as_deref());
    format!("{} primitive {primitive_index}", place_of("mesh", mesh_index, name))
}
