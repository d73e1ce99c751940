//! Emissive triangles, and light straight from them: irradiance at receivers, coefficients at points in free space.
//!
//! The list of triangles is the reference's too; each chooses among them by chances of its own.

mod irradiance;
mod sphere;

use glam::Vec3;

use crate::geometry::Geometry;
use crate::scene::model::Scene;
use crate::scene::surface::{Footprint, surface_at};

pub use irradiance::{EmitterIrradianceSum, EmitterSet, Radiance};
pub use sphere::EmitterSphereSum;

/// An emissive triangle.
#[derive(Clone, Copy, Debug)]
pub struct EmissiveTriangle {
    /// Triangle through all instances.
    pub triangle: u32,
    /// Emitter of its material.
    pub emitter: u16,
    /// Corners in metres.
    pub corners: [Vec3; 3],
    /// Unit normal of its front.
    pub normal: Vec3,
    /// Area.
    pub area_m2: f32,
    /// Both sides shine.
    pub double_sided: bool,
    /// Mean radiance over it, as its texture has it; W·m⁻²·sr⁻¹.
    pub mean_radiance: [f32; 3],
    /// Mean of what its texture makes of its material's radiance.
    pub mean_glow: [f32; 3],
    /// Radiance that a texture may hold at most, wherever it is bright.
    pub factor: [f32; 3],
}

/// Radiance that each emitter's texture is multiplied by: W·m⁻²·sr⁻¹.
pub fn radiance_of_emitters(scene: &Scene) -> Vec<[f32; 3]> {
    let emissive = scene.materials.iter().map(|material| material.emissive);
    emitter_of_material(scene)
        .iter()
        .zip(emissive)
        .filter(|(emitter, _)| emitter.is_some())
        .map(|(_, of)| of)
        .collect()
}

/// Emitter of each material: emissive materials counted in order.
pub fn emitter_of_material(scene: &Scene) -> Vec<Option<u16>> {
    let mut next = 0;
    let number = |emissive: [f32; 3]| {
        let emits = emissive.iter().any(|channel| *channel > 0.0) && next < u16::MAX;
        emits.then(|| {
            next += 1;
            next - 1
        })
    };
    scene.materials.iter().map(|material| material.emissive).map(number).collect()
}

/// All emissive triangles, ascending.
pub fn emissive_triangles(geometry: &Geometry) -> Vec<EmissiveTriangle> {
    let Geometry { scene, images, .. } = geometry;
    let emitters = emitter_of_material(scene);
    let mut found = Vec::new();
    for (index, reference) in geometry.triangles.iter().enumerate() {
        let instance = &scene.instances[reference.instance as usize];
        let Some(emitter) = emitters[instance.material_index as usize] else { continue };
        let material = &scene.materials[instance.material_index as usize];
        let corners = geometry.corners(index as u32);
        let scaled = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let area_m2 = scaled.length() * 0.5;
        let (of_instance, local) = (reference.instance as usize, reference.triangle as usize);
        let footprint = Footprint::square(instance, local, area_m2.sqrt());
        let mean = surface_at(scene, images, of_instance, local, [1.0 / 3.0; 3], &footprint);
        found.push(EmissiveTriangle {
            triangle: index as u32,
            emitter,
            corners,
            normal: scaled.normalize_or(Vec3::Y),
            area_m2,
            double_sided: material.double_sided,
            mean_radiance: mean.emission,
            mean_glow: mean.glow,
            factor: material.emissive,
        });
    }
    found
}
