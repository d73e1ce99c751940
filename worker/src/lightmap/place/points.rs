//! Step "points": which of a texel's 4 × 4 points lie on its receiver's own side of every wall, see `Receivers::coverage`.
//!
//! Those that see the receiver's point, both raised as for links, and those that see one of these beside them: so a
//! surface may bend, but no wall is crossed.

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::{COVERAGE_POINTS, COVERAGE_SIDE};
use rayon::prelude::*;

use crate::geometry::Geometry;
use crate::lightmap::{Charts, Lightmap, World};
use crate::task::Progress;

/// The lightmap with the points of every receiver's texel.
pub fn covered(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    lightmap: Lightmap,
    progress: &Progress,
) -> Lightmap {
    let world = World::new(Arc::clone(geometry), charts, lightmap);
    let receivers = 0..world.lightmap.receivers.len() as u32;
    let found: Vec<(u16, u64)> = receivers.into_par_iter().map(|index| coverage_of(&world, index)).collect();
    progress.add_rays_occlusion(found.iter().map(|(_, rays)| rays).sum());
    let mut lightmap = world.into_lightmap();
    for (receiver, (coverage, _)) in lightmap.receivers.iter_mut().zip(found) {
        receiver.coverage = coverage;
    }
    lightmap
}

/// The bits of a receiver, and the rays cast.
fn coverage_of(world: &World, receiver: u32) -> (u16, u64) {
    let mut raised_m = [None; COVERAGE_POINTS as usize];
    for (bit, site) in world.points_of(receiver) {
        let at_m = world.geometry.raised(site.position_m, site.face_normal, world.link_height_m());
        raised_m[bit as usize] = Some(at_m);
    }
    let (mut coverage, mut rays) = (0_u16, 0);
    let mut open: Vec<usize> = Vec::new();
    let mut add = |from_m: Vec3, bit: usize, coverage: &mut u16, open: &mut Vec<usize>| {
        let Some(at_m) = raised_m[bit] else { return };
        rays += 1;
        if *coverage & 1 << bit == 0 && world.is_linked(from_m, at_m) {
            *coverage |= 1 << bit;
            open.push(bit);
        }
    };
    for bit in 0..COVERAGE_POINTS as usize {
        add(world.raised_receiver(receiver), bit, &mut coverage, &mut open);
    }
    while let Some(bit) = open.pop() {
        let Some(from_m) = raised_m[bit] else { continue };
        for beside in beside(bit).filter(|beside| coverage & 1 << beside == 0).collect::<Vec<_>>() {
            add(from_m, beside, &mut coverage, &mut open);
        }
    }
    (coverage, rays)
}

/// The points left and right of a point, above and below it.
fn beside(bit: usize) -> impl Iterator<Item = usize> {
    let side = COVERAGE_SIDE as usize;
    let (x, y) = (bit % side, bit / side);
    let near = [(x > 0, bit.wrapping_sub(1)), (x + 1 < side, bit + 1)];
    let far = [(y > 0, bit.wrapping_sub(side)), (y + 1 < side, bit + side)];
    near.into_iter().chain(far).filter_map(|(is_there, bit)| is_there.then_some(bit))
}
