//! Glass: materials that let a share of the light straight through, by alphaMode BLEND or KHR_materials_transmission
//! (METHOD.md §1).

use std::io::Cursor;

use gltf::json::material::AlphaMode;
use gltf::json::validation::Checked;
use image::{ImageFormat, RgbaImage};

use super::context::Context;
use super::error::{ImportError, Result};
use super::images::decode;
use super::materials::{MaterialTable, Named, Reading};
use super::model::{Glass, SceneImage};

/// Difference of channels from which on a tint is told apart from grey.
const GREY_MAX: f32 = 0.02;

/// The glass of a material; `None` where all light is stopped, or met by a mask.
pub(super) fn glass_of(
    table: &mut MaterialTable,
    context: &mut Context<'_>,
    stated: &gltf::json::Material,
    place: &dyn Fn() -> String,
) -> Result<Option<Glass>> {
    let blends = stated.alpha_mode == Checked::Valid(AlphaMode::Blend);
    let extension = stated.extensions.as_ref().and_then(|extensions| extensions.transmission.as_ref());
    let factor = extension.map_or(0.0, |extension| extension.transmission_factor.0);
    let transmission = factor.clamp(0.0, 1.0) * dielectric_share(stated);
    let texture = extension.and_then(|extension| extension.transmission_texture.as_ref());
    let read = (texture.filter(|_| transmission > 0.0).map(Named::of), Reading::Red);
    let transmission_texture = table.read_texture(context, read, place)?;
    let [r, g, b, _] = stated.pbr_metallic_roughness.base_color_factor.0;
    if transmission > 0.0 && r.max(g).max(b) - r.min(g).min(b) > GREY_MAX {
        context.warnings.add("glass-tint-grey", || {
            format!(
                "{} tints the light that passes through it; as much light passes, without the colour",
                place()
            )
        });
    }
    let glass = Glass { blends, transmission, transmission_texture };
    Ok((blends || transmission > 0.0).then_some(glass))
}

/// Share of a material that is no metal, through which nothing passes. A texture that tells metal from glass is not read:
/// where it tells of metal, files have no transmission.
fn dielectric_share(stated: &gltf::json::Material) -> f32 {
    let pbr = &stated.pbr_metallic_roughness;
    if pbr.metallic_roughness_texture.is_some() {
        return 1.0;
    }
    1.0 - pbr.metallic_factor.0.clamp(0.0, 1.0)
}

/// The image with its red channel for alpha, all else white.
pub(super) fn in_alpha(image: SceneImage) -> Result<SceneImage> {
    let mut pixels: RgbaImage = decode(&image)?.into_rgba8();
    pixels.pixels_mut().for_each(|pixel| pixel.0 = [255, 255, 255, pixel.0[0]]);
    let mut bytes = Cursor::new(Vec::new());
    let name = format!("{} (red)", image.name);
    pixels.write_to(&mut bytes, ImageFormat::Png).map_err(|source| ImportError::Image {
        place: name.clone(),
        hint: "",
        source,
    })?;
    let media_type = ImageFormat::Png.to_mime_type().to_owned();
    Ok(SceneImage { name, media_type, bytes: bytes.into_inner(), size_px: image.size_px })
}
