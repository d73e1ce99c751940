//! Materials to draw with, and the emissive ones as lights whose strength can change.

use serde::{Deserialize, Serialize};

use super::{ManifestError, all_finite};
use crate::glass::{Stopped, stopped};

/// A material to draw with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Name.
    pub name: String,
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// Base-colour texture: index into `textures`, and wrap modes of u and v.
    pub base_colour_texture: Option<TextureUse>,
    /// Emitted radiance at emitter scale 1, W·m⁻²·sr⁻¹.
    pub emissive: [f32; 3],
    /// Emissive texture, multiplied in.
    pub emissive_texture: Option<TextureUse>,
    /// Index into `emitters` when it emits.
    pub emitter: Option<u16>,
    /// Texels below this alpha are not drawn.
    pub alpha_cutoff: Option<f32>,
    /// Light passes straight through some of it; left out where none does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub glass: Option<Glass>,
    /// Normal map; left out where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal_map: Option<NormalMap>,
    /// Specular reflection; left out where it reflects as diffuse surfaces do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specular: Option<Specular>,
    /// Drawn from both sides.
    pub double_sided: bool,
}

/// A normal map in tangent space, for pictures; transport knows none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NormalMap {
    /// Texture of linear numbers: rgb are x, y, z from −1 to 1, y towards the texture's upper edge.
    pub texture: TextureUse,
    /// Factor on x and y.
    pub scale: f32,
}

/// Microfacets of a surface, for pictures; transport is diffuse.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Specular {
    /// Share of the surface that is metal, 0 to 1.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1; its square is the width α of the microfacets' slopes.
    pub roughness: f32,
    /// Texture of linear numbers: green is multiplied into `roughness`, blue into `metallic`.
    pub texture: Option<TextureUse>,
}

/// A thin surface that lets a share of the light straight through; [`crate::glass::stopped`] says how much.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Glass {
    /// Alpha is the share of the surface that is there.
    pub blends: bool,
    /// Share of the light on what is there that passes, tinted by the base colour.
    pub transmission: f32,
    /// Texture whose alpha is multiplied into `transmission`.
    pub transmission_texture: Option<TextureUse>,
}

impl Glass {
    /// Light on a point of this base colour and alpha, `transmission_texel` being the texture's alpha there.
    pub fn stopped(&self, [r, g, b, alpha]: [f32; 4], transmission_texel: f32) -> Stopped {
        let there = if self.blends { alpha } else { 1.0 };
        stopped(there, [r, g, b], self.transmission * transmission_texel)
    }
}

/// A texture and how it is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureUse {
    /// Index into the manifest's textures.
    pub texture: u32,
    /// `repeat`, `clamp` or `mirror`, for u and v.
    pub wrap: [Wrap; 2],
    /// 2×3 affine map from the draw's `uv` to this texture's coordinates; `null` when it is the identity.
    pub transform: Option<[[f32; 3]; 2]>,
}

/// Texture wrap modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Wrap {
    /// Repeat.
    Repeat,
    /// Clamp to edge.
    Clamp,
    /// Mirrored repeat.
    Mirror,
}

/// An emissive material as a light whose strength can change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Emitter {
    /// Material's name.
    pub name: String,
    /// Emitting area in m².
    pub area_m2: f64,
}

impl Material {
    pub(super) fn check_numbers(&self) -> Result<(), ManifestError> {
        all_finite("a material's colour", &self.base_colour)?;
        all_finite("a material's emission", &self.emissive)?;
        all_finite("a material's alpha cutoff", self.alpha_cutoff.as_slice())?;
        let glass = self.glass.as_ref();
        all_finite("a material's transmission", glass.map(|glass| glass.transmission).as_slice())?;
        all_finite("a normal map's scale", self.normal_map.as_ref().map(|map| map.scale).as_slice())?;
        if let Some(Specular { metallic, roughness, .. }) = &self.specular {
            all_finite("a material's specular part", &[*metallic, *roughness])?;
        }
        self.textures()
            .flat_map(|texture| &texture.transform)
            .try_for_each(|transform| all_finite("a texture's transform", transform.as_flattened()))
    }

    /// Textures that it reads as colours, with alpha.
    pub fn colour_textures(&self) -> impl Iterator<Item = &TextureUse> {
        let of_glass = self.glass.as_ref().and_then(|glass| glass.transmission_texture.as_ref());
        self.base_colour_texture.iter().chain(&self.emissive_texture).chain(of_glass)
    }

    /// Textures that it reads as linear numbers.
    pub fn number_textures(&self) -> impl Iterator<Item = &TextureUse> {
        let of_specular = self.specular.as_ref().and_then(|specular| specular.texture.as_ref());
        self.normal_map.iter().map(|map| &map.texture).chain(of_specular)
    }

    /// All of its textures.
    pub fn textures(&self) -> impl Iterator<Item = &TextureUse> {
        self.colour_textures().chain(self.number_textures())
    }

    /// All of its textures, to be changed.
    pub fn textures_mut(&mut self) -> impl Iterator<Item = &mut TextureUse> {
        let of_glass = self.glass.as_mut().and_then(|glass| glass.transmission_texture.as_mut());
        let of_specular = self.specular.as_mut().and_then(|specular| specular.texture.as_mut());
        let colours = self.base_colour_texture.iter_mut().chain(&mut self.emissive_texture).chain(of_glass);
        colours.chain(self.normal_map.iter_mut().map(|map| &mut map.texture)).chain(of_specular)
    }
}
