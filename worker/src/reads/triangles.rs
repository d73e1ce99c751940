//! All that a ray reads of a triangle: corners, sides, what passes it, and where it lies in the lightmap. No colour, unless the
//! colour says how much light passes.

use lightkiln_proto::ids::Digest;

use super::marks::{Bytes, Mark};
use crate::emitters::EmitterSet;
use crate::geometry::{Geometry, TriangleRef, corners_of};
use crate::lightmap::World;
use crate::scene::model::{Material, MeshInstance, TextureUse};

/// Materials, images and instances as triangles name them.
pub struct Surfaces<'a> {
    geometry: &'a Geometry,
    images: Vec<Digest>,
    materials: Vec<Mark>,
    paths: Vec<u64>,
}

impl<'a> Surfaces<'a> {
    /// Of a scene.
    pub fn new(geometry: &'a Geometry) -> Self {
        let scene = &geometry.scene;
        let images = scene.images.iter().map(|image| Digest::of(&image.bytes)).collect();
        let paths = scene.instances.iter().map(|of| Digest::of(of.path.as_bytes()).short()).collect();
        let mut surfaces = Self { geometry, images, materials: Vec::new(), paths };
        surfaces.materials = scene.materials.iter().map(|material| surfaces.of_material(material)).collect();
        surfaces
    }

    fn of_material(&self, material: &Material) -> Mark {
        let mut bytes = Bytes::default();
        bytes.number(material.double_sided.into());
        if !is_seen_through(material) {
            return bytes.mark();
        }
        bytes.floats(&material.alpha_cutoff.map_or([-1.0], |cutoff| [cutoff])).floats(&material.base_colour);
        self.texture(&mut bytes, material.base_colour_texture.as_ref());
        if let Some(glass) = &material.glass {
            bytes.number(glass.blends.into()).floats(&[glass.transmission]);
            self.texture(&mut bytes, glass.transmission_texture.as_ref());
        }
        bytes.mark()
    }

    fn texture(&self, bytes: &mut Bytes, texture: Option<&TextureUse>) {
        let Some(TextureUse { image_index, uv_set, uv_transform, wrap }) = texture else {
            bytes.number(0);
            return;
        };
        bytes.bytes(&self.images[*image_index as usize].0).number((*uv_set).into());
        bytes.floats(uv_transform.as_flattened());
        wrap.iter().for_each(|wrap| {
            bytes.number(*wrap as u64);
        });
    }

    /// A triangle as rays meet it.
    pub fn triangle(&self, world: &World, index: u32) -> Mark {
        let reference = self.geometry.triangles[index as usize];
        let instance = &self.geometry.scene.instances[reference.instance as usize];
        let mut bytes = Bytes::default();
        self.identify(&mut bytes, reference);
        corners_of(&self.geometry.scene, reference).iter().for_each(|corner| {
            bytes.vector(*corner);
        });
        if is_seen_through(&self.geometry.scene.materials[instance.material_index as usize]) {
            textured(&mut bytes, instance, reference.triangle);
        }
        for (part, piece) in world.pieces_of(index) {
            bytes.number(part.into());
            piece.uv_texels.iter().for_each(|place| {
                bytes.place(*place);
            });
            let corners = piece.piece_corners.as_deref().map_or(&[][..], |corners| corners);
            bytes.number(corners.len() as u64);
            corners.iter().for_each(|corner| {
                bytes.vector(*corner);
            });
        }
        bytes.mark()
    }

    fn identify(&self, bytes: &mut Bytes, TriangleRef { instance, triangle }: TriangleRef) {
        let material = self.geometry.scene.instances[instance as usize].material_index;
        bytes.number(self.paths[instance as usize]).number(triangle.into());
        bytes.bytes(&self.materials[material as usize]);
    }

    /// All emissive triangles, with their chances and textures: each receiver's samples hang on all of them.
    pub fn emitters(&self, set: &EmitterSet) -> Digest {
        let mut bytes = Bytes::default();
        for (of, chance) in set.chances() {
            let reference = self.geometry.triangles[of.triangle as usize];
            let instance = &self.geometry.scene.instances[reference.instance as usize];
            let material = &self.geometry.scene.materials[instance.material_index as usize];
            self.identify(&mut bytes, reference);
            bytes.number(of.emitter.into()).floats(&[chance]);
            of.corners.iter().for_each(|corner| {
                bytes.vector(*corner);
            });
            self.texture(&mut bytes, material.emissive_texture.as_ref());
            textured(&mut bytes, instance, reference.triangle);
        }
        bytes.digest()
    }
}

/// Its textures and colours tell how much light passes.
fn is_seen_through(material: &Material) -> bool {
    material.alpha_cutoff.is_some() || material.glass.is_some()
}

/// Coordinates and colours of a triangle's corners.
fn textured(bytes: &mut Bytes, instance: &MeshInstance, triangle: u32) {
    for vertex in instance.triangles[triangle as usize].map(|vertex| vertex as usize) {
        for uvs in [&instance.uv0, &instance.uv1] {
            uvs.get(vertex).iter().for_each(|uv| {
                bytes.place(**uv);
            });
        }
        instance.colours.get(vertex).iter().for_each(|colour| {
            bytes.floats(*colour);
        });
    }
}
