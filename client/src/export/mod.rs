//! A bake's light frozen under chosen lights, for engines that do not know Lightkiln: a GLB with the scene, and the lightmap's pages as
//! KTX2 files of irradiance. `EXPORT.md` says what they hold.
//!
//! ```text
//! light at receivers ─▶ pages, read as a client reads them ─▶ dilate ─▶ ktx2 ─┐
//! blocks ─────────────▶ pages (places with rims) ─────────────────────────────┼▶ folder
//! meshes, materials, textures ──────────────────────▶ meshes, materials ─▶ glb ─┤
//! light at probes in free space ────────────────────▶ probes ─────────────▶ ktx2 ─┘
//! ```

mod dilate;
mod folder;
mod glb;
mod ktx2;
mod materials;
mod meshes;
mod pages;
mod probes;
#[cfg(test)]
mod tests;

use glam::{Vec3, Vec4};
use half::f16;
use lightkiln_proto::chunk;
use lightkiln_proto::manifest::TEXTURES;
use rayon::prelude::*;
use serde_json::json;

use crate::bake::{LoadedBake, ReceiverLight};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};
use crate::passes::atlas::Lightmap;
use crate::passes::atlas::reference::{AtlasPages, spread};
use dilate::{Charts, Shown, charts};
use glb::Glb;
use ktx2::{Shape, opaque};
use materials::{Materials, check_files};
use meshes::{Atlas, Unlit};
use pages::{PAGE_MAX, Pages};

pub use folder::{check_folder, write};
pub use materials::{LIGHTMAP, TextureFile};
pub use probes::{ProbeFormat, TILE_SIDE, direction_in_tile, texel_behind_border};

/// The GLB's file in an export.
pub const SCENE_FILE: &str = "scene.glb";
/// Texels of a page along each of the lightmap's. Odd numbers keep the middles of texels, so that bilinear light stays what it is.
pub const SCALES: [u32; 2] = [1, 3];
/// Irradiance up to which texels are stored as they are: half floats end at 65504.
const PLAIN_MAX: f32 = 32_768.0;
/// Brightest texel from which on they are: half floats lose digits below 6e-5.
const PLAIN_MIN: f32 = 1.0 / 64.0;

/// The light that pages hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Share {
    /// Direct and indirect: an engine adds no light of its own.
    #[default]
    All,
    /// Light of emissive surfaces and skies, and all bounces: an engine adds the direct light of points, spots and suns.
    Indirect,
}

/// Choices of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options<'a> {
    /// The light that pages hold.
    pub share: Share,
    /// Texels of a page along each of the lightmap's, of [`SCALES`]. More → light keeps to its side of thin walls, more bytes.
    pub scale: u32,
    /// Files of light in free space, of kinds that have it.
    pub probes: &'a [ProbeFormat],
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { share: Share::All, scale: 1, probes: &ProbeFormat::ALL }
    }
}

/// An export in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exported {
    /// Names and contents of files, [`SCENE_FILE`] first, then pages, then light in free space.
    pub files: Vec<(String, Vec<u8>)>,
    /// Width and height of each page, in the order of their files.
    pub pages: Vec<[u32; 2]>,
    /// Factor on a page's texels that gives W·m⁻².
    pub intensity: f32,
    /// Meshes that have less light than they show, and files that not every adapter reads.
    pub warnings: Vec<String>,
}

/// Fetches the files of a bake's textures, as an export holds them.
pub fn texture_files(source: &Source, bake: &LoadedBake) -> Result<Vec<TextureFile>> {
    decoded(source, &bake.scene.manifest, TEXTURES, |bytes| {
        let texture = chunk::decode_texture(bytes)?;
        Ok(TextureFile { media_type: texture.media_type, bytes: texture.bytes })
    })
}

/// Refuses light in free space of a bake of a kind that has none.
pub fn check_probes(bake: &LoadedBake) -> Result<()> {
    if bake.light.free_space().is_some() {
        return Ok(());
    }
    let text = format!("kind {}", bake.scene.manifest.kind);
    let problem = "has no light in free space; bake the scene with a kind that has, or export without \
                   --probes; 'kiln settings' lists kinds";
    Err(ClientError::Source { text, problem: problem.to_owned() })
}

/// Refuses what [`export`] would, whatever the light: to be asked before light is settled.
pub fn check(bake: &LoadedBake, files: &[TextureFile], scale: u32) -> Result<()> {
    check_files(&bake.scene, files)?;
    plan(bake, scale).map(drop)
}

/// Freezes a bake under the light that its receivers have; `emitter_scale` is the emitters' strength, 1 where absent. Equal light gives
/// equal bytes. Errs for a kind that has neither a lightmap nor light in free space, and where a part is too large for its format.
pub fn export(
    bake: &LoadedBake,
    files: &[TextureFile],
    light: &ReceiverLight,
    emitter_scale: &[f32],
    options: Options<'_>,
) -> Result<Exported> {
    let Options { share, scale, probes } = options;
    let scene = &bake.scene;
    let (charts, places) = plan(bake, scale)?;
    let lightmap = lightmap_of(bake)?;
    let spread = |lightmap: Lightmap<'_>| -> Result<Vec<Vec<Vec3>>> {
        let shown = shown(lightmap, light, share)?;
        Ok(dilate::spread(Shown { lightmap, pages: &shown }, &charts, scale))
    };
    let blocks = lightmap.map_or_else(|| Ok(Vec::new()), spread)?;
    let intensity = intensity_of(blocks.iter().flatten().copied())?;
    let names: Vec<String> = (0..places.sizes.len()).map(|page| format!("lightmap-{page}.ktx2")).collect();
    let mut glb = Glb::default();
    let mut materials = Materials::new(&mut glb, scene, files, emitter_scale, (&names, intensity))?;
    let unlit = meshes::write(&mut glb, scene, &mut materials, Atlas { pages: &places, scale })?;
    meshes::write_cameras(&mut glb, scene);
    let kept = match share {
        Share::All if lightmap.is_some() => "direct and indirect",
        Share::All | Share::Indirect => "indirect",
    };
    let mut extras = json!({ "irradiance": kept, "unit": "W/m2", "texelsPerLightmapTexel": scale });
    let space = bake.light.free_space().filter(|space| !space.positions_m().is_empty() && !probes.is_empty());
    let probes = space.map(|space| probes::files(space, &light.probes, probes)).transpose()?;
    if let Some(probes) = &probes {
        extras["probes"] = probes.extras.clone();
    }
    let mut all = vec![(SCENE_FILE.to_owned(), glb.finish(extras)?)];
    let written =
        (0..places.sizes.len()).into_par_iter().map(|page| page_file(&places, &blocks, page, intensity));
    let written = written.collect::<Result<Vec<_>>>()?;
    all.extend(names.into_iter().zip(written));
    // Without a lightmap the engine's probes light all.
    let unlit = if lightmap.is_some() || probes.is_none() { unlit } else { Unlit::default() };
    let mut warnings = warnings(unlit, &places.sizes);
    if let Some(probes) = probes {
        all.extend(probes.files);
        warnings.extend(probes.warnings);
    }
    Ok(Exported { files: all, pages: places.sizes, intensity, warnings })
}

/// Charts of the lightmap's blocks, and the blocks' places in pages.
fn plan(bake: &LoadedBake, scale: u32) -> Result<(Charts, Pages)> {
    if !SCALES.contains(&scale) {
        let problem = "texels along each of the lightmap's are 1 or 3".to_owned();
        return Err(ClientError::Argument { what: format!("--scale {scale}"), problem });
    }
    lightmap_of(bake)?;
    let scene = &bake.scene;
    let charts = charts(&scene.draws, scene.lightmap.blocks.len());
    let used = scene.lightmap.blocks.iter().zip(&charts);
    let sizes: Vec<Option<[u32; 2]>> =
        used.map(|(block, chart)| (!chart.is_empty()).then(|| block.size.map(|side| side * scale))).collect();
    let places = Pages::pack(&sizes)?;
    Ok((charts, places))
}

/// The lightmap; none of a kind that has its light in free space alone.
fn lightmap_of(bake: &LoadedBake) -> Result<Option<Lightmap<'_>>> {
    let lightmap = bake.light.lightmap(&bake.scene).filter(|lightmap| !lightmap.layout.blocks.is_empty());
    if lightmap.is_some() || bake.light.free_space().is_some() {
        return Ok(lightmap);
    }
    Err(ClientError::Source {
        text: format!("kind {}", bake.scene.manifest.kind),
        problem: "has neither a lightmap nor light in free space to export; bake the scene with a kind that has; 'kiln settings' \
                  lists kinds"
            .to_owned(),
    })
}

/// The lightmap's pages under the light, as a client reads them.
fn shown(lightmap: Lightmap<'_>, light: &ReceiverLight, share: Share) -> Result<AtlasPages> {
    let count = lightmap.receivers.len();
    let ReceiverLight { direct, emit, indirect, .. } = light;
    if [direct, emit, indirect].iter().any(|array| array.len() != count) {
        let problem = format!("light of {} receivers, there are {count}", indirect.len());
        return Err(ClientError::inconsistent("light at receivers", problem));
    }
    let straight: Vec<Vec4> = match share {
        Share::All => direct.iter().zip(emit).map(|(direct, emit)| *direct + *emit).collect(),
        Share::Indirect => emit.clone(),
    };
    if straight.iter().zip(indirect).any(|(straight, indirect)| !(*straight + *indirect).is_finite()) {
        return Err(not_finite());
    }
    Ok(spread(lightmap.layout, lightmap.texels, &straight, indirect))
}

/// Factor on stored texels: 1, or a power of two that brings the brightest one into the range of half floats. Errs where light is
/// no number.
fn intensity_of(texels: impl Iterator<Item = Vec3> + Clone) -> Result<f32> {
    if texels.clone().any(|light| !light.is_finite()) {
        return Err(not_finite());
    }
    let brightest = texels.map(|light| light.max_element()).fold(0.0, f32::max);
    if brightest == 0.0 || (PLAIN_MIN..=PLAIN_MAX).contains(&brightest) {
        return Ok(1.0);
    }
    // The brightest lies below PLAIN_MAX, by less than a factor of two: dim texels beside it keep their digits. Down to the smallest
    // factor that a float has exactly.
    let exponent = (brightest.log2().floor() - 14.0).clamp(-126.0, 127.0);
    Ok(exponent.exp2())
}

fn not_finite() -> ClientError {
    let problem = "is no finite number at a texel: the lights are too strong".to_owned();
    ClientError::Argument { what: "the light".to_owned(), problem }
}

/// The file of a page.
fn page_file(places: &Pages, blocks: &[Vec<Vec3>], page: usize, intensity: f32) -> Result<Vec<u8>> {
    let size = places.sizes[page];
    let black = [f16::ZERO, f16::ZERO, f16::ZERO, f16::ONE];
    let mut texels = vec![black; size[0] as usize * size[1] as usize];
    for (place, block) in places.places.iter().zip(blocks) {
        let Some(place) = place.filter(|place| place.page as usize == page) else { continue };
        for (row, from) in block.chunks_exact(place.size[0] as usize).enumerate() {
            let first = (place.corner[1] as usize + row) * size[0] as usize + place.corner[0] as usize;
            for (into, light) in texels[first..].iter_mut().zip(from) {
                *into = opaque(*light / intensity);
            }
        }
    }
    ktx2::rgba16f(Shape::picture(size), &texels)
}

fn warnings(Unlit { meshes, backs }: Unlit, pages: &[[u32; 2]]) -> Vec<String> {
    let of = |count: usize, what: &str| (count > 0).then(|| format!("{count} {what}"));
    let meshes = of(meshes, "meshes have no place in the lightmap and are exported without light");
    let backs =
        of(backs, "meshes are seen from both sides and have light on one: the other is exported without");
    let wide = pages.iter().filter(|page| page.iter().any(|side| *side > PAGE_MAX)).count();
    let wide =
        of(wide, &format!("pages have sides of more than {PAGE_MAX} texels, which not all adapters read"));
    meshes.into_iter().chain(backs).chain(wide).collect()
}
