//! Triangles that let light through: holes of alpha masks, and glass.

use std::sync::Arc;

use glam::Vec2;
use lightkiln_proto::ids::Digest;

use super::{TriangleRef, weights_of};
use crate::rays::AlphaTest;
use crate::rays::sampling::seed_of;
use crate::scene::model::{Material, MeshInstance, Scene, TextureUse};
use crate::scene::surface::stopped;
use crate::scene::texture::DecodedImages;

/// Marks triangles that stop all light.
const OPAQUE: u32 = u32::MAX;
/// Marks indices into the panes.
const PANE: u32 = 1 << 31;

/// The test of a scene's masked triangles and glass; `None` when it has none.
pub fn alpha_test(
    scene: &Scene,
    images: &Arc<DecodedImages>,
    triangles: &[TriangleRef],
) -> Option<Box<dyn AlphaTest>> {
    let mut masks = Masks {
        index: Vec::new(),
        masked: Vec::new(),
        panes: Vec::new(),
        images: Arc::clone(images),
        materials: scene.materials.clone(),
    };
    masks.index = triangles.iter().map(|&triangle| masks.push(scene, triangle)).collect();
    if masks.masked.is_empty() && masks.panes.is_empty() { None } else { Some(Box::new(masks)) }
}

/// Triangles that let light through, with the textures that their test reads.
struct Masks {
    /// Per triangle: index into `masked`, or with [`PANE`] into `panes`, or [`OPAQUE`].
    index: Vec<u32>,
    masked: Vec<MaskedTriangle>,
    panes: Vec<Pane>,
    images: Arc<DecodedImages>,
    materials: Vec<Material>,
}

struct MaskedTriangle {
    material: u32,
    uv: [Vec2; 3],
    /// Alpha of the vertices' colours.
    alpha: [f32; 3],
}

/// A triangle of glass.
struct Pane {
    material: u32,
    identity: u64,
    base_uv: [Vec2; 3],
    transmission_uv: [Vec2; 3],
    /// The vertices' colours.
    colours: [[f32; 4]; 3],
}

impl Masks {
    /// Adds a triangle if its material lets light through; gives its index or [`OPAQUE`].
    fn push(&mut self, scene: &Scene, triangle: TriangleRef) -> u32 {
        let instance = &scene.instances[triangle.instance as usize];
        let material = instance.material_index;
        let Material { base_colour_texture, alpha_cutoff, glass, .. } = &scene.materials[material as usize];
        let vertices = instance.triangles[triangle.triangle as usize];
        let base_uv = uvs(instance, vertices, base_colour_texture.as_ref());
        let colours =
            vertices.map(|vertex| instance.colours.get(vertex as usize).copied().unwrap_or([1.0; 4]));
        if let Some(glass) = glass {
            let transmission_uv = uvs(instance, vertices, glass.transmission_texture.as_ref());
            let of_instance = Digest::of(instance.path.as_bytes()).short();
            let identity = seed_of(&[of_instance, triangle.triangle.into()]);
            self.panes.push(Pane { material, identity, base_uv, transmission_uv, colours });
            return (self.panes.len() as u32 - 1) | PANE;
        }
        if alpha_cutoff.is_none() {
            return OPAQUE;
        }
        let alpha = colours.map(|colour| colour[3]);
        self.masked.push(MaskedTriangle { material, uv: base_uv, alpha });
        self.masked.len() as u32 - 1
    }

    /// A texture at the corners' coordinates; white without one.
    fn sample(&self, texture: Option<&TextureUse>, uv: &[Vec2; 3], weights: [f32; 3]) -> [f32; 4] {
        let at = |texture| {
            let uv = uv[0] * weights[0] + uv[1] * weights[1] + uv[2] * weights[2];
            self.images.sample_bilinear(texture, uv.to_array())
        };
        texture.map_or([1.0; 4], at)
    }

    fn stopped_by_mask(&self, masked: &MaskedTriangle, weights: [f32; 3]) -> f32 {
        let material = &self.materials[masked.material as usize];
        let texel = self.sample(material.base_colour_texture.as_ref(), &masked.uv, weights);
        let alpha = material.base_colour[3] * mixed(masked.alpha, weights) * texel[3];
        stopped(material, [0.0, 0.0, 0.0, alpha], 0.0).share
    }

    fn stopped_by_pane(&self, pane: &Pane, weights: [f32; 3]) -> f32 {
        let material = &self.materials[pane.material as usize];
        let Some(glass) = &material.glass else { return 1.0 };
        let base = self.sample(material.base_colour_texture.as_ref(), &pane.base_uv, weights);
        let colour = [0, 1, 2, 3].map(|channel| {
            let vertices = pane.colours.map(|colour| colour[channel]);
            material.base_colour[channel] * base[channel] * mixed(vertices, weights)
        });
        let texture = glass.transmission_texture.as_ref();
        let transmission = glass.transmission * self.sample(texture, &pane.transmission_uv, weights)[3];
        stopped(material, colour, transmission).share
    }
}

impl AlphaTest for Masks {
    fn is_masked(&self, triangle: u32) -> bool {
        self.index[triangle as usize] != OPAQUE
    }

    fn stopped(&self, triangle: u32, barycentric: [f32; 2]) -> f32 {
        let weights = weights_of(barycentric).to_array();
        match self.index[triangle as usize] {
            OPAQUE => 1.0,
            index if index & PANE != 0 => {
                self.stopped_by_pane(&self.panes[(index & !PANE) as usize], weights)
            }
            index => self.stopped_by_mask(&self.masked[index as usize], weights),
        }
    }

    fn identity(&self, triangle: u32) -> u64 {
        match self.index[triangle as usize] {
            index if index != OPAQUE && index & PANE != 0 => self.panes[(index & !PANE) as usize].identity,
            // Masks stop all light or none.
            _ => triangle.into(),
        }
    }
}

/// Coordinates of a triangle's corners for a texture; the origin where the mesh has none.
fn uvs(instance: &MeshInstance, vertices: [u32; 3], texture: Option<&TextureUse>) -> [Vec2; 3] {
    let uvs = match texture {
        Some(texture) if texture.uv_set != 0 => &instance.uv1,
        _ => &instance.uv0,
    };
    vertices.map(|vertex| uvs.get(vertex as usize).copied().unwrap_or_default())
}

fn mixed(corners: [f32; 3], weights: [f32; 3]) -> f32 {
    corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2]
}
