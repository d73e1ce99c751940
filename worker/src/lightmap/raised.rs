//! Raised points of receivers, and their texels, side by side: hits come from all over the lightmap, and reading them waits for memory.

use glam::Vec3;
use lightkiln_proto::content::Texel;
use rayon::prelude::*;

use super::Lightmap;
use super::world::link_height_m;
use crate::geometry::Geometry;
use crate::task::Progress;

/// Numbers of a receiver that every hit on it reads.
#[derive(Clone, Copy, Debug)]
pub struct Raised {
    /// Its point, raised as [`Geometry::raised`] does by [`link_height_m`] of its texel.
    pub at_m: Vec3,
    /// Side of its texel in metres.
    pub texel_m: f32,
    /// Its texel in its block.
    pub texel: Texel,
}

impl Raised {
    /// Of all receivers.
    pub fn of_all(geometry: &Geometry, lightmap: &Lightmap, progress: &Progress) -> Vec<Self> {
        let of_receiver = |receiver: &super::Receiver| {
            let texel_m = lightmap.blocks[receiver.block as usize].texel_m;
            let height_m = link_height_m(texel_m);
            let raised = || geometry.raised(receiver.position_m, receiver.face_normal, height_m);
            Self { at_m: progress.casting(raised), texel_m, texel: receiver.texel }
        };
        lightmap.receivers.par_iter().map(of_receiver).collect()
    }
}
