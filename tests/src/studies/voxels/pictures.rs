//! Pictures in the form of the paper's 6.14 and 6.16 to 6.20, side by side in one file each.

use std::path::Path;

use anyhow::{Context, Result};
use glam::Vec3;
use lightkiln_client::picture::{Tone, developed, write_png};
use lightkiln_proto::voxels::{
    Bundle, IRRADIANCE_WALKS, OCCLUSION_REACH_M, OCCLUSION_WALKS, Start, ambient_occlusion, irradiance,
};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::rays::Hit;
use lightkiln_worker::reference::{PictureSize, camera_ray, luminance};
use rayon::prelude::*;

use super::build::{Build, built};
use super::cone::Volume;
use super::fill::surface_of;
use super::inject::Lamp;
use super::measure::Stage;
use super::{Kind, Manner, Model};

/// Pixels of a picture.
const SIZE: [u32; 2] = [144, 108];
/// Pixels between pictures.
const GAP: u32 = 2;
/// Diffuse cones where they are not varied.
const CONES: u32 = 6;
/// Luminance that direct light of a picture is brought to.
const GREY: f64 = 0.25;

/// Pixels of one picture.
type Pixels = Vec<[u8; 4]>;

/// The camera's pixels, and the light of their surfaces.
struct Shown<'a> {
    stage: &'a Stage<'a>,
    lamp: Lamp,
    build: Build,
    /// Hit and side of each pixel, with albedo and direct irradiance.
    pixels: Vec<Option<Pixel>>,
    exposure: f32,
}

struct Pixel {
    site: Site,
    albedo: Vec3,
    direct: Vec3,
    number: u32,
}

/// Bounced light and ambient occlusion of a pixel.
type Bounced<'a> = &'a (dyn Fn(&Pixel) -> (Vec3, f32) + Sync);

/// Writes the pictures of a scene into a folder.
pub fn pictures(stage: &Stage, lamp: Lamp, build: Build, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("make {}", folder.display()))?;
    let shown = Shown::new(stage, lamp, build)?;
    let write = |name: &str, row: &[Pixels]| side_by_side(&folder.join(format!("{name}.png")), row);
    let written = |model| Kind { model, manner: Manner::Written };
    let mended = |model| Kind { model, manner: Manner::Mended };
    let axes = shown.volume(written(Model::Axes), build.depth);
    let by = |volume: &Volume, count: u32| -> Vec<(Vec3, f32)> {
        shown.bounced(&|pixel| {
            let sky = |direction: Vec3| stage.lights.light.of_sky(direction);
            let found = volume.diffuse(
                (pixel.site.position_m, pixel.site.face_normal),
                count,
                OCCLUSION_REACH_M,
                sky,
            );
            (found.irradiance, found.open)
        })
    };
    let six = by(&axes, CONES);
    let none = vec![(Vec3::ZERO, 1.0); shown.pixels.len()];
    write("6-16", &[shown.lit(&none), shown.lit_with_occlusion(&six), shown.occlusion(&six)])?;
    let models: Vec<Pixels> =
        Kind::ALL.iter().map(|kind| shown.lit(&by(&shown.volume(*kind, build.depth), CONES))).collect();
    write("6-17", &models)?;
    let depths: Vec<Vec<(Vec3, f32)>> =
        [6, 7, 8].iter().map(|depth| by(&shown.volume(written(Model::Axes), *depth), CONES)).collect();
    write("6-18", &depths.iter().map(|light| shown.lit_with_occlusion(light)).collect::<Vec<_>>())?;
    write("6-20", &depths.iter().map(|light| shown.occlusion(light)).collect::<Vec<_>>())?;
    let counts = [4, 6, 8, 12].map(|count| shown.lit_with_occlusion(&by(&axes, count)));
    write("6-19", &counts)?;
    let truth = shown.bounced(&|pixel| shown.by_rays(pixel));
    let walks = shown.bounced(&|pixel| shown.by_walks(pixel));
    let mended = by(&shown.volume(mended(Model::Axes), build.depth), CONES);
    write(
        "6-14",
        &[
            shown.lit(&truth),
            shown.lit(&mended),
            shown.difference(&mended, &truth),
            shown.lit(&walks),
            shown.difference(&walks, &truth),
        ],
    )
}

impl<'a> Shown<'a> {
    fn new(stage: &'a Stage<'a>, lamp: Lamp, build: Build) -> Result<Self> {
        let geometry = &stage.lights.held.world.geometry;
        let camera = geometry.scene.cameras.first().context("the scene has no camera")?;
        let [width, height] = SIZE;
        let size = PictureSize { width, height, grid: 1 };
        let of = |number: u32| {
            let at = [number % width, number / width].map(|at| at as f32 + 0.5);
            let (eye_m, direction) = camera_ray(camera, &size, at);
            let hit: Hit = geometry.tracer.closest(eye_m, direction, f32::INFINITY)?;
            let site = geometry.site_at(&hit);
            let albedo = Vec3::from(surface_of(geometry, &hit).albedo);
            Some(Pixel { site, albedo, direct: stage.direct.direct_irradiance(&site, 1).as_vec3(), number })
        };
        let pixels: Vec<Option<Pixel>> = (0..width * height).into_par_iter().map(of).collect();
        let direct = |pixel: &Pixel| luminance((pixel.albedo * pixel.direct).as_dvec3());
        let mean = pixels.iter().flatten().map(direct).sum::<f64>() / pixels.len() as f64;
        let exposure = (GREY * std::f64::consts::PI / mean.max(f64::MIN_POSITIVE)) as f32;
        Ok(Self { stage, lamp, build, pixels, exposure })
    }

    fn volume(&self, kind: Kind, depth: u32) -> Volume {
        let lights = &self.stage.lights;
        let build = Build { depth, ..self.build };
        built(&lights.held.world.geometry, kind, &build, Some(&self.lamp), |hit| lights.of_hit(hit)).volume
    }

    fn bounced(&self, of: Bounced) -> Vec<(Vec3, f32)> {
        self.pixels.par_iter().map(|pixel| pixel.as_ref().map_or((Vec3::ZERO, 1.0), of)).collect()
    }

    /// Bounced light by rays that meet the bake's.
    fn by_rays(&self, pixel: &Pixel) -> (Vec3, f32) {
        let bundle = Bundle::new(4 * IRRADIANCE_WALKS, pixel.number);
        let along = |ray: u32| {
            self.stage.lights.by_ray(&pixel.site, bundle.cosine(ray, pixel.site.face_normal).direction)
        };
        let sum: Vec3 = (0..bundle.walks()).map(along).sum();
        (sum * (std::f32::consts::PI / bundle.walks() as f32), 1.0)
    }

    fn by_walks(&self, pixel: &Pixel) -> (Vec3, f32) {
        let lights = &self.stage.lights;
        let Site { position_m, face_normal, .. } = pixel.site;
        let start = Start::on(position_m, face_normal);
        let bundle = |walks: u32| Bundle::new(walks, pixel.number);
        let light = irradiance(lights.table, &start, face_normal, &bundle(IRRADIANCE_WALKS), |seen| {
            lights.light.radiance(seen)
        });
        let open =
            ambient_occlusion(lights.table, &start, face_normal, &bundle(OCCLUSION_WALKS), OCCLUSION_REACH_M);
        (light, open)
    }

    fn shaded(&self, of: impl Fn(&Pixel, usize) -> Vec3) -> Pixels {
        let radiance: Vec<[f32; 3]> = (self.pixels.iter().enumerate())
            .map(|(at, pixel)| pixel.as_ref().map_or(Vec3::ZERO, |pixel| of(pixel, at)).to_array())
            .collect();
        developed(&radiance, self.exposure, Tone::Reinhard)
    }

    fn lit(&self, bounced: &[(Vec3, f32)]) -> Pixels {
        self.shaded(|pixel, at| pixel.albedo * (pixel.direct + bounced[at].0) / std::f32::consts::PI)
    }

    /// As the paper's: bounced light times ambient occlusion.
    fn lit_with_occlusion(&self, bounced: &[(Vec3, f32)]) -> Pixels {
        let light = |at: usize| bounced[at].0 * bounced[at].1;
        self.shaded(|pixel, at| pixel.albedo * (pixel.direct + light(at)) / std::f32::consts::PI)
    }

    fn occlusion(&self, bounced: &[(Vec3, f32)]) -> Pixels {
        let grey: Vec<[f32; 3]> = bounced.iter().map(|(_, open)| [open.clamp(0.0, 1.0); 3]).collect();
        developed(&grey, 1.0, Tone::Linear)
    }

    /// Where bounced light is too bright red, where it is too dark blue.
    fn difference(&self, found: &[(Vec3, f32)], truth: &[(Vec3, f32)]) -> Pixels {
        let of = |light: &(Vec3, f32)| luminance(light.0.as_dvec3());
        let mean = truth.iter().map(of).sum::<f64>() / truth.len() as f64;
        let coloured = |(found, truth): (&(Vec3, f32), &(Vec3, f32))| {
            let off = ((of(found) - of(truth)) / mean) as f32;
            [off.max(0.0), 0.0, (-off).max(0.0)]
        };
        developed(&found.iter().zip(truth).map(coloured).collect::<Vec<_>>(), 1.0, Tone::Linear)
    }
}

fn side_by_side(path: &Path, row: &[Pixels]) -> Result<()> {
    let [width, height] = SIZE;
    let count = row.len() as u32;
    let across = count * width + (count - 1) * GAP;
    let mut all = vec![[255; 4]; (across * height) as usize];
    for (number, pixels) in row.iter().enumerate() {
        let left = number as u32 * (width + GAP);
        for (at, pixel) in pixels.iter().enumerate() {
            let (x, y) = (left + at as u32 % width, at as u32 / width);
            all[(y * across + x) as usize] = *pixel;
        }
    }
    Ok(write_png(path, across, height, &all)?)
}
