//! Finds receivers in cavities: narrow places that nothing in the open sees, as the insides of hollow bars and of panels
//! whose faces are double-sided, or between the two sheets of a wall. They would cost as much as others, and what light
//! gets in by cracks no texel tells.

use lightkiln_proto::prt::Settings;
use rayon::prelude::*;

use crate::prt::world::{Surface, World};
use crate::rays::Hit;
use crate::rays::sampling::{R2, seed_of, tangent_frame, uniform_sphere};
use crate::task::{Progress, TaskError};

/// Rays that measure how narrow it is around a receiver.
const PATH_RAYS: u32 = 32;
/// Length in texels at which their paths end.
const PATH_MAX_TEXELS: f32 = 32.0;
/// Share of the scene's typical path that no narrow place has: of a scene a few texels wide not all is a cavity.
const TYPICAL_SHARE: f32 = 0.25;
/// Rays that look for the open from a narrow place; a gap that lets one of them out is seen.
const LOOK_RAYS: u32 = 256;

/// Whether each receiver of the stage is to be kept.
pub fn kept(world: &World, settings: &Settings, progress: &Progress) -> Result<Vec<bool>, TaskError> {
    let count = world.stage.receivers.len() as u32;
    if settings.cavity_texels == 0.0 {
        return Ok(vec![true; count as usize]);
    }
    let paths: Vec<f32> = (0..count).into_par_iter().map(|receiver| path_texels(world, receiver)).collect();
    progress.add_rays_closest(u64::from(count) * u64::from(PATH_RAYS));
    progress.check()?;
    let narrow_texels = settings.cavity_texels.min(TYPICAL_SHARE * typical(&paths));
    let is_open = |receiver: u32| paths[receiver as usize] >= narrow_texels;
    let looked: Vec<(bool, u32)> = (0..count)
        .into_par_iter()
        .map(|receiver| {
            progress.check()?;
            Ok(if is_open(receiver) { (true, 0) } else { sees_open(world, receiver, is_open) })
        })
        .collect::<Result<_, TaskError>>()?;
    progress.add_rays_closest(looked.iter().map(|(_, rays)| u64::from(*rays)).sum());
    Ok(looked.into_iter().map(|(seen, _)| seen).collect())
}

/// Mean free path above a receiver in texels, weighted by cosines.
fn path_texels(world: &World, receiver: u32) -> f32 {
    let texel_m = world.stage.texel_m;
    let length_texels = |ray| {
        let (cosine, hit) = look(world, receiver, ray, PATH_MAX_TEXELS * texel_m);
        2.0 * cosine * hit.map_or(PATH_MAX_TEXELS, |hit| hit.t / texel_m)
    };
    (0..PATH_RAYS).map(length_texels).sum::<f32>() / PATH_RAYS as f32
}

/// The mean of paths where each counts as much as it is long: of a scene half of whose surfaces are in cavities, that of
/// the others.
fn typical(paths: &[f32]) -> f32 {
    let sum = |power: i32| paths.iter().map(|path| f64::from(*path).powi(power)).sum::<f64>();
    (sum(2) / sum(1).max(f64::MIN_POSITIVE)) as f32
}

/// Whether a look around from a receiver leaves the scene or meets a receiver in the open, and the rays cast.
fn sees_open(world: &World, receiver: u32, is_open: impl Fn(u32) -> bool) -> (bool, u32) {
    let meets_open = |ray| match look(world, receiver, ray, f32::INFINITY).1 {
        None => true,
        Some(hit) => matches!(world.surface_at(&hit), Surface::Receiver(met) if is_open(met)),
    };
    (0..LOOK_RAYS).find(|&ray| meets_open(ray)).map_or((false, LOOK_RAYS), |ray| (true, ray + 1))
}

/// What ray number `ray` of a receiver's, uniform over its hemisphere, meets up to `most_m`, and the ray's cosine.
fn look(world: &World, receiver: u32, ray: u32, most_m: f32) -> (f32, Option<Hit>) {
    let receiver = &world.stage.receivers[receiver as usize];
    let [x, y] = receiver.texel.map(u64::from);
    let points = R2::new(seed_of(&[world.stage.blocks[receiver.block as usize].key, x, y, 4]));
    let [u, v] = points.point(ray);
    let local = uniform_sphere(0.5 * u, v);
    let normal = receiver.face_normal;
    let (tangent, bitangent) = tangent_frame(normal);
    let direction = tangent * local.x + bitangent * local.y + normal * local.z;
    let tracer = &world.geometry.tracer;
    let origin_m = receiver.position_m + normal * tracer.ray_offset_m();
    (local.z, tracer.closest(origin_m, direction, most_m))
}
