//! Highest costs of an import: every size that a file can state is compared with one of these first.

use super::error::{ImportError, Result};

/// Bounds on the size of an upload and of the scene in it.
///
/// Higher → bigger scenes are taken, and a hostile file can cost more memory and time; lower → the reverse.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of the upload itself, and of each file read while packing one.
    pub bundle_bytes: u64,
    /// Bytes of all files of a zip together once decompressed, however big the zip is.
    pub decompressed_bytes: u64,
    /// Bytes that any zip may decompress to.
    pub expansion_free_bytes: u64,
    /// Bytes beyond them for each byte of the zip. Meshes and textures deflate two to twenty times; zeros a thousand times.
    pub expansion_max: u64,
    /// Files in a zip.
    pub files: u64,
    /// Folders above a file in a zip.
    pub path_depth: u64,
    /// Bytes of the glTF's JSON; data URIs count.
    pub json_bytes: u64,
    /// Objects (`{`) in the JSON: each costs up to some hundred bytes in memory for two in the file.
    pub json_objects: u64,
    /// Values in the JSON, counted by its commas and colons.
    pub json_values: u64,
    /// Bytes in memory of the JSON's lists once they are read.
    pub json_tree_bytes: u64,
    /// Nodes in the glTF.
    pub nodes: u64,
    /// Nodes from a root down to a leaf.
    pub node_depth: u64,
    /// Pairs of node and mesh primitive, whether or not they have triangles.
    pub instances: u64,
    /// Triangles over all instances.
    pub triangles: u64,
    /// Vertices over all instances, after flat normals have split shared ones.
    pub vertices: u64,
    /// Elements replaced by sparse accessors, counted each time one is read.
    pub sparse_elements: u64,
    /// Elements of an accessor without bytes: all are zero but for those that a sparse one replaces.
    pub zero_elements: u64,
    /// Bytes of all instance paths together.
    pub path_bytes: u64,
    /// Bytes of all meshes together once decompressed (Draco, meshopt).
    pub decoded_bytes: u64,
    /// Pixels of one texture.
    pub texture_pixels_each: u64,
    /// Pixels of all textures together, however big the upload is.
    pub texture_pixels_total: u64,
    /// Pixels of textures that any upload may have.
    pub texture_pixels_free: u64,
    /// Pixels beyond them for each byte of the upload. Photographs take one to ten; a plain colour a thousand.
    pub pixels_per_byte: u64,
}

impl Default for Limits {
    /// Room for scenes about ten times the size of what one machine bakes in an hour.
    fn default() -> Self {
        Self {
            bundle_bytes: 2 << 30,
            decompressed_bytes: 4 << 30,
            expansion_free_bytes: 128 << 20,
            expansion_max: 32,
            files: 4096,
            path_depth: 32,
            json_bytes: 512 << 20,
            json_objects: 4_000_000,
            json_values: 32_000_000,
            json_tree_bytes: 512 << 20,
            nodes: 1_000_000,
            node_depth: 256,
            instances: 1_000_000,
            triangles: 20_000_000,
            vertices: 60_000_000,
            sparse_elements: 60_000_000,
            zero_elements: 1 << 20,
            path_bytes: 256 << 20,
            decoded_bytes: 1 << 30,
            texture_pixels_each: 16_384 * 16_384,
            texture_pixels_total: 1 << 30,
            texture_pixels_free: 1 << 27,
            pixels_per_byte: 64,
        }
    }
}

impl Limits {
    /// Bytes that a zip of `zip_bytes` may decompress to.
    pub(super) fn decompressed_bytes_of(&self, zip_bytes: u64) -> u64 {
        let expanded = self.expansion_free_bytes.saturating_add(zip_bytes.saturating_mul(self.expansion_max));
        expanded.min(self.decompressed_bytes)
    }

    /// Pixels that the textures of an upload of so many bytes may have.
    pub(super) fn texture_pixels_of(&self, upload_bytes: u64) -> u64 {
        let likely =
            self.texture_pixels_free.saturating_add(upload_bytes.saturating_mul(self.pixels_per_byte));
        likely.min(self.texture_pixels_total)
    }
}

/// A thing that is counted against a limit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counted {
    /// Plural noun.
    what: &'static str,
    /// Next step for whoever has too many.
    remedy: &'static str,
}

/// A big scene.
const SPLIT: &str = "split or simplify the scene";
/// Textures of more detail than light has.
const SMALLER_TEXTURES: &str = "make its textures smaller";
/// JSON with nothing of a scene in it, or a tool at fault.
const JSON_ADVICE: &str = "export as .glb, without extras and unused objects";
/// More in the zip than belongs to the scene.
const ZIP_ADVICE: &str = "pack only the glTF and the files that it names";
/// More than the upload's size makes likely, or a bomb.
const EXPANSION_ADVICE: &str =
    "if these are the scene's, pack it without compression (zip -0), else make it anew";

pub(super) const UPLOAD_BYTES: Counted = Counted { what: "bytes to upload", remedy: SPLIT };
pub(super) const UPLOAD_FILES: Counted = Counted { what: "files to upload", remedy: "export as .glb" };
pub(super) const JSON_BYTES: Counted = Counted { what: "bytes of JSON", remedy: JSON_ADVICE };
pub(super) const JSON_OBJECTS: Counted = Counted { what: "objects in the JSON", remedy: JSON_ADVICE };
pub(super) const JSON_VALUES: Counted = Counted { what: "values in the JSON", remedy: JSON_ADVICE };
pub(super) const JSON_TREE: Counted =
    Counted { what: "bytes of objects in the JSON's lists", remedy: JSON_ADVICE };
pub(super) const NODES: Counted = Counted { what: "nodes", remedy: SPLIT };
pub(super) const NODE_LEVELS: Counted =
    Counted { what: "levels of nodes", remedy: "flatten the node hierarchy" };
pub(super) const PRIMITIVES: Counted = Counted { what: "mesh primitives in the scene", remedy: SPLIT };
pub(super) const TRIANGLES: Counted = Counted { what: "triangles", remedy: SPLIT };
pub(super) const VERTICES: Counted = Counted { what: "vertices", remedy: SPLIT };
pub(super) const SPARSE_ELEMENTS: Counted =
    Counted { what: "sparse accessor elements", remedy: "export the scene without sparse accessors" };
pub(super) const ZERO_ELEMENTS: Counted = Counted {
    what: "elements in an accessor without bytes",
    remedy: "export the scene with all its vertices",
};
pub(super) const PATH_BYTES: Counted =
    Counted { what: "bytes of node paths", remedy: "flatten the node hierarchy or shorten its names" };
pub(super) const TEXTURE_PIXELS: Counted = Counted { what: "pixels in a texture", remedy: SMALLER_TEXTURES };
pub(super) const ALL_PIXELS: Counted = Counted { what: "pixels in all textures", remedy: SMALLER_TEXTURES };
pub(super) const DECODED_BYTES: Counted = Counted { what: "bytes of decompressed meshes", remedy: SPLIT };
pub(super) const ZIP_FILES: Counted = Counted { what: "files in the zip", remedy: ZIP_ADVICE };
pub(super) const ZIP_FOLDERS: Counted = Counted { what: "nested folders in the zip", remedy: ZIP_ADVICE };
pub(super) const ZIP_BYTES: Counted =
    Counted { what: "bytes in the zip once decompressed", remedy: EXPANSION_ADVICE };

/// A running total that may not pass a limit.
#[derive(Clone, Debug)]
pub(super) struct Budget {
    of: Counted,
    used: u64,
    limit: u64,
}

impl Budget {
    /// An empty total under `limit`.
    pub(super) fn new(of: Counted, limit: u64) -> Self {
        Self { of, used: 0, limit }
    }

    /// Adds `count`, or says that the limit is passed. Call it before allocating or looping over `count`.
    pub(super) fn spend(&mut self, count: u64) -> Result<()> {
        self.used = self.used.saturating_add(count);
        within(self.of, self.used, self.limit)
    }

    /// What may still be spent.
    pub(super) fn left(&self) -> u64 {
        self.limit.saturating_sub(self.used)
    }
}

/// Checks one stated size against its limit.
pub(super) fn within(of: Counted, found: u64, limit: u64) -> Result<()> {
    let Counted { what, remedy } = of;
    if found > limit { Err(ImportError::LimitExceeded { what, found, limit, remedy }) } else { Ok(()) }
}
