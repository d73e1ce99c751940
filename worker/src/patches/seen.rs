//! How much of a patch's light a receiver stands for: its surface, as far as it is seen from afar.
//!
//! A patch's radiance is a mean over its receivers, and whoever takes the patch whole stands some way off. Under a thing
//! that lies on a floor the floor is dark, and nobody afar sees it: counted by area, it would make the whole patch darker
//! for all.

use lightkiln_proto::content::AreaCode;
use rayon::prelude::*;

use crate::lightmap::World;
use crate::rays::sampling::{R2, cosine_hemisphere, tangent_frame};

/// Rays of a receiver that tell how far it is seen.
const RAYS: u32 = 64;
/// A ray that meets nothing up to this far is free, in texels.
const AFAR_TEXELS: f32 = 4.0;
/// Share of free rays from which on all of the surface counts: a texel beside a wall is seen from all of the room.
const SEEN_SHARE: f32 = 0.5;
/// Least share of a receiver's surface that counts, so that patches that nobody sees from afar have a mean too.
const LEAST: f32 = 1.0 / 32.0;
/// Purpose of a receiver's random numbers here.
const PURPOSE: u64 = 9;

/// Weight of each receiver in the mean of its patches, in texels.
pub fn weights(world: &World) -> Vec<AreaCode> {
    let receivers = 0..world.lightmap.receivers.len() as u32;
    receivers.into_par_iter().map(|receiver| weight(world, receiver)).collect()
}

fn weight(world: &World, receiver: u32) -> AreaCode {
    let own = &world.lightmap.receivers[receiver as usize];
    let tracer = &world.geometry.tracer;
    let (tangent, bitangent) = tangent_frame(own.face_normal);
    let origin_m = own.site().ray_origin_m(tracer.ray_offset_m());
    let points = R2::new(world.lightmap.seed_of(own, PURPOSE));
    let is_free = |ray: &u32| {
        let local = cosine_hemisphere(points.point(*ray));
        let direction = tangent * local.x + bitangent * local.y + own.face_normal * local.z;
        !tracer.is_occluded(origin_m, origin_m + direction * (AFAR_TEXELS * world.lightmap.texel_m))
    };
    let free = (0..RAYS).filter(is_free).count() as f32 / RAYS as f32;
    AreaCode::of(own.area.texels() * (free / SEEN_SHARE).clamp(LEAST, 1.0))
}
