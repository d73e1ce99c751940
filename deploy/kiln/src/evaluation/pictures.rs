//! Pictures of an evaluation: the camera's view lit by the bake and by the reference, and how they differ.

use glam::{DVec3, Vec4};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::lights::camera_of;
use lightkiln_client::passes::atlas::Lightmap;
use lightkiln_client::passes::atlas::reference::{AtlasPages, sample, spread};
use lightkiln_client::picture::{Tone, automatic_exposure, developed};
use lightkiln_proto::scene::SceneCamera;
use lightkiln_worker::evaluate::{Answer, LightResult, Relit};
use lightkiln_worker::reference::{EyeSurface, PictureSize, TracedPicture, luminance};
use lightkiln_worker::task::Progress;

use super::flip::difference;
use super::heat::{Bitmap, atlas, colour};
use super::measure::Measured;
use crate::console::say;
use crate::failure::{Exit, Failure, Result};
use crate::kinds::KindTables;

/// Paths along a pixel's side: their square go through it.
const PATHS_A_SIDE: u32 = 14;
/// Side in pixels of the blocks in which differences are shown.
const HEAT_BLOCK: usize = 2;
/// Points over rectangles for E_dir at a pixel's sample.
const RECT_POINTS: u32 = 4;

/// The pictures of one light.
pub struct LightPictures {
    /// Light's name.
    pub name: String,
    /// The view lit by the bake: exact E_dir, E_ind from the atlas as the client reads it.
    pub baked: Bitmap,
    /// The view by paths, the same exposure.
    pub reference: Bitmap,
    /// Signed difference of luminance.
    pub heat: Bitmap,
    /// ꟻLIP, dark to bright.
    pub flip: Bitmap,
    /// Mean ꟻLIP.
    pub flip_mean: f64,
    /// Signed difference on the atlas, page by page.
    pub atlas: Vec<Bitmap>,
}

/// Draws every light of a measurement by `camera`, or the scene's first, or one chosen; says on standard error which.
pub fn draw(
    kinds: &KindTables,
    source: &Source,
    measured: &Measured,
    camera: Option<SceneCamera>,
    (width, height): (u32, u32),
) -> Result<Vec<LightPictures>> {
    let bake = LoadedBake::load(source, &kinds.client)?;
    let camera = match camera {
        Some(camera) => camera,
        None => {
            let (camera, note) = camera_of(&bake.scene.manifest)?;
            note.iter().for_each(|note| say!("note: {note}"));
            camera
        }
    };
    let size = PictureSize { width, height, grid: PATHS_A_SIDE };
    let draw = |result: &LightResult| {
        say!("{}: pictures", result.light.name);
        one(&bake, &camera, &size, measured, result)
    };
    measured.results.iter().map(draw).collect()
}

fn one(
    bake: &LoadedBake,
    camera: &SceneCamera,
    size: &PictureSize,
    measured: &Measured,
    result: &LightResult,
) -> Result<LightPictures> {
    let failed = |error: &(dyn std::error::Error + 'static)| {
        Failure::new(Exit::Failed, "a picture failed").caused_by(error)
    };
    let reference = measured.evaluator.reference(&result.light.lighting).map_err(|error| failed(&error))?;
    let progress = Progress::new();
    let relit = measured.evaluator.relit(&result.light, &progress).map_err(|error| failed(&error))?;
    let lightmap = bake.light.lightmap(&bake.scene);
    let pages = lightmap.as_ref().map(|lightmap| pages_of(measured, relit.as_ref(), lightmap));
    let indirect = |surface: &EyeSurface| -> Option<DVec3> {
        let evaluated = measured.evaluator.bake();
        if let (Some(lightmap), Some(pages), Some(evaluated)) = (&lightmap, &pages, evaluated.lightmap()) {
            let (key, texel) = evaluated.texel_at(&surface.hit)?;
            let block = lightmap.layout.block_index(key)?;
            return Some(sample(lightmap.layout, pages, block, texel.to_array()).as_dvec3());
        }
        match evaluated.answer_at(&surface.hit) {
            Answer::Place(place) => relit.irradiance(&place),
            Answer::Cavity | Answer::TooSmall => None,
        }
    };
    let irradiance = |surface: &EyeSurface| -> DVec3 {
        reference.direct_irradiance(&surface.site, RECT_POINTS) + indirect(surface).unwrap_or_default()
    };
    let baked = reference.picture_by(camera, size, &progress, irradiance).map_err(|error| failed(&error))?;
    let traced = reference.picture(camera, size, &progress).map_err(|error| failed(&error))?;
    let opaque: Vec<Vec4> = traced.radiance.iter().map(|l| Vec4::new(l[0], l[1], l[2], 1.0)).collect();
    let exposure = automatic_exposure(&opaque);
    let bitmap = |pixels: Vec<[u8; 4]>| Bitmap { width: size.width, height: size.height, pixels };
    let shown = |picture: &TracedPicture| bitmap(developed(&picture.radiance, exposure, Tone::default()));
    let (baked_shown, traced_shown) = (shown(&baked), shown(&traced));
    let flip = difference(size.width, size.height, &traced_shown.pixels, &baked_shown.pixels);
    let heat = bitmap(compared(size, &baked, &traced));
    Ok(LightPictures {
        name: result.light.name.clone(),
        baked: baked_shown,
        reference: traced_shown,
        heat,
        flip: bitmap(flip.map),
        flip_mean: flip.mean,
        atlas: lightmap.map(|lightmap| atlas(measured, result, &lightmap)).unwrap_or_default(),
    })
}

/// Lightmap pages of a relit bake, as the client reads them.
fn pages_of(measured: &Measured, relit: &dyn Relit, lightmap: &Lightmap<'_>) -> AtlasPages {
    let slots = lightmap.texels.sources.iter().max().map_or(0, |slot| *slot as usize + 1);
    let mut e_ind = vec![Vec4::ZERO; slots];
    let evaluated = measured.evaluator.bake().lightmap();
    for (index, block) in lightmap.layout.blocks.iter().enumerate() {
        for texel in (0..block.size[1]).flat_map(|y| (0..block.size[0]).map(move |x| [x as u16, y as u16])) {
            let place = evaluated.and_then(|evaluated| evaluated.place_of(block.key, texel));
            let slot = lightmap.slots.slot(index as u32, texel);
            let light = place.and_then(|place| relit.irradiance(&place));
            if let (Some(slot), Some(light)) = (slot, light) {
                e_ind[slot as usize] = light.as_vec3().extend(0.0);
            }
        }
    }
    spread(lightmap.layout, lightmap.texels, &vec![Vec4::ZERO; slots], &e_ind)
}

/// Signed difference over the mean luminance of the reference, in blocks of pixels, which halves the noise of paths.
fn compared(size: &PictureSize, baked: &TracedPicture, traced: &TracedPicture) -> Vec<[u8; 4]> {
    let of = |picture: &TracedPicture| -> Vec<f64> {
        picture.radiance.iter().map(|pixel| luminance(glam::Vec3::from(*pixel).as_dvec3())).collect()
    };
    let (baked, traced) = (of(baked), of(traced));
    let mean = (traced.iter().sum::<f64>() / traced.len().max(1) as f64).max(f64::MIN_POSITIVE);
    let [width, height] = [size.width, size.height].map(|side| side as usize);
    let block_of =
        |pixel: usize| pixel / width / HEAT_BLOCK * width.div_ceil(HEAT_BLOCK) + pixel % width / HEAT_BLOCK;
    let mut blocks = vec![(0.0, 0_u32); width.div_ceil(HEAT_BLOCK) * height.div_ceil(HEAT_BLOCK)];
    for (pixel, (b, r)) in baked.iter().zip(&traced).enumerate() {
        let (sum, count) = &mut blocks[block_of(pixel)];
        (*sum, *count) = (*sum + (b - r) / mean, *count + 1);
    }
    let shown = |pixel| {
        let (sum, count) = blocks[block_of(pixel)];
        colour(sum / f64::from(count))
    };
    (0..baked.len()).map(shown).collect()
}
