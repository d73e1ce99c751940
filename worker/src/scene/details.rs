//! Normal maps, and specular reflection by metallic and roughness: what pictures show of a surface, and transport does not
//! (METHOD.md §2.15).

use gltf::json::extensions::texture::TextureTransform;
use gltf::json::material::NormalTexture;

use super::context::Context;
use super::error::{ImportError, Result, place_of};
use super::images::read_image;
use super::materials::{MaterialTable, Named, Reading, clamped, specular_glossiness};
use super::model::{NormalMap, SceneImage, Specular, TextureUse};

/// Largest factor on a normal map's x and y.
const SCALE_MAX: f32 = 1e3;
/// Name of the extension that moves textures.
const TRANSFORM: &str = "KHR_texture_transform";

/// Reads those of a material whose colours have been read.
pub(super) fn read(table: &mut MaterialTable, context: &mut Context<'_>, index: usize) -> Result<()> {
    let stated = &context.root.materials[index];
    let place = || place_of("material", index, stated.name.as_deref());
    table.materials[index].normal_map = match &stated.normal_texture {
        None => None,
        Some(normals) => normal_map(table, context, (index, normals), &place)?,
    };
    table.materials[index].specular = specular(table, context, (index, stated), &place)?;
    Ok(())
}

fn normal_map(
    table: &mut MaterialTable,
    context: &mut Context<'_>,
    (index, normals): (usize, &NormalTexture),
    place: &dyn Fn() -> String,
) -> Result<Option<NormalMap>> {
    let transform = transform_of(context, normals, place);
    let named = Named { index: normals.index, uv_set: normals.tex_coord, transform: transform.as_ref() };
    let Some(texture) = texture(table, context, (index, named), place)? else { return Ok(None) };
    let is_scale = normals.scale.abs() <= SCALE_MAX;
    if !is_scale {
        context.warnings.add("normal-scale-ignored", || {
            format!("{} scales its normal map by more than {SCALE_MAX}; 1 is taken", place())
        });
    }
    Ok(Some(NormalMap { texture, scale: if is_scale { normals.scale } else { 1.0 } }))
}

/// KHR_texture_transform of a normal map, which the typed reader leaves as JSON.
fn transform_of(
    context: &mut Context<'_>,
    normals: &NormalTexture,
    place: &dyn Fn() -> String,
) -> Option<TextureTransform> {
    let stated = normals.extensions.as_ref()?.others.get(TRANSFORM)?;
    let read = serde_json::from_value(stated.clone());
    if read.is_err() {
        context.warnings.add("texture-transform-ignored", || {
            format!("{} has one that is none for its normal map", place())
        });
    }
    read.ok()
}

/// Specular reflection; `None` where a surface reflects as a diffuse one does: fully rough without a texture. Glass has none, nor have
/// materials of specular and glossiness.
fn specular(
    table: &mut MaterialTable,
    context: &mut Context<'_>,
    (index, stated): (usize, &gltf::json::Material),
    place: &dyn Fn() -> String,
) -> Result<Option<Specular>> {
    let pbr = &stated.pbr_metallic_roughness;
    let factors = [pbr.metallic_factor.0, pbr.roughness_factor.0];
    let named = pbr.metallic_roughness_texture.as_ref();
    let is_plain = named.is_none() && factors[1] >= 1.0;
    if is_plain || table.materials[index].glass.is_some() || specular_glossiness(stated).is_some() {
        return Ok(None);
    }
    let [metallic, roughness] = clamped(context, factors, 1.0, place);
    let texture = match named {
        None => None,
        Some(info) => texture(table, context, (index, Named::of(info)), place)?,
    };
    Ok((texture.is_some() || roughness < 1.0).then_some(Specular { metallic, roughness, texture }))
}

/// A texture of linear numbers on the UV set that meshes of the material are drawn with; warns and gives `None` on another.
fn texture(
    table: &mut MaterialTable,
    context: &mut Context<'_>,
    (index, named): (usize, Named<'_>),
    place: &dyn Fn() -> String,
) -> Result<Option<TextureUse>> {
    let Some(texture) = table.read_texture(context, (Some(named), Reading::Numbers), place)? else {
        return Ok(None);
    };
    let drawn = table.materials[index].first_texture().map(|first| first.uv_set);
    if drawn.is_some_and(|drawn| drawn != texture.uv_set) {
        context.warnings.add("texture-uv-set-differs", || {
            format!(
                "{} has a normal map or a metallic-roughness texture on another UV set than its colour; it is left out",
                place()
            )
        });
        return Ok(None);
    }
    Ok(Some(texture))
}

/// An image for pictures alone; warns and gives `None` where there is no room for its pixels beside those that light needs.
pub(super) fn image(context: &mut Context<'_>, index: usize) -> Result<Option<SceneImage>> {
    match read_image(context, index) {
        Err(error @ ImportError::LimitExceeded { .. }) => {
            context.warnings.add("texture-left-out", || {
                format!("a normal map or a metallic-roughness texture is left out: {error}")
            });
            Ok(None)
        }
        read => read,
    }
}
