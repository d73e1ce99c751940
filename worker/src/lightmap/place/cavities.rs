//! Step "leave out": receivers in cavities, narrow places that nothing in the open sees, as the insides of hollow bars and
//! of panels whose faces are double-sided, or between the two sheets of a wall. They would cost as much as others, and light
//! that gets in by cracks is finer than any texel.
//!
//! We differ (METHOD.md §2.2): backs of faces tell that a receiver is inside a solid, and double-sided faces have none.

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::settings::PlaceSettings;
use rayon::prelude::*;

use crate::geometry::Geometry;
use crate::lightmap::{CAVITY, Charts, Lightmap, Receiver, Surface, World};
use crate::rays::sampling::{R2, seed_of, tangent_frame, uniform_hemisphere};
use crate::task::{Progress, TaskError};

/// Rays that measure how narrow it is around a receiver.
const PATH_RAYS: u32 = 32;
/// Length at which a path ends, in widths of narrow places: for the scene's typical path, and for the test of narrowness, as
/// at the end of a long slot a few paths would be long.
const PATH_MOST: [f32; 2] = [16.0, 2.0];
/// Share of the scene's typical path that no narrow place has: of a scene a few texels wide not all is a cavity.
const TYPICAL_SHARE: f32 = 0.25;
/// Rays that look for the open from a narrow place; a gap that lets one of them out is seen.
const LOOK_RAYS: u32 = 256;

/// How far above and below a texel's plane its surface is looked for beside its middle, in texels.
const BESIDE_HEIGHT: f32 = 0.02;
/// How far from its middle a texel reaches along the axes of any frame, in texels, about.
const BESIDE: f32 = 0.7;

/// Fate of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fate {
    Stays,
    /// To the point in metres that is seen of its texel.
    Moves(Vec3),
    Goes,
}

/// The lightmap without its receivers in cavities, and their number. Where only a part of a texel is seen, at a cavity's
/// mouth or beside its wall, the receiver moves there.
pub fn left_out(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    lightmap: Lightmap,
    settings: &PlaceSettings,
    progress: &Progress,
) -> Result<(Lightmap, usize), TaskError> {
    if settings.cavity_m == 0.0 {
        return Ok((lightmap, 0));
    }
    let world = World::new(Arc::clone(geometry), charts, lightmap, progress);
    let fates = fates(&world, settings, progress)?;
    let gone = fates.iter().filter(|fate| **fate == Fate::Goes).count();
    Ok((kept(world.into_lightmap(), &fates), gone))
}

/// The lightmap of those that stay, renumbered.
fn kept(lightmap: Lightmap, fates: &[Fate]) -> Lightmap {
    let mut receivers = Vec::with_capacity(fates.len());
    let mut number_of = Vec::with_capacity(fates.len());
    for (receiver, fate) in lightmap.receivers.iter().zip(fates) {
        number_of.push(if *fate == Fate::Goes { CAVITY } else { receivers.len() as u32 });
        match fate {
            Fate::Stays => receivers.push(*receiver),
            Fate::Moves(position_m) => receivers.push(Receiver { position_m: *position_m, ..*receiver }),
            Fate::Goes => {}
        }
    }
    let mut blocks = lightmap.blocks;
    for slot in blocks.iter_mut().flat_map(|block| &mut block.receiver_of_texel) {
        // Entries beyond the receivers' numbers say already why there is no receiver.
        *slot = number_of.get(*slot as usize).copied().unwrap_or(*slot);
    }
    Lightmap { blocks, receivers, ..lightmap }
}

fn fates(world: &World, settings: &PlaceSettings, progress: &Progress) -> Result<Vec<Fate>, TaskError> {
    let count = world.lightmap.receivers.len() as u32;
    let most_m = PATH_MOST.map(|most| most * settings.cavity_m);
    let mean_paths = |receiver: u32| {
        progress.check()?;
        Ok(progress.casting(|| mean_paths_m(world, receiver, most_m)))
    };
    let paths_m: Vec<[f32; 2]> =
        (0..count).into_par_iter().map(mean_paths).collect::<Result<_, TaskError>>()?;
    progress.check()?;
    let narrow_m = settings.cavity_m.min(TYPICAL_SHARE * typical_m(&paths_m));
    let is_open = |receiver: u32| paths_m[receiver as usize][1] >= narrow_m;
    (0..count)
        .into_par_iter()
        .map(|receiver| {
            progress.check()?;
            let fate = || if is_open(receiver) { Fate::Stays } else { fate(world, receiver, is_open) };
            Ok(progress.casting(fate))
        })
        .collect()
}

/// Cosine-weighted mean free paths above a receiver, each path cut off at each of `most_m`.
fn mean_paths_m(world: &World, receiver: u32, most_m: [f32; 2]) -> [f32; 2] {
    let mut sums_m = [0.0; 2];
    for ray in 0..PATH_RAYS {
        let (direction, cosine) = direction_of(world, receiver, ray);
        let met = world.geometry.tracer.closest(origin_m(world, receiver), direction, most_m[0]);
        let length_m = met.map_or(most_m[0], |hit| hit.t);
        sums_m = [0, 1].map(|which| sums_m[which] + 2.0 * cosine * length_m.min(most_m[which]));
    }
    sums_m.map(|sum_m| sum_m / PATH_RAYS as f32)
}

/// The length-weighted mean of paths: of a scene half of whose surfaces are in cavities, that of the others.
fn typical_m(paths_m: &[[f32; 2]]) -> f32 {
    let sum = |power: i32| paths_m.iter().map(|[path_m, _]| f64::from(*path_m).powi(power)).sum::<f64>();
    (sum(2) / sum(1).max(f64::MIN_POSITIVE)) as f32
}

/// Looks around from a narrow place, and then from all over its texel: whether a ray leaves the scene or meets a receiver
/// in the open.
fn fate(world: &World, receiver: u32, is_open: impl Fn(u32) -> bool) -> Fate {
    let tracer = &world.geometry.tracer;
    let middle_m = origin_m(world, receiver);
    let sees_open = |from_m: Vec3, ray: u32| {
        let (direction, _) = direction_of(world, receiver, PATH_RAYS + ray);
        let Some(hit) = tracer.closest(from_m, direction, f32::INFINITY) else { return true };
        // Of a texel that a wall cuts in two, the side that was met.
        let met = world.linked_surface_at(&hit, from_m + direction * hit.t);
        matches!(met, Surface::Receiver(met) if is_open(met))
    };
    if (0..LOOK_RAYS).any(|ray| sees_open(middle_m, ray)) {
        return Fate::Stays;
    }
    let normal = world.lightmap.receivers[receiver as usize].face_normal;
    let (tangent, bitangent) = tangent_frame(normal);
    let places = R2::new(seed_of(&[seed(world, receiver), 7]));
    let texel_m = world.lightmap.texel_m_of(receiver);
    let height_m = BESIDE_HEIGHT * texel_m;
    // A point beside the middle, if the surface goes on there.
    let beside = |ray| {
        let [u, v] = places.point(ray).map(|share| BESIDE * (2.0 * share - 1.0) * texel_m);
        let above_m = middle_m + tangent * u + bitangent * v + normal * height_m;
        let below = tracer.closest_surface(above_m, -normal, 2.0 * height_m)?;
        let goes_on = world.geometry.side_normal(&below).dot(normal) > 0.9 && !world.geometry.is_back(&below);
        goes_on.then(|| above_m - normal * below.t)
    };
    let seen = (0..LOOK_RAYS).find_map(|ray| {
        let at_m = beside(ray)?;
        sees_open(at_m + normal * tracer.ray_offset_m(at_m), ray).then_some(Fate::Moves(at_m))
    });
    seen.unwrap_or(Fate::Goes)
}

/// Seed of a receiver's rays.
fn seed(world: &World, receiver: u32) -> u64 {
    world.lightmap.seed_of(&world.lightmap.receivers[receiver as usize], 4)
}

/// Direction of a receiver's ray number `ray`, uniform over its hemisphere, and its cosine to the face's normal.
fn direction_of(world: &World, receiver: u32, ray: u32) -> (Vec3, f32) {
    let point = R2::new(seed(world, receiver)).point(ray);
    uniform_hemisphere(world.lightmap.receivers[receiver as usize].face_normal, point)
}

/// Where a receiver's rays start.
fn origin_m(world: &World, receiver: u32) -> Vec3 {
    let receiver = &world.lightmap.receivers[receiver as usize];
    receiver.position_m + receiver.face_normal * world.geometry.tracer.ray_offset_m(receiver.position_m)
}
