//! Materials reduced to base colour, emission, mask, glass and sides.

use std::collections::BTreeMap;

use gltf::json::extensions::material::PbrSpecularGlossiness;
use gltf::json::extensions::texture::TextureTransform;
use gltf::json::material::AlphaMode;
use gltf::json::texture::{Info, WrappingMode};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};

use super::context::Context;
use super::error::{ImportError, Result, place_of};
use super::glass::{glass_of, in_alpha};
use super::images::read_image;
use super::model::{Material, SceneImage, TextureUse, Wrap};
use super::primitives::LocalMesh;
use super::{details, document};

/// Cutoff of masks whose own is no number: glTF's default.
const CUTOFF: f32 = 0.5;

/// Highest emission, in W·m⁻²·sr⁻¹: far above the sun's 2·10⁷, and far below the 10¹⁹ that chunks hold after bounces.
const EMISSION_MAX: f32 = 1e12;

/// The identity as a 2×3 affine map.
const IDENTITY_UV: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// Image index of a texture that names none (the `gltf` crate's mark).
const NO_IMAGE: usize = u32::MAX as usize;

/// Channels of an image that a material reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Reading {
    /// Colour, and alpha.
    Colour,
    /// The red channel, as a linear number: moved to alpha, as all readers take colours for sRGB.
    Red,
    /// Linear numbers, for pictures alone.
    Numbers,
}

/// A texture as a material names it.
#[derive(Clone, Copy)]
pub(super) struct Named<'a> {
    pub(super) index: Index<gltf::json::Texture>,
    pub(super) uv_set: u32,
    pub(super) transform: Option<&'a TextureTransform>,
}

impl<'a> Named<'a> {
    pub(super) fn of(info: &'a Info) -> Self {
        let extensions = info.extensions.as_ref();
        let transform = extensions.and_then(|extensions| extensions.texture_transform.as_ref());
        Self { index: info.index, uv_set: info.tex_coord, transform }
    }
}

/// All materials of a scene and the images that they use.
#[derive(Clone, Debug, Default)]
pub(super) struct MaterialTable {
    pub(super) materials: Vec<Material>,
    pub(super) images: Vec<SceneImage>,
    /// Those of linear numbers, whose indices follow those of `images`.
    pub(super) details: Vec<SceneImage>,
    /// New index of each image of the file, by its reading; `None` for those in formats that are not read.
    image_slots: BTreeMap<(usize, Reading), Option<u32>>,
    default_index: Option<u32>,
}

impl MaterialTable {
    /// Reads all materials of the file, in its order.
    pub(super) fn read(context: &mut Context<'_>) -> Result<Self> {
        let mut table = Self::default();
        for index in 0..context.root.materials.len() {
            let material = table.read_material(context, index)?;
            table.materials.push(material);
        }
        // Behind all colours: light needs these first where there is room for few pixels.
        for index in 0..table.materials.len() {
            details::read(&mut table, context, index)?;
        }
        Ok(table)
    }

    /// The materials for a scene; never empty.
    pub(super) fn finish(mut self) -> (Vec<Material>, Vec<SceneImage>, Vec<SceneImage>) {
        if self.materials.is_empty() {
            self.default_index();
        }
        (self.materials, self.images, self.details)
    }

    /// The table for meshes alone, which name no image.
    pub(super) fn without_images(self) -> Self {
        Self { images: Vec::new(), details: Vec::new(), ..self }
    }

    /// Index of the material that a primitive names, or of glTF's default one, appended on first need.
    pub(super) fn index_of(
        &mut self,
        root: &Root,
        named: Option<Index<gltf::json::Material>>,
        place: &dyn Fn() -> String,
    ) -> Result<u32> {
        let Some(index) = named else { return Ok(self.default_index()) };
        document::get(root, index, "material", place)?;
        Ok(index.value() as u32)
    }

    fn default_index(&mut self) -> u32 {
        let materials = &mut self.materials;
        *self.default_index.get_or_insert_with(|| {
            materials.push(Material::opaque("default", [1.0; 3]));
            materials.len() as u32 - 1
        })
    }

    /// Warns when a mesh lacks the UV set that its material's textures read.
    pub(super) fn warn_of_missing_uvs(
        &self,
        context: &mut Context<'_>,
        material_index: u32,
        mesh: &LocalMesh,
        place: &dyn Fn() -> String,
    ) {
        let material = &self.materials[material_index as usize];
        let of_normals = material.normal_map.iter().map(|map| &map.texture);
        let of_specular = material.specular.iter().flat_map(|specular| &specular.texture);
        let of_colours = material.base_colour_texture.iter().chain(&material.emissive_texture);
        for texture in of_colours.chain(of_normals).chain(of_specular) {
            let uvs = if texture.uv_set == 0 { &mesh.uv0 } else { &mesh.uv1 };
            if uvs.is_empty() {
                context.warnings.add("texture-without-uvs", || {
                    format!(
                        "{} has no UV set {} for its textures; the factors alone are used",
                        place(),
                        texture.uv_set
                    )
                });
            }
        }
    }

    fn read_material(&mut self, context: &mut Context<'_>, index: usize) -> Result<Material> {
        let stated = &context.root.materials[index];
        let place = || place_of("material", index, stated.name.as_deref());
        let (factor, texture) = base_colour_of(stated);
        warn_of_lost_specular(context, stated, &place);
        let base_colour = clamped(context, factor, 1.0, &place);
        let extensions = stated.extensions.as_ref();
        let strength = extensions
            .and_then(|extensions| extensions.emissive_strength.as_ref())
            .map_or(1.0, |strength| strength.emissive_strength.0);
        let emissive = stated.emissive_factor.0.map(|channel| channel * strength);
        let brightest = emissive.into_iter().fold(0.0, f32::max);
        if brightest > EMISSION_MAX {
            return Err(ImportError::TooBright { place: place(), found: brightest, limit: EMISSION_MAX });
        }
        Ok(Material {
            name: stated.name.clone().unwrap_or_else(|| format!("material {index}")),
            base_colour,
            base_colour_texture: self.read_texture(
                context,
                (texture.map(Named::of), Reading::Colour),
                &place,
            )?,
            emissive: clamped(context, emissive, EMISSION_MAX, &place),
            emissive_texture: self.read_texture(
                context,
                (stated.emissive_texture.as_ref().map(Named::of), Reading::Colour),
                &place,
            )?,
            alpha_cutoff: alpha_cutoff(context, stated, &place),
            glass: glass_of(self, context, stated, &place)?,
            normal_map: None,
            specular: None,
            double_sided: stated.double_sided,
        })
    }

    /// A texture and how it is read; warns and gives `None` where its factor alone is used.
    pub(super) fn read_texture(
        &mut self,
        context: &mut Context<'_>,
        (named, reading): (Option<Named<'_>>, Reading),
        place: &dyn Fn() -> String,
    ) -> Result<Option<TextureUse>> {
        let Some(Named { index, uv_set, transform }) = named else { return Ok(None) };
        let root = context.root;
        let texture = document::get(root, index, "texture", place)?;
        let uv_set = transform.and_then(|transform| transform.tex_coord).unwrap_or(uv_set);
        if uv_set > 1 {
            context.warnings.add("uv-set-unsupported", || {
                format!(
                    "{} has a texture on UV set {uv_set}; only 0 and 1 are read, its factor alone is used",
                    place()
                )
            });
            return Ok(None);
        }
        if texture.source.value() == NO_IMAGE {
            context.warnings.add("texture-format-unsupported", || {
                format!("{} has a texture without a PNG or JPEG; its factor alone is used", place())
            });
            return Ok(None);
        }
        document::get(root, texture.source, "image", place)?;
        let Some(image_index) = self.image_slot(context, texture.source.value(), reading)? else {
            return Ok(None);
        };
        let wrap = match texture.sampler {
            Some(index) => {
                let sampler = document::get(root, index, "sampler", place)?;
                [sampler.wrap_s, sampler.wrap_t].map(wrap_mode)
            }
            None => [Wrap::Repeat; 2],
        };
        let uv_transform = transform.map_or(IDENTITY_UV, |transform| uv_rows(context, transform, place));
        Ok(Some(TextureUse { image_index, uv_set: uv_set as u8, uv_transform, wrap }))
    }

    fn image_slot(
        &mut self,
        context: &mut Context<'_>,
        index: usize,
        reading: Reading,
    ) -> Result<Option<u32>> {
        if let Some(&slot) = self.image_slots.get(&(index, reading)) {
            return Ok(slot);
        }
        let slot = match reading {
            Reading::Colour => read_image(context, index)?.map(|image| self.add(image)),
            Reading::Red => {
                read_image(context, index)?.map(in_alpha).transpose()?.map(|image| self.add(image))
            }
            Reading::Numbers => details::image(context, index)?.map(|image| {
                self.details.push(image);
                (self.images.len() + self.details.len()) as u32 - 1
            }),
        };
        self.image_slots.insert((index, reading), slot);
        Ok(slot)
    }

    fn add(&mut self, image: SceneImage) -> u32 {
        self.images.push(image);
        self.images.len() as u32 - 1
    }
}

/// Base colour and its texture; those of the diffuse part where a material states specular and glossiness
/// (KHR_materials_pbrSpecularGlossiness), which the extension prefers.
fn base_colour_of(stated: &gltf::json::Material) -> ([f32; 4], Option<&Info>) {
    match specular_glossiness(stated) {
        Some(old) => (old.diffuse_factor.0, old.diffuse_texture.as_ref()),
        None => {
            let pbr = &stated.pbr_metallic_roughness;
            (pbr.base_color_factor.0, pbr.base_color_texture.as_ref())
        }
    }
}

pub(super) fn specular_glossiness(stated: &gltf::json::Material) -> Option<&PbrSpecularGlossiness> {
    stated.extensions.as_ref()?.pbr_specular_glossiness.as_ref()
}

/// Warns of metals of the old kind: their colour is in the specular part, which is not baked.
fn warn_of_lost_specular(
    context: &mut Context<'_>,
    stated: &gltf::json::Material,
    place: &dyn Fn() -> String,
) {
    let Some(old) = specular_glossiness(stated) else { return };
    let highest = |colour: &[f32]| colour.iter().fold(0.0, |high: f32, channel| high.max(*channel));
    let is_metal = old.specular_glossiness_texture.is_none()
        && highest(&old.specular_factor.0) > highest(&old.diffuse_factor.0[..3]);
    if is_metal {
        context.warnings.add("specular-colour-ignored", || {
            format!(
                "{} reflects more by its specular colour than by its diffuse one, which alone is baked; convert the file \
                 with 'npx @gltf-transform/cli metalrough IN.glb OUT.glb'",
                place()
            )
        });
    }
}

/// Factors forced into `0..=max`, with a warning if that changes them; NaN becomes 0.
pub(super) fn clamped<const N: usize>(
    context: &mut Context<'_>,
    stated: [f32; N],
    max: f32,
    place: &dyn Fn() -> String,
) -> [f32; N] {
    // max first: it turns NaN into 0.
    let usable = stated.map(|value| value.max(0.0).min(max));
    if usable != stated {
        context.warnings.add("material-factor-clamped", || {
            format!("{} has a colour or emission outside the range of its kind", place())
        });
    }
    usable
}

fn alpha_cutoff(
    context: &mut Context<'_>,
    stated: &gltf::json::Material,
    place: &dyn Fn() -> String,
) -> Option<f32> {
    match stated.alpha_mode {
        Checked::Valid(AlphaMode::Opaque | AlphaMode::Blend) => None,
        Checked::Valid(AlphaMode::Mask) => {
            let cutoff = stated.alpha_cutoff.unwrap_or_default().0;
            Some(if cutoff.is_finite() { cutoff.max(0.0) } else { CUTOFF })
        }
        Checked::Invalid => {
            context.warnings.add("alpha-mode-unknown", || format!("{} is taken as opaque", place()));
            None
        }
    }
}

fn wrap_mode(stated: Checked<WrappingMode>) -> Wrap {
    match stated {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
    }
}

/// KHR_texture_transform as a 2×3 map: `uv' = T · R · S · uv`.
///
/// R turns counter-clockwise as seen with v downwards: `u' = c·u + s·v`, `v' = −s·u + c·v`. The extension's text has
/// the other sign in its GLSL; viewers and the Khronos test model agree on this one.
fn uv_rows(
    context: &mut Context<'_>,
    transform: &TextureTransform,
    place: &dyn Fn() -> String,
) -> [[f32; 3]; 2] {
    let (sin, cos) = (libm::sin(f64::from(transform.rotation.0)), libm::cos(f64::from(transform.rotation.0)));
    let [scale_u, scale_v] = transform.scale.0.map(f64::from);
    let [offset_u, offset_v] = transform.offset.0;
    let rows = [
        [(cos * scale_u) as f32, (sin * scale_v) as f32, offset_u],
        [(-sin * scale_u) as f32, (cos * scale_v) as f32, offset_v],
    ];
    if rows.iter().flatten().all(|value| value.is_finite()) {
        return rows;
    }
    context.warnings.add("texture-transform-ignored", || format!("{} has one that is not finite", place()));
    IDENTITY_UV
}
