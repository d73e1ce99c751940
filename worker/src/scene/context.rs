//! State that every step of an import shares: the document, its bytes, the budgets and the warnings.

use gltf::json::Root;

use super::buffers::Buffers;
use super::bundle::Bundle;
use super::limits::{Budget, Limits};
use super::warnings::Warnings;

/// One import under way.
pub(super) struct Context<'a> {
    pub(super) root: &'a Root,
    pub(super) bundle: &'a Bundle,
    pub(super) buffers: &'a Buffers<'a>,
    pub(super) limits: &'a Limits,
    pub(super) budgets: Budgets,
    pub(super) warnings: Warnings,
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
    pub(super) fn new(limits: &Limits) -> Self {
        Self {
            instances: Budget::new("mesh primitives in the scene", limits.instances),
            triangles: Budget::new("triangles", limits.triangles),
            vertices: Budget::new("vertices", limits.vertices),
            sparse_elements: Budget::new("sparse accessor elements", limits.sparse_elements),
            path_bytes: Budget::new("bytes of node paths", limits.path_bytes),
            texture_pixels: Budget::new("pixels in all textures", limits.texture_pixels_total),
        }
    }
}
