//! State that every step of an import shares: the document, its bytes, the budgets and the warnings.

use gltf::json::Root;

use super::Opening;
use super::buffers::Buffers;
use super::bundle::Bundle;
use super::limits::{self, Budget, Limits};
use super::warnings::Warnings;

/// One import under way.
pub(super) struct Context<'a> {
    pub(super) root: &'a Root,
    pub(super) bundle: &'a Bundle,
    pub(super) buffers: &'a Buffers<'a>,
    pub(super) limits: &'a Limits,
    pub(super) budgets: Budgets,
    pub(super) warnings: Warnings,
    pub(super) opening: Opening,
}

/// Running totals over the whole scene.
pub(super) struct Budgets {
    pub(super) instances: Budget,
    pub(super) triangles: Budget,
    pub(super) vertices: Budget,
    pub(super) sparse_elements: Budget,
    pub(super) path_bytes: Budget,
    pub(super) texture_pixels: Budget,
}

impl Budgets {
    pub(super) fn new(limits: &Limits, upload_bytes: u64) -> Self {
        Self {
            instances: Budget::new(limits::PRIMITIVES, limits.instances),
            triangles: Budget::new(limits::TRIANGLES, limits.triangles),
            vertices: Budget::new(limits::VERTICES, limits.vertices),
            sparse_elements: Budget::new(limits::SPARSE_ELEMENTS, limits.sparse_elements),
            path_bytes: Budget::new(limits::PATH_BYTES, limits.path_bytes),
            texture_pixels: Budget::new(limits::ALL_PIXELS, limits.texture_pixels_of(upload_bytes)),
        }
    }
}
