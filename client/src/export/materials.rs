//! Materials, textures and samplers of an export.

use std::collections::BTreeMap;
use std::io::Cursor;

use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use lightkiln_proto::manifest::{Material, TextureUse, Wrap};
use serde_json::{Value, json};

use super::glb::Glb;
use crate::error::{ClientError, Result};
use crate::scene::{LoadedScene, Texture};

/// The extension that names a material's lightmap.
pub const LIGHTMAP: &str = "MOZ_lightmap";
/// The extension that names a texture's KTX2 file.
const KTX2_TEXTURE: &str = "KHR_texture_basisu";

/// A texture as a file: what a bundle holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextureFile {
    /// `image/png` or `image/jpeg`.
    pub media_type: String,
    /// The file.
    pub bytes: Vec<u8>,
}

/// How a mesh shows a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Look {
    /// Index into the manifest's materials.
    pub material: u32,
    /// Page of its light.
    pub page: Option<u32>,
    /// It is seen from both sides.
    pub double_sided: bool,
}

/// Maps from a mesh's uv to coordinates of textures.
pub type UvMap = Option<[[f32; 3]; 2]>;

/// The different maps of a material's textures, in the order of their sets of coordinates.
pub fn uv_maps(material: &Material) -> Vec<UvMap> {
    let mut maps: Vec<UvMap> = Vec::new();
    for used in uses(material).into_iter().flatten() {
        if !maps.contains(&used.transform) {
            maps.push(used.transform);
        }
    }
    maps
}

/// Number of a set of coordinates, by its place among [`uv_maps`]: the lightmap's is 1.
pub fn uv_set(place: usize, page: Option<u32>) -> usize {
    if place > 0 && page.is_some() { place + 1 } else { place }
}

/// Textures of base colour, emission and transmission.
fn uses(material: &Material) -> [Option<&TextureUse>; 3] {
    let glass = material.glass.as_ref();
    [
        material.base_colour_texture.as_ref(),
        material.emissive_texture.as_ref(),
        glass.and_then(|glass| glass.transmission_texture.as_ref()),
    ]
}

/// Materials as they are written to a file, each once.
pub struct Materials<'a> {
    scene: &'a LoadedScene,
    files: &'a [TextureFile],
    emitter_scale: &'a [f32],
    /// Factor on the pages' texels.
    intensity: f32,
    page_files: &'a [String],
    /// glTF texture of each page.
    pages: Vec<usize>,
    looks: BTreeMap<Look, usize>,
    /// By texture, and whether its alpha is its red.
    pictures: BTreeMap<(u32, bool), usize>,
    textures: BTreeMap<(usize, [u32; 2]), usize>,
}

impl<'a> Materials<'a> {
    /// Names the files of pages. `files` are those of the scene's textures.
    pub fn new(
        glb: &mut Glb,
        scene: &'a LoadedScene,
        files: &'a [TextureFile],
        emitter_scale: &'a [f32],
        (page_files, intensity): (&'a [String], f32),
    ) -> Result<Self> {
        check_files(scene, files)?;
        let pages = page_textures(glb, page_files)?;
        let (looks, pictures, textures) = Default::default();
        Ok(Self { scene, files, emitter_scale, intensity, page_files, pages, looks, pictures, textures })
    }

    /// Index of a look's material.
    pub fn of(&mut self, glb: &mut Glb, look: Look) -> Result<usize> {
        if let Some(index) = self.looks.get(&look) {
            return Ok(*index);
        }
        let value = self.value(glb, look)?;
        let index = glb.push("materials", value);
        self.looks.insert(look, index);
        Ok(index)
    }

    fn value(&mut self, glb: &mut Glb, look: Look) -> Result<Value> {
        let material = &self.scene.manifest.materials[look.material as usize];
        let [base, emissive, transmission] = uses(material);
        let factor = material.base_colour.map(|channel| channel.clamp(0.0, 1.0));
        let clear = material.glass.as_ref().filter(|glass| glass.transmission > 0.0);
        // Engines blur what is seen through rough glass; light passes baked glass straight.
        let roughness = u8::from(clear.is_none());
        let mut diffuse =
            json!({ "baseColorFactor": factor, "metallicFactor": 0, "roughnessFactor": roughness });
        if let Some(used) = base {
            diffuse["baseColorTexture"] = self.texture(glb, (look, material), used, false)?;
        }
        // Light is baked as diffuse alone: none is left for a reflection.
        glb.uses("KHR_materials_specular");
        let mut extensions = json!({ "KHR_materials_specular": { "specularFactor": 0 } });
        let mut value = json!({
            "name": material.name, "doubleSided": look.double_sided, "pbrMetallicRoughness": diffuse,
        });
        if let Some((factor, strength)) = self.emission(material) {
            value["emissiveFactor"] = json!(factor);
            if strength > 1.0 {
                glb.uses("KHR_materials_emissive_strength");
                extensions["KHR_materials_emissive_strength"] = json!({ "emissiveStrength": strength });
            }
            if let Some(used) = emissive {
                value["emissiveTexture"] = self.texture(glb, (look, material), used, false)?;
            }
        }
        if material.glass.as_ref().is_some_and(|glass| glass.blends) {
            value["alphaMode"] = json!("BLEND");
        } else if let Some(cutoff) = material.alpha_cutoff {
            value["alphaMode"] = json!("MASK");
            value["alphaCutoff"] = json!(cutoff.max(0.0));
        }
        if let Some(glass) = clear {
            glb.uses("KHR_materials_transmission");
            let mut through = json!({ "transmissionFactor": glass.transmission.clamp(0.0, 1.0) });
            if let Some(used) = transmission {
                through["transmissionTexture"] = self.texture(glb, (look, material), used, true)?;
            }
            extensions["KHR_materials_transmission"] = through;
        }
        if let Some(page) = look.page {
            glb.uses(LIGHTMAP);
            let index = self.pages[page as usize];
            extensions[LIGHTMAP] = json!({ "index": index, "texCoord": 1, "intensity": self.intensity });
            // Loaders that hand no unknown extension on do so with extras.
            let file = &self.page_files[page as usize];
            value["extras"] = json!({ "lightmap": file, "lightmapIntensity": self.intensity });
        }
        value["extensions"] = extensions;
        Ok(value)
    }

    /// Factor and strength of a material's emission: their product is its radiance.
    fn emission(&self, material: &Material) -> Option<([f32; 3], f32)> {
        let emitter = material.emitter.map(usize::from);
        let scale = emitter.and_then(|index| self.emitter_scale.get(index)).copied().unwrap_or(1.0);
        let radiance = material.emissive.map(|channel| channel.max(0.0) * scale);
        let strength = radiance.into_iter().fold(1.0, f32::max);
        radiance
            .iter()
            .any(|channel| *channel > 0.0)
            .then(|| (radiance.map(|channel| channel / strength), strength))
    }

    fn texture(
        &mut self,
        glb: &mut Glb,
        (look, material): (Look, &Material),
        used: &TextureUse,
        alpha_as_red: bool,
    ) -> Result<Value> {
        let picture = self.picture(glb, used.texture, alpha_as_red)?;
        let wrap = used.wrap.map(wrap_mode);
        let index = match self.textures.get(&(picture, wrap)) {
            Some(index) => *index,
            None => {
                let sampler =
                    json!({ "magFilter": 9729, "minFilter": 9987, "wrapS": wrap[0], "wrapT": wrap[1] });
                let sampler = glb.push("samplers", sampler);
                let index = glb.push("textures", json!({ "source": picture, "sampler": sampler }));
                self.textures.insert((picture, wrap), index);
                index
            }
        };
        let place = uv_maps(material).iter().position(|map| *map == used.transform).unwrap_or_default();
        Ok(json!({ "index": index, "texCoord": uv_set(place, look.page) }))
    }

    fn picture(&mut self, glb: &mut Glb, texture: u32, alpha_as_red: bool) -> Result<usize> {
        if let Some(index) = self.pictures.get(&(texture, alpha_as_red)) {
            return Ok(*index);
        }
        let index = if alpha_as_red {
            glb.picture("image/png", &red_of_alpha(&self.scene.textures[texture as usize])?)
        } else {
            let TextureFile { media_type, bytes } = &self.files[texture as usize];
            glb.picture(media_type, bytes)
        };
        self.pictures.insert((texture, alpha_as_red), index);
        Ok(index)
    }
}

/// Errs unless every texture has a file of a kind that glTF knows.
pub fn check_files(scene: &LoadedScene, files: &[TextureFile]) -> Result<()> {
    if files.len() != scene.textures.len() {
        let problem = format!("{} files of {} textures", files.len(), scene.textures.len());
        return Err(ClientError::inconsistent("textures", problem));
    }
    let is_known = |file: &TextureFile| matches!(file.media_type.as_str(), "image/png" | "image/jpeg");
    match files.iter().position(|file| !is_known(file)) {
        None => Ok(()),
        Some(index) => {
            let problem = format!("is '{:.40}', and glTF knows PNG and JPEG", files[index].media_type);
            Err(ClientError::inconsistent(format!("texture {index}"), problem))
        }
    }
}

/// A texture for each page: its KTX2 file, and a black texel for those who cannot read one.
fn page_textures(glb: &mut Glb, pages: &[String]) -> Result<Vec<usize>> {
    if pages.is_empty() {
        return Ok(Vec::new());
    }
    glb.uses(KTX2_TEXTURE);
    let black = glb.picture("image/png", &png(1, 1, &[[0, 0, 0, 255]])?);
    let sampler = glb.push(
        "samplers",
        json!({ "magFilter": 9729, "minFilter": 9729, "wrapS": wrap_mode(Wrap::Clamp), "wrapT": wrap_mode(Wrap::Clamp) }),
    );
    let texture = |uri: &String| {
        let file = glb.push("images", json!({ "uri": uri, "mimeType": "image/ktx2", "name": uri }));
        let extensions = json!({ KTX2_TEXTURE: { "source": file } });
        glb.push("textures", json!({ "source": black, "sampler": sampler, "extensions": extensions }))
    };
    Ok(pages.iter().map(texture).collect())
}

/// glTF's number of a wrap mode.
fn wrap_mode(wrap: Wrap) -> u32 {
    match wrap {
        Wrap::Repeat => 10_497,
        Wrap::Clamp => 33_071,
        Wrap::Mirror => 33_648,
    }
}

/// A PNG with a texture's alpha for red, where glTF has transmission.
fn red_of_alpha(texture: &Texture) -> Result<Vec<u8>> {
    let level = &texture.levels[0];
    let texels: Vec<[u8; 4]> = level.texels.iter().map(|[.., alpha]| [*alpha, 0, 0, 255]).collect();
    png(level.width, level.height, &texels)
}

fn png(width: u32, height: u32, texels: &[[u8; 4]]) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    PngEncoder::new(&mut bytes)
        .write_image(texels.as_flattened(), width, height, ExtendedColorType::Rgba8)
        .map_err(|source| ClientError::Picture { path: "a texture".into(), source: Box::new(source) })?;
    Ok(bytes.into_inner())
}
