//! Points that stand for what is seen of a texel.
//!
//! A thing that hovers over a part of a texel, as a keyboard on its feet or a sill, parts none of its points from the others, yet the light
//! under it is not that of the rest, which alone is seen. And a strip has a column of the 4 × 4 points, mostly beside its rim, or none:
//! there, light is gathered at a finer grid.

use glam::Vec2;
use lightkiln_proto::content::COVERAGE_POINTS;

use super::points::look_from;
use crate::geometry::Site;
use crate::lightmap::World;

/// Points along each side of the finer grid.
pub const FINE_SIDE: u32 = 8;
/// Points of the coverage below which light is gathered at the finer grid. More → truer strips, more rays of placement.
const COVERED_MIN: u32 = COVERAGE_POINTS / 2;
/// Share of the room that the most open point sees, below which a point under something is hidden.
const SEEN_SHARE_MIN: f32 = 0.25;
/// Open points that are asked how much they see.
const ASKED: usize = 3;

/// Place in the texel of a point of the finer grid.
pub fn fine_place(bit: u32) -> Vec2 {
    (Vec2::new((bit % FINE_SIDE) as f32, (bit / FINE_SIDE) as f32) + 0.5) / FINE_SIDE as f32
}

/// The points of `coverage` without those that something less than a texel above hides, if others see much more.
pub fn unhidden(world: &World, receiver: u32, coverage: u16) -> u16 {
    let covered = world.points_of(receiver).filter(|(bit, _)| coverage >> bit & 1 == 1);
    let (under, open): (Vec<(u32, Site)>, Vec<_>) =
        covered.partition(|(_, site)| is_under(world, receiver, site));
    if under.is_empty() || open.is_empty() {
        return coverage;
    }
    let seen = |site: &Site| look_from(world, receiver, site).seen;
    let every = open.len().div_ceil(ASKED);
    let most = open.iter().step_by(every).map(|(_, site)| seen(site)).fold(0.0, f32::max);
    let hidden = under.iter().filter(|(_, site)| seen(site) < SEEN_SHARE_MIN * most);
    hidden.fold(coverage, |coverage, (bit, _)| coverage & !(1 << bit))
}

/// The finer grid's points on the receiver's side, where the coverage has few; `sees` tells whether one is. 0 where no more of them lie there.
pub fn fine(world: &World, receiver: u32, coverage: u16, mut sees: impl FnMut(Vec2, &Site) -> bool) -> u64 {
    if coverage.count_ones() >= COVERED_MIN {
        return 0;
    }
    let is_own = |&bit: &u32| {
        let at = fine_place(bit);
        world.point_of(receiver, at).is_some_and(|site| sees(at, &site))
    };
    let fine = (0..FINE_SIDE * FINE_SIDE).filter(is_own).fold(0_u64, |fine, bit| fine | 1 << bit);
    if fine.count_ones() > coverage.count_ones() { fine } else { 0 }
}

/// Something stands less than a texel above a point.
fn is_under(world: &World, receiver: u32, site: &Site) -> bool {
    let tracer = &world.geometry.tracer;
    let from_m = site.ray_origin_m(tracer.ray_offset_m(site.position_m));
    tracer.met(from_m, site.face_normal, world.lightmap.texel_m_of(receiver)).is_some()
}
