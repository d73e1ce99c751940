//! A scene with an object put into it, for references of pictures and light.

use glam::{Affine3A, Mat3};

use super::model::{Material, MeshInstance, Scene};

impl Scene {
    /// The scene with all surfaces of another one at a place of uniform scale; its lights and cameras are left behind, and so are details of
    /// surfaces that transport does not know.
    #[must_use]
    pub fn with_object(mut self, object: &Self, place: &Affine3A) -> Self {
        let [first_image, first_material] =
            [self.images.len(), self.materials.len()].map(|count| count as u32);
        self.images.extend(object.images.iter().cloned());
        self.materials.extend(object.materials.iter().map(|material| shifted(material, first_image)));
        let turn = Mat3::from(place.matrix3);
        let turn = turn * turn.x_axis.length().max(f32::MIN_POSITIVE).recip();
        for instance in &object.instances {
            self.instances.push(MeshInstance {
                path: format!("object/{}", instance.path),
                material_index: instance.material_index + first_material,
                positions_m: instance.positions_m.iter().map(|at| place.transform_point3(*at)).collect(),
                normals: instance.normals.iter().map(|normal| turn * *normal).collect(),
                ..instance.clone()
            });
        }
        self
    }
}

/// A material whose images come `first` later.
fn shifted(material: &Material, first: u32) -> Material {
    let mut shifted = Material { normal_map: None, specular: None, ..material.clone() };
    let textures = [&mut shifted.base_colour_texture, &mut shifted.emissive_texture];
    let of_glass = shifted.glass.as_mut().and_then(|glass| glass.transmission_texture.as_mut());
    textures.into_iter().flatten().chain(of_glass).for_each(|used| used.image_index += first);
    shifted
}
