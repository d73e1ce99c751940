//! Which neighbouring texels no wall stands between, see `Receivers::links`.

use lightkiln_proto::prt::LINKS;
use rayon::prelude::*;

use crate::prt::world::World;

/// Links of every receiver of the stage, and the occlusion rays cast.
pub fn links(world: &World) -> (Vec<u8>, u64) {
    let found: Vec<(u8, u64)> =
        (0..world.stage.receivers.len() as u32).into_par_iter().map(|index| links_of(world, index)).collect();
    let rays = found.iter().map(|(_, rays)| rays).sum();
    (found.into_iter().map(|(links, _)| links).collect(), rays)
}

fn links_of(world: &World, index: u32) -> (u8, u64) {
    let receiver = &world.stage.receivers[index as usize];
    let (mut links, mut rays) = (0, 0);
    for (bit, [dx, dy]) in LINKS.into_iter().enumerate() {
        let [x, y] = receiver.texel.map(i32::from);
        let Some(other) = world.receiver_on(receiver.block, x + dx, y + dy) else { continue };
        rays += 1;
        if world.is_linked(world.raised_receiver(index), world.raised_receiver(other)) {
            links |= 1 << bit;
        }
    }
    (links, rays)
}
