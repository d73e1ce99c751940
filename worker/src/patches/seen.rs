//! Seen areas of receivers: their weights in the mean radiance of patches.
//!
//! A receiver in a fold or behind a moulding gets less light than those beside it, and fewer rays of what is far meet it: as
//! many as those of its own that meet what is far (METHOD.md §2.3). A mean by area counts its darkness as if all of it were
//! seen, and each bounce off a patch that is read as a whole loses light.

use lightkiln_proto::content::AreaCode;
use rayon::prelude::*;

use crate::lightmap::World;
use crate::rays::sampling::{R2, cosine_hemisphere, tangent_frame};
use crate::task::{Progress, TaskError};

/// From this distance on a ray counts whole, in texels; nearer ones count by the square of their length, as cells open patches
/// that are near. More → light in deeper folds is told apart.
const FAR_TEXELS: f32 = 12.0;
/// Least share, so that no patch is without weight.
const SHARE_MIN: f32 = 1.0 / 512.0;
/// Rays of a receiver.
const RAYS: u32 = 32;

/// Seen areas of all receivers of the lightmap, METHOD.md (4a); of a thing that is looked at `from_around`, what sees nothing of it is seen.
///
/// Errors soon after `progress` is cancelled.
pub fn seen_areas(world: &World, from_around: bool, progress: &Progress) -> Result<Vec<AreaCode>, TaskError> {
    let seen_area = |receiver: u32| {
        progress.check()?;
        let area = world.lightmap.receivers[receiver as usize].area;
        // Guests are in no patch.
        if world.lightmap.is_guest(receiver) {
            return Ok(area);
        }
        let share = progress.casting(|| seen_share(world, from_around, receiver)).max(SHARE_MIN);
        Ok(AreaCode::of(area.texels() * share))
    };
    (0..world.lightmap.receivers.len() as u32).into_par_iter().map(seen_area).collect()
}

/// `1/n Σ min(1, t/12 texels)²` over a receiver's n cosine-distributed rays that meet the front of a surface at t, 0 for the others, but 1 for
/// those of a thing looked at from around that leave it.
fn seen_share(world: &World, from_around: bool, index: u32) -> f32 {
    let receiver = &world.lightmap.receivers[index as usize];
    let directions = R2::new(world.lightmap.seed_of(receiver, 6));
    let (tangent, bitangent) = tangent_frame(receiver.face_normal);
    let start_m = world.geometry.lifted(receiver.position_m, receiver.face_normal);
    let far_m = FAR_TEXELS * world.lightmap.texel_m_of(index);
    let share = |ray: u32| {
        let local = cosine_hemisphere(directions.point(ray));
        let direction = tangent * local.x + bitangent * local.y + receiver.face_normal * local.z;
        let met = world.geometry.tracer.closest(start_m, direction, f32::INFINITY);
        match met {
            None => f32::from(u8::from(from_around)),
            Some(hit) if world.geometry.is_back(&hit) => 0.0,
            Some(hit) => (hit.t / far_m).min(1.0).powi(2),
        }
    };
    (0..RAYS).map(share).sum::<f32>() / RAYS as f32
}
