//! Texels and bounds of space that are read to find the receiver that stands for a hit. Results that are kept by their reads need
//! them.

use glam::Vec3;

use super::Receiver;
use super::raised::Raised;
use super::world::{Found, LINKED_RINGS, Surface, World, link_height_m};

/// Farthest that a hit on a receiver's texel is expected from it, along each axis, in the scene's finest texels.
const AT_HAND_TEXELS: f32 = 1.5;

impl World {
    /// Block and texels, from the lowest to the highest, that tell what stands for a hit: its own, those beside it unless it has the
    /// receiver, and about the receiver's those that show whether walls are near, or that are looked at in its stead.
    pub fn texels_of_linking(&self, found: &Found) -> Option<(u32, [[i32; 2]; 2])> {
        let (block, place) = found.place?;
        let at = [place.x, place.y].map(|texel| texel.floor() as i32);
        let about = |[x, y]: [i32; 2], by: i32| [[x - by, y - by], [x + by, y + by]];
        let Surface::Receiver(own) = found.own else { return Some((block, about(at, 1))) };
        let texel = self.raised[own as usize].texel.map(i32::from);
        let looked_at = about(texel, if found.linked == found.own { 1 } else { LINKED_RINGS });
        let beside = about(at, i32::from(texel != at));
        let low = [0, 1].map(|axis| looked_at[0][axis].min(beside[0][axis]));
        let high = [0, 1].map(|axis| looked_at[1][axis].max(beside[1][axis]));
        Some((block, [low, high]))
    }

    /// The receiver of a hit that is one of most: on a texel that has it, with its light, and at most 1.5 of the scene's finest
    /// texels from it along each axis. All of one receiver lie in [`World::bounds_at_hand`], and the texels around its own tell what stands for them.
    pub fn at_hand(&self, found: &Found, point_m: Vec3) -> Option<u32> {
        let Surface::Receiver(own) = found.own else { return None };
        let from_m = (point_m - self.raised_receiver(own)).abs();
        let is_at_hand = found.is_on_texel
            && found.linked == found.own
            && from_m.max_element() <= AT_HAND_TEXELS * self.lightmap.texel_m;
        is_at_hand.then_some(own)
    }

    /// Bounds of all that is looked at to link any hit that is at hand of a receiver.
    pub fn bounds_at_hand(&self, receiver: u32) -> [Vec3; 2] {
        let Raised { at_m: own_m, texel_m, .. } = self.raised[receiver as usize];
        // Lifts may double from one shell of a scene to the next.
        let about_m = 2.0 * (link_height_m(texel_m) + self.geometry.tracer.ray_offset_m(own_m));
        let reach_m = AT_HAND_TEXELS * self.lightmap.texel_m + about_m;
        [own_m - reach_m, own_m + reach_m]
    }

    /// Bounds of all that is looked at to link a hit: of the raised points of hit and receivers, and above the hit.
    pub fn bounds_of_linking(&self, found: &Found, point_m: Vec3) -> [Vec3; 2] {
        let Surface::Receiver(own) = found.own else { return [point_m, point_m] };
        let Raised { at_m: own_m, texel_m, .. } = self.raised[own as usize];
        let about_m = 2.0 * link_height_m(texel_m) + self.geometry.tracer.ray_offset_m(point_m);
        let mut bounds_m = [own_m.min(point_m - about_m), own_m.max(point_m + about_m)];
        if found.linked != found.own {
            let Receiver { block, texel, .. } = self.lightmap.receivers[own as usize];
            let [x, y] = texel.map(i32::from);
            let ring = -LINKED_RINGS..=LINKED_RINGS;
            for (dx, dy) in ring.clone().flat_map(|dx| ring.clone().map(move |dy| (dx, dy))) {
                if let Some(other) = self.receiver_on(block, x + dx, y + dy) {
                    let other_m = self.raised_receiver(other);
                    bounds_m = [bounds_m[0].min(other_m), bounds_m[1].max(other_m)];
                }
            }
        }
        bounds_m
    }
}
