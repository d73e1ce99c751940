//! Voxels of a bake under some lights.

use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::voxels::{VoxelTable, WalkLight};
use lightkiln_proto::relight::PatchTable;

/// Voxels, and λ after the last bounce.
#[derive(Debug)]
pub struct SettledWalks<'a> {
    /// Elements.
    pub voxels: &'a VoxelTable,
    /// Patches that they name.
    pub patches: &'a PatchTable,
    /// λ.
    pub lambda: Vec<Vec4>,
    /// Radiance of each emitter, W·m⁻²·sr⁻¹.
    pub emitters: Vec<Vec3>,
}

impl SettledWalks<'_> {
    /// Light of the elements.
    pub fn light(&self) -> WalkLight<'_> {
        let emitter = |emitter: u16| self.emitters.get(usize::from(emitter)).copied().unwrap_or_default();
        WalkLight::new(self.voxels, self.patches, &self.lambda, emitter)
    }
}
