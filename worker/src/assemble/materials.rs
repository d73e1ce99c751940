//! Materials and emitters as the manifest states them.

use lightkiln_proto::manifest::{Emitter, Glass, Material, NormalMap, Specular, TextureUse, Wrap};

use crate::emitters::emitter_of_material;
use crate::geometry::{TriangleRef, corners_of};
use crate::scene::model::{self, Scene};

/// Materials in the scene's order, and an emitter for each emissive one.
pub fn materials(scene: &Scene) -> (Vec<Material>, Vec<Emitter>) {
    let emitter_of = emitter_of_material(scene);
    let areas = areas_m2(scene);
    let materials = scene.materials.iter().zip(&emitter_of).map(|(material, emitter)| Material {
        name: material.name.clone(),
        base_colour: material.base_colour,
        base_colour_texture: material.base_colour_texture.as_ref().map(|texture| texture_use(texture, None)),
        emissive: material.emissive,
        emissive_texture: beside_base(material, material.emissive_texture.as_ref()),
        emitter: *emitter,
        alpha_cutoff: material.alpha_cutoff,
        glass: material.glass.as_ref().map(|glass| Glass {
            blends: glass.blends,
            transmission: glass.transmission,
            transmission_texture: beside_base(material, glass.transmission_texture.as_ref()),
        }),
        normal_map: material.normal_map.as_ref().and_then(|map| {
            let texture = beside_base(material, Some(&map.texture))?;
            Some(NormalMap { texture, scale: map.scale })
        }),
        specular: material.specular.as_ref().map(|specular| Specular {
            metallic: specular.metallic,
            roughness: specular.roughness,
            texture: beside_base(material, specular.texture.as_ref()),
        }),
        double_sided: material.double_sided,
    });
    let emitters = scene
        .materials
        .iter()
        .zip(&emitter_of)
        .zip(&areas)
        .filter(|((_, emitter), _)| emitter.is_some())
        .map(|((material, _), area_m2)| Emitter { name: material.name.clone(), area_m2: *area_m2 })
        .collect();
    (materials.collect(), emitters)
}

/// Area of each material's triangles in m².
fn areas_m2(scene: &Scene) -> Vec<f64> {
    let mut areas = vec![0.0; scene.materials.len()];
    for (index, instance) in scene.instances.iter().enumerate() {
        for triangle in 0..instance.triangles.len() as u32 {
            let [a, b, c] = corners_of(scene, TriangleRef { instance: index as u32, triangle });
            areas[instance.material_index as usize] += 0.5 * f64::from((b - a).cross(c - a).length());
        }
    }
    areas
}

fn texture_use(texture: &model::TextureUse, transform: Option<[[f32; 3]; 2]>) -> TextureUse {
    let wrap = |wrap| match wrap {
        model::Wrap::Repeat => Wrap::Repeat,
        model::Wrap::Clamp => Wrap::Clamp,
        model::Wrap::Mirror => Wrap::Mirror,
    };
    TextureUse { texture: texture.image_index, wrap: texture.wrap.map(wrap), transform }
}

/// A texture relative to the draw's UV, which has the base colour's transform folded in. One that reads another UV set than
/// the draw's has no coordinates in it and is left to the factor.
fn beside_base(material: &model::Material, texture: Option<&model::TextureUse>) -> Option<TextureUse> {
    let texture = texture?;
    let own = texture.uv_transform;
    if material.first_texture().is_some_and(|first| first.uv_set != texture.uv_set) {
        return None;
    }
    let relative = match &material.base_colour_texture {
        None => own,
        Some(base) => after_inverse(own, base.uv_transform)?,
    };
    const IDENTITY: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    Some(texture_use(texture, (relative != IDENTITY).then_some(relative)))
}

/// `outer ∘ base⁻¹` of affine maps; `None` where `base` is singular.
fn after_inverse(outer: [[f32; 3]; 2], base: [[f32; 3]; 2]) -> Option<[[f32; 3]; 2]> {
    if outer == base {
        return Some([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    }
    let [[a, b, c], [d, e, f]] = base.map(|row| row.map(f64::from));
    let determinant = a * e - b * d;
    if determinant == 0.0 {
        return None;
    }
    let inverse = [
        [e / determinant, -b / determinant, (b * f - c * e) / determinant],
        [-d / determinant, a / determinant, (c * d - a * f) / determinant],
    ];
    let apply = |row: [f32; 3]| {
        let [x, y, z] = row.map(f64::from);
        [0, 1, 2].map(|i| (x * inverse[0][i] + y * inverse[1][i] + if i == 2 { z } else { 0.0 }) as f32)
    };
    Some(outer.map(apply))
}
