//! Points in free space.

use anyhow::{Context, Result};
use glam::Vec3;
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_worker::geometry::Geometry;
use lightkiln_worker::rays::sampling::{Sequence, seed_of};

/// Points that are tried for each that is wanted.
const TRIES: usize = 100;
/// Rays that look whether a point is free.
const RAYS: u32 = 32;

/// So many free points of a box, farther than `off_m` from all surfaces that rays meet, in sight of no back. Errs where next to none is free.
pub fn free_points(
    geometry: &Geometry,
    [low_m, high_m]: [Vec3; 2],
    off_m: f32,
    count: usize,
) -> Result<Vec<Vec3>> {
    let mut numbers = Sequence::new(seed_of(&[77]));
    let is_free = |point_m: &Vec3| {
        (0..RAYS).all(|ray| {
            let hit = geometry.tracer.closest(*point_m, relight_direction(ray, RAYS), f32::INFINITY);
            hit.is_none_or(|hit| hit.t > off_m && !geometry.is_back(&hit))
        })
    };
    let point = |_| low_m + (high_m - low_m) * Vec3::from([(); 3].map(|()| numbers.next_f32()));
    let points: Vec<Vec3> = (0..TRIES * count).map(point).filter(is_free).take(count).collect();
    (points.len() == count).then_some(points).context("next to no free space")
}
