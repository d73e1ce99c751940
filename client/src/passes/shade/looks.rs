//! Looks of draws as the shaders read them.

use lightkiln_proto::manifest::{Material, TextureUse};

use crate::passes::meshes::uv_rows;
use crate::scene::{LoadedDraw, LoadedScene, Tints};

/// Look of a draw; twin of `ShadeDraw` in the shader.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct ShadeDraw {
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// Emitted radiance times the emitter's scale.
    pub emissive: [f32; 4],
    /// Map from uv to the base-colour texture's coordinates.
    pub base_row0: [f32; 4],
    /// Second row.
    pub base_row1: [f32; 4],
    /// Map from uv to the emissive texture's coordinates.
    pub emissive_row0: [f32; 4],
    /// Second row.
    pub emissive_row1: [f32; 4],
    /// Map from uv to the transmission texture's coordinates.
    pub transmission_row0: [f32; 4],
    /// Second row.
    pub transmission_row1: [f32; 4],
    /// Map from uv to the normal map's coordinates.
    pub normal_row0: [f32; 4],
    /// Second row.
    pub normal_row1: [f32; 4],
    /// Map from uv to the metallic-roughness texture's coordinates.
    pub specular_row0: [f32; 4],
    /// Second row.
    pub specular_row1: [f32; 4],
    /// Alpha below it is not drawn.
    pub cutoff: f32,
    /// Number of the draw.
    pub index: u32,
    /// Share of light that passes what is there, tinted by the base colour.
    pub transmission: f32,
    /// 1 where alpha is the share that is there.
    pub blends: f32,
    /// Factor on x and y of the normal map's normals.
    pub normal_scale: f32,
    /// 1 where there is a normal map.
    pub has_normals: f32,
    /// Share of metal.
    pub metallic: f32,
    /// Below 0 where all reflection is diffuse.
    pub roughness: f32,
}

/// Textures of a material, each with its sampler.
pub(super) const MATERIAL_TEXTURES: usize = 5;

/// Textures of a material in the order of their bindings.
pub(super) fn textures_of(material: &Material) -> [Option<&TextureUse>; MATERIAL_TEXTURES] {
    [
        material.base_colour_texture.as_ref(),
        material.emissive_texture.as_ref(),
        material.glass.as_ref().and_then(|glass| glass.transmission_texture.as_ref()),
        material.normal_map.as_ref().map(|map| &map.texture),
        material.specular.as_ref().and_then(|specular| specular.texture.as_ref()),
    ]
}

/// Overrides of the shader: it holds maps and gloss only where a material of the scene, or of its objects, has such.
pub fn details_of(materials: &[Material]) -> [(&'static str, f64); 2] {
    let any = |has: fn(&Material) -> bool| f64::from(u8::from(materials.iter().any(has)));
    [
        ("HAS_MAPS", any(|material| material.normal_map.is_some())),
        ("HAS_GLOSS", any(|material| material.specular.is_some())),
    ]
}

/// Looks of all draws.
pub(super) fn looks(scene: &LoadedScene, tints: &Tints, emitter_scale: &[f32]) -> Vec<ShadeDraw> {
    let draws = scene.draws.draws.iter().zip(0..);
    draws.map(|(draw, index)| shade_draw((scene, tints), draw, index, emitter_scale)).collect()
}

fn shade_draw(
    (scene, tints): (&LoadedScene, &Tints),
    draw: &LoadedDraw,
    index: u32,
    emitter_scale: &[f32],
) -> ShadeDraw {
    let material = &scene.manifest.materials[draw.material as usize];
    let scale =
        material.emitter.and_then(|emitter| emitter_scale.get(usize::from(emitter))).copied().unwrap_or(1.0);
    let [
        [base_row0, base_row1],
        [emissive_row0, emissive_row1],
        [transmission_row0, transmission_row1],
        [normal_row0, normal_row1],
        [specular_row0, specular_row1],
    ] = textures_of(material).map(uv_rows);
    let (glass, normals) = (material.glass.as_ref(), material.normal_map.as_ref());
    let specular = material.specular.as_ref();
    let [r, g, b] = material.emissive.map(|channel| channel * scale);
    ShadeDraw {
        base_colour: tints.base_colour(scene, draw.material),
        emissive: [r, g, b, 0.0],
        base_row0,
        base_row1,
        emissive_row0,
        emissive_row1,
        transmission_row0,
        transmission_row1,
        normal_row0,
        normal_row1,
        specular_row0,
        specular_row1,
        cutoff: material.alpha_cutoff.unwrap_or(-1.0),
        index,
        transmission: glass.map_or(0.0, |glass| glass.transmission),
        blends: f32::from(u8::from(glass.is_some_and(|glass| glass.blends))),
        normal_scale: normals.map_or(0.0, |map| map.scale),
        has_normals: f32::from(u8::from(normals.is_some())),
        metallic: specular.map_or(0.0, |specular| specular.metallic),
        roughness: specular.map_or(-1.0, |specular| specular.roughness),
    }
}
