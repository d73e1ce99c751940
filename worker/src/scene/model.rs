//! The imported scene, from which every later stage of a bake starts.
//!
//! World space is glTF's: metres, right-handed, y up. Colours are linear Rec.709.

use std::collections::BTreeMap;

use glam::{Mat4, Vec2, Vec3};
use lightkiln_proto::scene::{SceneCamera, SceneLight};
use serde::{Deserialize, Serialize};

use super::core::Core;

/// Shell up to which a scene is near.
const NEAR_SHELL: u32 = 2;

/// A scene ready to bake: flat world-space geometry with materials, textures, lights and cameras.
///
/// Everything is in an order given by the file alone, so the same bytes give the same scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// One entry per (node, mesh primitive) that has triangles.
    pub instances: Vec<MeshInstance>,
    /// Materials; index 0 always exists (glTF's default material is appended when a primitive names none).
    pub materials: Vec<Material>,
    /// Images that materials use, still encoded.
    pub images: Vec<SceneImage>,
    /// KHR_lights_punctual lights, in world space.
    #[serde(with = "super::json_text")]
    pub lights: Vec<SceneLight>,
    /// Cameras, in world space.
    pub cameras: Vec<SceneCamera>,
    /// Where the scene's detail is, if some of it is far beyond that: triangles are then cut at the borders of its shells.
    pub core: Option<Core>,
}

impl Scene {
    /// Lower and upper corner of all vertices in metres; both the origin where there are none.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        let positions = || self.instances.iter().flat_map(|instance| &instance.positions_m);
        let low = positions().copied().reduce(Vec3::min).unwrap_or_default();
        let high = positions().copied().reduce(Vec3::max).unwrap_or_default();
        [low, high]
    }

    /// As [`Scene::bounds_m`], of the part that people see from near: within a few times the size of the core, if it has one.
    pub fn near_bounds_m(&self) -> [Vec3; 2] {
        let [low, high] = self.bounds_m();
        self.core.map_or([low, high], |core| {
            let near = core.bounds_of(NEAR_SHELL.min(core.shells));
            [low.max(near[0]), high.min(near[1])]
        })
    }
}

/// One mesh primitive under one node, transformed to world space.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeshInstance {
    /// Identity that survives edits elsewhere in the file: node names from the root, mesh name, primitive index.
    /// Unique in the scene (repeated names get `#2`, `#3`, … in file order).
    pub path: String,
    /// Index into [`Scene::materials`].
    pub material_index: u32,
    /// World positions in metres.
    pub positions_m: Vec<Vec3>,
    /// Unit world normals, one per vertex; generated flat when the file has none.
    pub normals: Vec<Vec3>,
    /// First UV set (for textures, with the material's own transform not yet applied); empty when absent.
    pub uv0: Vec<Vec2>,
    /// Second UV set, a candidate lightmap unwrap; empty when absent.
    pub uv1: Vec<Vec2>,
    /// Linear vertex colours multiplied into base colour; empty when absent.
    pub colours: Vec<[f32; 4]>,
    /// Triangles, counter-clockwise seen from the front *in world space* (mirrored nodes are already flipped).
    pub triangles: Vec<[u32; 3]>,
    /// Place of the node, for tools that draw handles; positions above already include it.
    pub world_from_object: Mat4,
    /// Where its indirect light comes from, if the file says it.
    pub lit_by: Option<LitBy>,
}

/// Where the indirect light of surfaces comes from, in bakes that have it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LitBy {
    /// Rays of their own texels.
    Texels,
    /// Probes in free space.
    Probes,
    /// Walks through voxels.
    Walks,
}

impl MeshInstance {
    /// Longest side of its bounds in metres; 0 without vertices.
    pub fn size_m(&self) -> f32 {
        let positions = || self.positions_m.iter().copied();
        let low = positions().reduce(Vec3::min).unwrap_or_default();
        let high = positions().reduce(Vec3::max).unwrap_or_default();
        (high - low).max_element()
    }
}

/// A material: all that diffuse transport needs (METHOD.md §1 "Materials and sides"), and what pictures show besides (§2.15).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// The file's name for it, or `material N`.
    pub name: String,
    /// Linear base colour factor; rgb in 0..=1, alpha in 0..=1.
    pub base_colour: [f32; 4],
    /// Base colour texture (sRGB encoded rgb, linear alpha).
    pub base_colour_texture: Option<TextureUse>,
    /// Linear emitted radiance in W·m⁻²·sr⁻¹: emissive factor × KHR_materials_emissive_strength.
    pub emissive: [f32; 3],
    /// Emissive texture (sRGB encoded), multiplied into `emissive`.
    pub emissive_texture: Option<TextureUse>,
    /// `Some(cutoff)` for alphaMode MASK.
    pub alpha_cutoff: Option<f32>,
    /// Light passes straight through some of it.
    pub glass: Option<Glass>,
    /// Normal map, for pictures alone.
    pub normal_map: Option<NormalMap>,
    /// Specular reflection, for pictures alone.
    pub specular: Option<Specular>,
    /// Both sides are lit and have receivers.
    pub double_sided: bool,
}

impl Material {
    /// An opaque, single-sided material without textures, of a linear colour.
    pub fn opaque(name: &str, [red, green, blue]: [f32; 3]) -> Self {
        Self {
            name: name.to_owned(),
            base_colour: [red, green, blue, 1.0],
            base_colour_texture: None,
            emissive: [0.0; 3],
            emissive_texture: None,
            alpha_cutoff: None,
            glass: None,
            normal_map: None,
            specular: None,
            double_sided: false,
        }
    }

    /// The texture whose UV set meshes are drawn with.
    pub fn first_texture(&self) -> Option<&TextureUse> {
        let of_glass = self.glass.as_ref().and_then(|glass| glass.transmission_texture.as_ref());
        let of_normals = self.normal_map.as_ref().map(|map| &map.texture);
        let of_specular = self.specular.as_ref().and_then(|specular| specular.texture.as_ref());
        let colours = self.base_colour_texture.as_ref().or(self.emissive_texture.as_ref()).or(of_glass);
        colours.or(of_normals).or(of_specular)
    }
}

/// A normal map in tangent space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NormalMap {
    /// Texture of linear numbers.
    pub texture: TextureUse,
    /// Factor on the normals' x and y.
    pub scale: f32,
}

/// Microfacets of a surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Specular {
    /// Share that is metal, in 0..=1.
    pub metallic: f32,
    /// Perceptual roughness, in 0..=1.
    pub roughness: f32,
    /// Texture of linear numbers: green is multiplied into `roughness`, blue into `metallic`.
    pub texture: Option<TextureUse>,
}

/// A thin surface that lets a share of the light straight through (METHOD.md §1 "Glass").
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Glass {
    /// Alpha is the share of the surface that is there: alphaMode BLEND.
    pub blends: bool,
    /// Share of the light on what is there that passes, tinted by the base colour, in 0..=1: KHR_materials_transmission.
    pub transmission: f32,
    /// Texture whose alpha is multiplied into `transmission`.
    pub transmission_texture: Option<TextureUse>,
}

/// A material's reading of an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureUse {
    /// Index into [`Scene::images`]; of linear numbers into [`Imported::details`], counted behind them.
    pub image_index: u32,
    /// UV set: 0 or 1 (others are a warning and dropped).
    pub uv_set: u8,
    /// KHR_texture_transform as rows of a 2×3 affine map: `uv' = m · (u, v, 1)`; identity when absent.
    pub uv_transform: [[f32; 3]; 2],
    /// Wrap mode of u and v.
    pub wrap: [Wrap; 2],
}

/// glTF sampler wrap modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    /// Repeat.
    Repeat,
    /// Clamp to edge.
    Clamp,
    /// Mirrored repeat.
    Mirror,
}

/// An image as it stood in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneImage {
    /// Name or URI in the file, for messages.
    pub name: String,
    /// `image/png` or `image/jpeg`.
    pub media_type: String,
    /// Encoded bytes, checked to decode within the limits.
    pub bytes: Vec<u8>,
    /// Size in pixels.
    pub size_px: [u32; 2],
}

/// Something that was not honoured exactly; part of the bake's report.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Warning {
    /// Stable kebab-case name, e.g. `skin-at-rest`.
    pub code: String,
    /// Fault and place, in words.
    pub message: String,
}

/// Result of an import: the scene, and warnings of features that were not honoured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imported {
    /// The scene.
    pub scene: Scene,
    /// Images of normal maps and specular parts, which pictures alone read.
    pub details: Vec<SceneImage>,
    /// Named warnings in file order, each reported once with a count.
    pub warnings: Vec<Warning>,
    /// Counts for reports (`triangles`, `vertices`, `degenerate_triangles`, …).
    pub counts: BTreeMap<String, u64>,
}
