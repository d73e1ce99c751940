//! Voxels of a bake under some lights.

use glam::{Vec3, Vec4};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::PatchTable;
use lightkiln_proto::voxels::{VoxelTable, WalkLight};

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

/// Radiance of each emitter of a bake in W·m⁻²·sr⁻¹, before its texture, from one factor each; 1 where absent.
pub fn emitter_radiance(manifest: &Manifest, emitter_scale: &[f32]) -> Vec<Vec3> {
    let mut emitters = vec![Vec3::ZERO; manifest.emitters.len()];
    for material in &manifest.materials {
        let Some(emitter) = material.emitter.map(usize::from) else { continue };
        let scale = emitter_scale.get(emitter).copied().unwrap_or(1.0);
        if let Some(radiance) = emitters.get_mut(emitter) {
            *radiance = Vec3::from(material.emissive) * scale;
        }
    }
    emitters
}

impl SettledWalks<'_> {
    /// Light of the elements.
    pub fn light(&self) -> WalkLight<'_> {
        let emitter = |emitter: u16| self.emitters.get(usize::from(emitter)).copied().unwrap_or_default();
        WalkLight::new(self.voxels, self.patches, &self.lambda, emitter)
    }

    /// Likewise, of emitters what remains without such a share of each.
    pub fn light_without(&self, shares: &[f32]) -> WalkLight<'_> {
        let emitter = |emitter: u16| {
            let emitter = usize::from(emitter);
            let share = shares.get(emitter).copied().unwrap_or_default();
            self.emitters.get(emitter).copied().unwrap_or_default() * (1.0 - share)
        };
        WalkLight::new(self.voxels, self.patches, &self.lambda, emitter)
    }
}
