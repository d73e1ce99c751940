//! The glTF document: JSON to typed form, with its version, extensions and size checked first.

use gltf::json::{Index, Root, root::Get};

use super::error::{ImportError, Result, place_of, shown};
use super::glb;
use super::limits::{Limits, within};
use super::warnings::Warnings;

/// Extensions that are honoured, so that a file may require them.
const SUPPORTED_EXTENSIONS: [&str; 4] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Extensions that compress geometry: the advice differs from that for others.
const GEOMETRY_COMPRESSION: [&str; 3] =
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

/// Parses a `.gltf` or `.glb` and checks version and required extensions. Gives the GLB's binary chunk beside it.
pub(super) fn parse<'a>(bytes: &'a [u8], limits: &Limits) -> Result<(Root, Option<&'a [u8]>)> {
    let (json, bin) = if glb::is_glb(bytes) {
        let parts = glb::split(bytes)?;
        (parts.json, parts.bin)
    } else {
        (bytes, None)
    };
    let json = json.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(json);
    check_json_size(json, limits)?;
    let root = Root::from_slice(json).map_err(|source| ImportError::Json { source })?;
    check_version(&root)?;
    check_required_extensions(&root)?;
    Ok((root, bin))
}

/// Bounds what parsing can allocate, by counting outside strings before anything is built.
fn check_json_size(json: &[u8], limits: &Limits) -> Result<()> {
    within("bytes of JSON", json.len() as u64, limits.json_bytes)?;
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
    within("objects in the JSON", object_count, limits.json_objects)?;
    within("values in the JSON", value_count, limits.json_values)
}

fn check_version(root: &Root) -> Result<()> {
    let asset = &root.asset;
    let needed = asset.min_version.as_deref().unwrap_or(&asset.version);
    let is_2_0 = needed == "2.0" || (asset.min_version.is_none() && needed.starts_with("2."));
    if is_2_0 { Ok(()) } else { Err(ImportError::Version { version: shown(needed) }) }
}

fn check_required_extensions(root: &Root) -> Result<()> {
    let is_supported = |name: &&String| SUPPORTED_EXTENSIONS.contains(&name.as_str());
    let Some(name) = root.extensions_required.iter().find(|name| !is_supported(name)) else {
        return Ok(());
    };
    let advice = if GEOMETRY_COMPRESSION.contains(&name.as_str()) {
        "export the scene without mesh compression"
    } else {
        "export the scene without it"
    };
    Err(ImportError::UnsupportedExtension { name: shown(name), advice })
}

/// Warns of extensions that the file uses and that are passed over, naming each.
pub(super) fn warn_of_ignored_extensions(root: &Root, warnings: &mut Warnings) {
    let ignored =
        root.extensions_used.iter().map(String::as_str).filter(|name| !SUPPORTED_EXTENSIONS.contains(name));
    let (compression, others): (Vec<&str>, Vec<&str>) =
        ignored.partition(|name| GEOMETRY_COMPRESSION.contains(name));
    if !compression.is_empty() {
        let names = shown(&compression.join(", "));
        warnings.add("compression-ignored", || {
            format!("{names}: not decoded, the uncompressed fallback is used")
        });
    }
    if !others.is_empty() {
        let names = shown(&others.join(", "));
        warnings.add("extension-ignored", || format!("{names}: not understood, the scene is read without"));
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
