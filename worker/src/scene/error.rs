//! Why a scene was not imported: what was wrong, where, and what to do.

use std::path::PathBuf;

use super::{pack, uri};

/// Result of a step of an import.
pub(super) type Result<T, E = ImportError> = std::result::Result<T, E>;

/// An upload that cannot be baked as it stands.
///
/// Every variant but [`ImportError::Io`] is a fault of the file: the same bytes fail again.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file could not be read while packing.
    #[error("cannot read {}; check that it exists and may be read", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The bytes are none of the formats that are read.
    #[error("this is not a .glb, a .gltf or a .zip; export the scene as glTF 2.0")]
    UnknownFormat,
    /// The GLB container is broken.
    #[error("broken GLB: {problem}; export the file again")]
    Glb {
        /// The fault.
        problem: String,
    },
    /// The JSON ends early or is none.
    #[error("the glTF's JSON cannot be read; export the file again")]
    Json {
        /// Where and why.
        #[source]
        source: gltf::json::Error,
    },
    /// The JSON is fine and yet no glTF.
    #[error("the JSON is not glTF 2.0; export the file again")]
    NotGltf {
        /// Where and why.
        #[source]
        source: gltf::json::Error,
    },
    /// Another glTF version than 2.
    #[error("glTF version {version:?} is not supported; {advice}")]
    Version {
        /// Version by `asset.version` or the GLB header.
        version: String,
        /// Next step for the user.
        advice: &'static str,
    },
    /// The zip container is broken, encrypted or compressed by an unsupported method.
    #[error("broken zip at {place}; pack it again with plain deflate and no password")]
    Zip {
        /// Which entry, or the archive as a whole.
        place: String,
        /// Error of the reader.
        #[source]
        source: zip::result::ZipError,
    },
    /// A zip entry could not be decompressed.
    #[error("the zip's {place} cannot be decompressed; pack it again")]
    ZipEntry {
        /// The entry.
        place: String,
        /// Error of the decompressor.
        #[source]
        source: std::io::Error,
    },
    /// A name in a zip that leaves its folder, or that two entries share.
    #[error("the zip's entry {name:?} is refused: {problem}; pack only plain files under plain names")]
    UnsafeEntry {
        /// The entry's name.
        name: String,
        /// Why it is refused.
        problem: &'static str,
    },
    /// Not exactly one glTF in a zip.
    #[error("the zip must hold one .gltf or .glb, and holds {found}{names}; keep the one to bake")]
    RootCount {
        /// How many it holds.
        found: usize,
        /// The first few, for people.
        names: String,
    },
    /// A URI that points outside the scene's folder, or to the network.
    #[error(
        "{place} points to {uri:?}, which {problem}; keep all files beside or below the glTF, or export as .glb"
    )]
    OutsidePath {
        /// Buffer or image.
        place: String,
        /// The URI in the file.
        uri: String,
        /// Why it is refused.
        problem: &'static str,
    },
    /// A root that does not hold the glTF.
    #[error("the folder {} does not hold the scene {}", root.display(), scene.display())]
    OutsideRoot {
        /// The folder.
        root: PathBuf,
        /// The glTF.
        scene: PathBuf,
    },
    /// A file that the glTF names is not there.
    #[error("{place} needs the file {uri:?}, which is missing{hint}; add it, or export as .glb")]
    MissingFile {
        /// Buffer or image.
        place: String,
        /// The name in the glTF.
        uri: String,
        /// A similar name that exists, if any.
        hint: String,
    },
    /// A `data:` URI that cannot be decoded.
    #[error("the data URI of {place} is broken: {problem}; export the file again")]
    DataUri {
        /// Buffer or image.
        place: String,
        /// The fault.
        problem: String,
    },
    /// A size beyond what is accepted.
    #[error("too many {what}: {found} (at most {limit}); {remedy}")]
    LimitExceeded {
        /// Plural noun.
        what: &'static str,
        /// How many the file has, or the count at which reading stopped.
        found: u64,
        /// How many are accepted.
        limit: u64,
        /// Next step for the user.
        remedy: &'static str,
    },
    /// Light beyond all that shines, which no bake can hold.
    #[error("{place} emits {found:e} W·m⁻²·sr⁻¹ (at most {limit:e}); set a strength that is meant")]
    TooBright {
        /// Material.
        place: String,
        /// Highest of its channels.
        found: f32,
        /// How much is accepted.
        limit: f32,
    },
    /// The file says that it cannot be read without an extension that is not supported.
    #[error("the file requires the extension {name}, which is not supported; {advice}")]
    UnsupportedExtension {
        /// The extension.
        name: String,
        /// Next step for the user.
        advice: &'static str,
    },
    /// An index in the JSON that points to nothing.
    #[error("{place} names {kind} {index}, but the file has {count}; export the file again")]
    MissingReference {
        /// Who names it.
        place: String,
        /// Kind of the thing that it names.
        kind: &'static str,
        /// The index named.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A buffer that is shorter than the JSON says, or has no bytes at all.
    #[error("{place}: {problem}; export the file again")]
    Buffer {
        /// Which buffer.
        place: String,
        /// The fault.
        problem: String,
    },
    /// A mesh or view whose compressed bytes do not decode.
    #[error("{place} cannot be decompressed: {problem}; convert the file with '{UNCOMPRESS}'")]
    Compressed {
        /// Buffer view, or mesh and primitive.
        place: String,
        /// The fault.
        problem: String,
    },
    /// A primitive's attribute or index list that cannot be read.
    #[error("{place}: {problem}; export the file again")]
    Accessor {
        /// Mesh, primitive and attribute.
        place: String,
        /// The fault.
        problem: String,
    },
    /// A vertex index beyond the primitive's vertices.
    #[error(
        "{place}: index {position} is {index}, but the primitive has {vertex_count} vertices; export the file again"
    )]
    IndexOutOfRange {
        /// Mesh and primitive.
        place: String,
        /// Which entry of the index list.
        position: usize,
        /// Its value.
        index: u32,
        /// How many vertices there are.
        vertex_count: usize,
    },
    /// NaN or infinity in a position.
    #[error("{place}: the position of vertex {vertex} is not finite; repair the mesh and export again")]
    NonFinitePosition {
        /// Mesh and primitive, and under which node if the node's transform is the cause.
        place: String,
        /// Which vertex of the primitive.
        vertex: usize,
    },
    /// A node transform with NaN or infinity, at the node or by multiplication down to it.
    #[error("{place}: the transform is not finite; repair it and export again")]
    NonFiniteTransform {
        /// Which node.
        place: String,
    },
    /// A node that is its own ancestor, or has two parents.
    #[error("{place} is reached twice in the scene: nodes must form trees; export the file again")]
    NodeReachedTwice {
        /// Which node.
        place: String,
    },
    /// An image that does not decode.
    #[error("{place} is not a readable image{hint}; replace it with a PNG or JPEG")]
    Image {
        /// Which image.
        place: String,
        /// Format that it looks like instead, if that is known.
        hint: &'static str,
        /// Error of the decoder.
        #[source]
        source: image::ImageError,
    },
    /// Writing the upload's zip failed.
    #[error("cannot pack the scene's files")]
    Pack {
        /// Error of the zip writer.
        #[source]
        source: zip::result::ZipError,
    },
}

impl ImportError {
    /// Another glTF version than 2, with the way to it.
    pub(super) fn version(version: &str) -> Self {
        let advice = if version.starts_with('1') {
            "convert it with 'npx gltf-pipeline -i OLD.gltf -o NEW.glb', or export the scene as glTF 2.0"
        } else {
            "export the scene as glTF 2.0"
        };
        Self::Version { version: shown(version), advice }
    }

    /// A file lies outside of the scene's folder, and would not outside of a wider one.
    pub fn is_of_wider_folder(&self) -> bool {
        matches!(self, Self::OutsidePath { problem, .. } if [uri::LEAVES, pack::LINKS_OUT].contains(problem))
    }
}

/// Writes a file anew without compression of meshes.
const UNCOMPRESS: &str = "npx @gltf-transform/cli copy IN.glb OUT.glb";

/// Longest name shown in a message, in characters.
const MAX_SHOWN_CHARS: usize = 120;

/// A name from the file, cut to a length fit for a message.
pub(super) fn shown(name: &str) -> String {
    if name.chars().count() <= MAX_SHOWN_CHARS {
        return name.to_owned();
    }
    name.chars().take(MAX_SHOWN_CHARS).chain(['…']).collect()
}

/// `kind index ("name")`, as messages call things of the file.
pub(super) fn place_of(kind: &str, index: usize, name: Option<&str>) -> String {
    match name {
        Some(name) => format!("{kind} {index} ({:?})", shown(name)),
        None => format!("{kind} {index}"),
    }
}
