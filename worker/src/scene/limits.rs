//! Highest costs of an import: every size that a file can state is compared with one of these first.

use super::error::{ImportError, Result};

/// Bounds on the size of an upload and of the scene in it.
///
/// Higher → bigger scenes are taken, and a hostile file can cost more memory and time; lower → the reverse.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of the upload itself, and of each file read while packing one.
    pub bundle_bytes: u64,
    /// Bytes of all files of a zip together once decompressed.
    pub decompressed_bytes: u64,
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
    /// Bytes of all instance paths together.
    pub path_bytes: u64,
    /// Pixels of one texture.
    pub texture_pixels_each: u64,
    /// Pixels of all textures together.
    pub texture_pixels_total: u64,
}

impl Default for Limits {
    /// Room for scenes about ten times the size of what one machine bakes in an hour.
    fn default() -> Self {
        Self {
            bundle_bytes: 2 << 30,
            decompressed_bytes: 4 << 30,
            files: 4096,
            path_depth: 32,
            json_bytes: 512 << 20,
            json_objects: 4_000_000,
            json_values: 32_000_000,
            nodes: 1_000_000,
            node_depth: 256,
            instances: 1_000_000,
            triangles: 20_000_000,
            vertices: 60_000_000,
            sparse_elements: 60_000_000,
            path_bytes: 256 << 20,
            texture_pixels_each: 16_384 * 16_384,
            texture_pixels_total: 1 << 30,
        }
    }
}

/// A running total that may not pass a limit.
#[derive(Clone, Debug)]
pub(super) struct Budget {
    what: &'static str,
    used: u64,
    limit: u64,
}

impl Budget {
    /// An empty total of `what` (a plural noun for messages) under `limit`.
    pub(super) fn new(what: &'static str, limit: u64) -> Self {
        Self { what, used: 0, limit }
    }

    /// Adds `count`, or says that the limit is passed. Call it before allocating or looping over `count`.
    pub(super) fn spend(&mut self, count: u64) -> Result<()> {
        self.used = self.used.saturating_add(count);
        within(self.what, self.used, self.limit)
    }

    /// Bytes spent.
    pub(super) fn used(&self) -> u64 {
        self.used
    }
}

/// Checks one stated size against its limit.
pub(super) fn within(what: &'static str, found: u64, limit: u64) -> Result<()> {
    if found > limit { Err(ImportError::LimitExceeded { what, found, limit }) } else { Ok(()) }
}
