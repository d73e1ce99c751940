//! Pictures of an evaluation: the camera's view lit by the bake and by the reference, and how they differ.

use glam::{DVec3, Vec4};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::lights::default_camera;
use lightkiln_client::passes::atlas::reference::{sample, spread};
use lightkiln_client::picture::{Tone, automatic_exposure, developed};
use lightkiln_proto::scene::SceneCamera;
use lightkiln_worker::evaluate::LightResult;
use lightkiln_worker::reference::{EyeSurface, Film, PictureSize, luminance};
use lightkiln_worker::task::Progress;

use super::flip::difference;
use super::heat::{Bitmap, atlas, colour};
use super::measure::Measured;
use crate::failure::{Exit, Failure, Result};

/// Paths along a pixel's side: their square go through it.
const PATHS_A_SIDE: u32 = 14;
/// Side in pixels of the blocks in which differences are shown.
const HEAT_BLOCK: usize = 2;
/// Points over a panel for E_dir at a pixel's sample.
const PANEL_POINTS: u32 = 4;

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
    source: &Source,
    measured: &Measured,
    camera: Option<SceneCamera>,
    (width, height): (u32, u32),
) -> Result<Vec<LightPictures>> {
    let bake = LoadedBake::load(source)?;
    let camera = camera.or_else(|| bake.manifest.cameras.first().cloned()).unwrap_or_else(|| {
        let (camera, note) = default_camera(&bake);
        eprintln!("note: {note}");
        camera
    });
    let size = PictureSize { width, height, grid: PATHS_A_SIDE };
    let draw = |result: &LightResult| {
        eprintln!("{}: pictures", result.light.name);
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
    let e_ind: Vec<Vec4> =
        result.settled.indirect.iter().flatten().map(|e| Vec4::new(e[0], e[1], e[2], 0.0)).collect();
    let pages = spread(&bake.atlas, &vec![Vec4::ZERO; e_ind.len()], &e_ind);
    let irradiance = |surface: &EyeSurface| -> DVec3 {
        let direct = reference.direct_irradiance(&surface.site, PANEL_POINTS);
        let place = measured.evaluator.world().lightmap_at(&surface.hit);
        let indirect = place.and_then(|(key, texel)| {
            let block = bake.atlas.block_index(key)?;
            Some(sample(&bake.atlas, &pages, block, texel.to_array()).as_dvec3())
        });
        direct + indirect.unwrap_or_default()
    };
    let progress = Progress::new();
    let baked = reference.picture_by(camera, size, &progress, irradiance).map_err(|error| failed(&error))?;
    let traced = reference.picture(camera, size, &progress).map_err(|error| failed(&error))?;
    let opaque: Vec<Vec4> = traced.radiance.iter().map(|l| Vec4::new(l[0], l[1], l[2], 1.0)).collect();
    let exposure = automatic_exposure(&opaque);
    let bitmap = |pixels: Vec<[u8; 4]>| Bitmap { width: size.width, height: size.height, pixels };
    let shown = |film: &Film| bitmap(developed(&film.radiance, exposure, Tone::Filmic));
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
        atlas: atlas(measured, result, bake),
    })
}

/// Signed difference over the mean luminance of the reference, in blocks of pixels, which halves the noise of paths.
fn compared(size: &PictureSize, baked: &Film, traced: &Film) -> Vec<[u8; 4]> {
    let of = |film: &Film| -> Vec<f64> {
        film.radiance.iter().map(|pixel| luminance(glam::Vec3::from(*pixel).as_dvec3())).collect()
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
