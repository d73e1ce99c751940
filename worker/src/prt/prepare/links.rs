//! Which neighbouring texels no wall stands between, see `Receivers::links`.

use glam::Vec3;
use lightkiln_proto::prt::LINKS;
use rayon::prelude::*;

use crate::prt::stage::Receiver;
use crate::prt::world::World;

/// Links of every receiver of the stage, and the occlusion rays cast.
pub fn links(world: &World) -> (Vec<u8>, u64) {
    let found: Vec<(u8, u64)> =
        world.stage.receivers.par_iter().map(|receiver| links_of(world, receiver)).collect();
    let rays = found.iter().map(|(_, rays)| rays).sum();
    (found.into_iter().map(|(links, _)| links).collect(), rays)
}

fn links_of(world: &World, receiver: &Receiver) -> (u8, u64) {
    let (mut links, mut rays) = (0, 0);
    for (bit, [dx, dy]) in LINKS.into_iter().enumerate() {
        let [x, y] = receiver.texel.map(i32::from);
        let Some(other) = world.receiver_on(receiver.block, x + dx, y + dy) else { continue };
        let other = &world.stage.receivers[other as usize];
        rays += 1;
        if world.is_linked(raised(world, receiver), raised(world, other)) {
            links |= 1 << bit;
        }
    }
    (links, rays)
}

/// The receiver's point, raised above the surface as [`World::is_linked`] wants it.
fn raised(world: &World, receiver: &Receiver) -> Vec3 {
    receiver.position_m + receiver.face_normal * world.link_height_m()
}
