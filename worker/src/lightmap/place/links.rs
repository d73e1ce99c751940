//! Step "link": the neighbouring texels that no wall parts from a texel, see `Receivers::links`.

use std::sync::Arc;

use lightkiln_proto::content::LINKS;
use rayon::prelude::*;

use crate::geometry::Geometry;
use crate::lightmap::{Charts, Lightmap, World};
use crate::task::{Cancelled, Progress};

/// Distance in texels up to which the points of neighbouring texels may lie apart, of which one is a guest's: the diagonal of
/// two squares.
const GUEST_REACH: f32 = 2.9;

/// The lightmap with the links of every receiver.
pub fn linked(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    lightmap: Lightmap,
    progress: &Progress,
) -> Result<Lightmap, Cancelled> {
    let world = World::new(Arc::clone(geometry), charts, lightmap, progress);
    let receivers = 0..world.lightmap.receivers.len() as u32;
    let links_of = |index: u32| {
        progress.check()?;
        Ok(progress.casting(|| links_of(&world, index)))
    };
    let found: Vec<u8> = receivers.into_par_iter().map(links_of).collect::<Result<_, Cancelled>>()?;
    let mut lightmap = world.into_lightmap();
    for (receiver, links) in lightmap.receivers.iter_mut().zip(found) {
        receiver.links = links;
    }
    Ok(lightmap)
}

fn links_of(world: &World, index: u32) -> u8 {
    let receiver = &world.lightmap.receivers[index as usize];
    let mut links = 0;
    for (bit, [dx, dy]) in LINKS.into_iter().enumerate() {
        let [x, y] = receiver.texel.map(i32::from);
        let Some(other) = world.lightmap.receiver_at(receiver.block, x + dx, y + dy) else { continue };
        // Guests of two charts may lie side by side in the gutter.
        let is_guests = [index, other].iter().any(|&receiver| world.lightmap.is_guest(receiver));
        let other_m = world.lightmap.receivers[other as usize].position_m;
        if is_guests && receiver.position_m.distance(other_m) > GUEST_REACH * world.lightmap.texel_m_of(index)
        {
            continue;
        }
        if world.is_linked(world.raised_receiver(index), world.raised_receiver(other)) {
            links |= 1 << bit;
        }
    }
    links
}
