//! The cosine-distributed rays of a receiver, which every basis gathers light along.

use glam::Vec3;

use super::emitters::EmitterIrradianceSum;
use crate::prt::stage::Receiver;
use crate::prt::world::World;
use crate::rays::Hit;
use crate::rays::sampling::{R2, cosine_hemisphere, seed_of, tangent_frame};

/// A receiver's hemisphere.
pub struct Hemisphere<'a> {
    world: &'a World,
    receiver: &'a Receiver,
    /// Where rays start, in metres: the receiver's place, lifted off its surface.
    pub origin_m: Vec3,
    seed: u64,
    rays: u32,
}

impl<'a> Hemisphere<'a> {
    /// The hemisphere of a receiver. Its random numbers come from its block and texel alone.
    pub fn new(world: &'a World, receiver: &'a Receiver, rays: u32) -> Self {
        let [x, y] = receiver.texel.map(u64::from);
        let seed = seed_of(&[world.stage.blocks[receiver.block as usize].key, x, y, 3]);
        let origin_m = receiver.position_m + receiver.face_normal * world.geometry.tracer.ray_offset_m();
        Self { world, receiver, origin_m, seed, rays }
    }

    /// Casts the rays: calls `met` with each direction and what it meets, and gives the irradiance straight from
    /// emitters, W·m⁻², the mean length of the rays that met something, in metres, and the occlusion rays cast.
    pub fn cast(
        &self,
        emitter_rays: u32,
        mut met: impl FnMut(Vec3, Option<&Hit>),
    ) -> (Vec<[f32; 3]>, f32, u64) {
        let mut emitted =
            EmitterIrradianceSum::new(self.world, self.receiver, self.origin_m, self.rays, emitter_rays);
        let normal = self.receiver.normal;
        let (tangent, bitangent) = tangent_frame(normal);
        let points = R2::new(self.seed);
        let (mut path_m, mut hits) = (0.0, 0);
        for ray in 0..self.rays {
            let local = cosine_hemisphere(points.point(ray));
            let mut direction = tangent * local.x + bitangent * local.y + normal * local.z;
            // Where the shading normal leans, directions below the face are mirrored above it.
            let below = direction.dot(self.receiver.face_normal);
            if below < 0.0 {
                direction -= self.receiver.face_normal * (2.0 * below);
            }
            let hit = self.world.geometry.tracer.closest(self.origin_m, direction, f32::INFINITY);
            if let Some(hit) = &hit {
                (path_m, hits) = (path_m + hit.t, hits + 1);
                // Mirrored directions have another density than the weights know; sampling covers them alone.
                if below >= 0.0 {
                    emitted.add_hit(hit, direction);
                }
            }
            met(direction, hit.as_ref());
        }
        let rays_occlusion = emitted.sample_emitters(self.seed);
        (emitted.finish(), path_m / hits.max(1) as f32, rays_occlusion)
    }
}
