//! Alpha-masked triangles: rays pass through their holes.

use std::sync::Arc;

use glam::Vec2;

use super::{TriangleRef, weights_of};
use crate::rays::AlphaTest;
use crate::scene::model::{Scene, TextureUse};
use crate::scene::texture::DecodedImages;

/// The test of a scene's masked triangles; `None` when it has none.
pub fn alpha_test(
    scene: &Scene,
    images: &Arc<DecodedImages>,
    triangles: &[TriangleRef],
) -> Option<Box<dyn AlphaTest>> {
    let mut masks =
        Masks { index: Vec::new(), masked: Vec::new(), images: Arc::clone(images), uses: Vec::new() };
    let mut texture_of_material = vec![u32::MAX; scene.materials.len()];
    for (index, material) in scene.materials.iter().enumerate() {
        if let (Some(_), Some(texture)) = (material.alpha_cutoff, &material.base_colour_texture) {
            texture_of_material[index] = masks.uses.len() as u32;
            masks.uses.push(texture.clone());
        }
    }
    masks.index =
        triangles.iter().map(|&triangle| masks.push(scene, &texture_of_material, triangle)).collect();
    if masks.masked.is_empty() { None } else { Some(Box::new(masks)) }
}

/// Alpha-masked triangles with the textures that their test reads.
struct Masks {
    /// Per triangle: index into `masked`, or none.
    index: Vec<u32>,
    masked: Vec<MaskedTriangle>,
    images: Arc<DecodedImages>,
    uses: Vec<TextureUse>,
}

struct MaskedTriangle {
    texture: u32,
    uv: [Vec2; 3],
    factor: [f32; 3],
    cutoff: f32,
}

impl Masks {
    /// Adds a triangle if its material is masked; gives its index or `u32::MAX`.
    fn push(&mut self, scene: &Scene, texture_of_material: &[u32], triangle: TriangleRef) -> u32 {
        let instance = &scene.instances[triangle.instance as usize];
        let material = &scene.materials[instance.material_index as usize];
        let Some(cutoff) = material.alpha_cutoff else { return u32::MAX };
        let texture = texture_of_material[instance.material_index as usize];
        let vertices = instance.triangles[triangle.triangle as usize];
        let uv_set = material.base_colour_texture.as_ref().map_or(0, |texture| texture.uv_set);
        let uvs = if uv_set == 0 { &instance.uv0 } else { &instance.uv1 };
        let uv = vertices.map(|vertex| uvs.get(vertex as usize).copied().unwrap_or_default());
        let colour = |vertex: u32| instance.colours.get(vertex as usize).map_or(1.0, |colour| colour[3]);
        let factor = vertices.map(|vertex| material.base_colour[3] * colour(vertex));
        self.masked.push(MaskedTriangle { texture, uv, factor, cutoff });
        self.masked.len() as u32 - 1
    }
}

impl AlphaTest for Masks {
    fn is_masked(&self, triangle: u32) -> bool {
        self.index[triangle as usize] != u32::MAX
    }

    fn is_solid(&self, triangle: u32, barycentric: [f32; 2]) -> bool {
        let Some(masked) = self.masked.get(self.index[triangle as usize] as usize) else { return true };
        let weights = weights_of(barycentric);
        let factor =
            masked.factor[0] * weights.x + masked.factor[1] * weights.y + masked.factor[2] * weights.z;
        let uv = masked.uv[0] * weights.x + masked.uv[1] * weights.y + masked.uv[2] * weights.z;
        let texture = self.uses.get(masked.texture as usize);
        let alpha = texture.map_or(1.0, |texture| self.images.sample_bilinear(texture, uv.to_array())[3]);
        alpha * factor >= masked.cutoff
    }
}
