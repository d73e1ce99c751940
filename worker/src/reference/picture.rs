//! Pictures: linear radiance seen by a camera, a stratified grid of paths in each pixel.

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::SceneCamera;
use rayon::prelude::*;

use super::path::Walk;
use super::{Reference, Site};
use crate::rays::Hit;
use crate::rays::sampling::{Sequence, seed_of};
use crate::task::{Cancelled, Progress};

/// Size of a picture and its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureSize {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Samples along each side of a pixel; its square is cast. More → less noise, more time.
    pub grid: u32,
}

/// Radiance per pixel in W·m⁻²·sr⁻¹, row after row from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TracedPicture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Linear Rec.709.
    pub radiance: Vec<[f32; 3]>,
}

/// Surface that an eye's ray hits, for those who shade it by other means.
#[derive(Clone, Copy, Debug)]
pub struct EyeSurface {
    /// The hit.
    pub hit: Hit,
    /// The side that was met.
    pub site: Site,
    /// That side is lit.
    pub lit: bool,
    /// Albedo ρ.
    pub albedo: [f32; 3],
}

/// Origin and unit direction of the ray through a point of the picture, in pixels from its upper left corner.
pub fn camera_ray(camera: &SceneCamera, size: &PictureSize, [x, y]: [f32; 2]) -> (Vec3, Vec3) {
    let eye_m = Vec3::from(camera.eye_m);
    let forward = (Vec3::from(camera.target_m) - eye_m).normalize_or(Vec3::NEG_Z);
    let right = forward.cross(camera.up.into()).normalize_or(Vec3::X);
    let up = right.cross(forward);
    let aspect = size.width as f32 / size.height as f32;
    let across = (2.0 * x / size.width as f32 - 1.0) * aspect;
    let upward = 1.0 - 2.0 * y / size.height as f32;
    match camera.orthographic_half_height_m {
        Some(half_m) => (eye_m + (right * across + up * upward) * half_m, forward),
        None => {
            let tan = libm::tanf(0.5 * camera.fov_y_rad);
            (eye_m, (forward + (right * across + up * upward) * tan).normalize_or(forward))
        }
    }
}

impl Reference<'_> {
    /// The picture by paths.
    pub fn picture(
        &self,
        camera: &SceneCamera,
        size: &PictureSize,
        progress: &Progress,
    ) -> Result<TracedPicture, Cancelled> {
        let guide = self.guide(progress)?;
        traced(camera, size, progress, |origin_m, direction, seed| {
            let gathered = self.arriving(None, origin_m, direction, &mut Walk::new(seed, guide));
            gathered.rects + gathered.rest
        })
    }

    /// The picture along the same rays, where surfaces show `Lₑ + ρ/π · irradiance(surface)` and everything else is as
    /// in [`Reference::picture`].
    pub fn picture_by(
        &self,
        camera: &SceneCamera,
        size: &PictureSize,
        progress: &Progress,
        irradiance: impl Fn(&EyeSurface) -> DVec3 + Sync,
    ) -> Result<TracedPicture, Cancelled> {
        traced(camera, size, progress, |origin_m, direction, _| {
            let (straight, met) = self.seen(origin_m, direction);
            let Some(met) = met.filter(|met| met.lit) else { return straight };
            let albedo = Vec3::from(met.albedo).as_dvec3();
            straight + albedo / std::f64::consts::PI * irradiance(&met)
        })
    }
}

/// Casts the grid of every pixel; random numbers come from the pixel.
fn traced(
    camera: &SceneCamera,
    size: &PictureSize,
    progress: &Progress,
    radiance: impl Fn(Vec3, Vec3, u64) -> DVec3 + Sync,
) -> Result<TracedPicture, Cancelled> {
    let pixels: Vec<[f32; 3]> = (0..size.width * size.height)
        .into_par_iter()
        .map(|pixel| {
            progress.check()?;
            let (x, y) = (pixel % size.width, pixel / size.width);
            let own = |use_of: u64| Sequence::new(seed_of(&[u64::from(x), u64::from(y), use_of]));
            // Apart, so that pictures by other means look through the same points.
            let (mut jitter, mut random) = (own(22), own(25));
            let mut sum = DVec3::ZERO;
            for stratum in 0..size.grid * size.grid {
                let within = [stratum % size.grid, stratum / size.grid]
                    .map(|cell| (cell as f32 + jitter.next_f32()) / size.grid as f32);
                let at = [x as f32 + within[0], y as f32 + within[1]];
                let (origin_m, direction) = camera_ray(camera, size, at);
                sum += radiance(origin_m, direction, random.next_u64());
            }
            Ok((sum / f64::from(size.grid * size.grid)).as_vec3().to_array())
        })
        .collect::<Result<_, Cancelled>>()?;
    Ok(TracedPicture { width: size.width, height: size.height, radiance: pixels })
}
