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
    /// Drawn from both sides.
    pub double_sided: bool,
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
        let of_glass = glass.and_then(|glass| glass.transmission_texture.as_ref());
        let uses = self.base_colour_texture.iter().chain(&self.emissive_texture).chain(of_glass);
        uses.flat_map(|texture| &texture.transform)
            .try_for_each(|transform| all_finite("a texture's transform", transform.as_flattened()))
    }
}
