//! The cosine-distributed rays of a receiver, along which every kind gathers light.

use glam::Vec3;

use crate::emitters::{EmitterIrradianceSum, EmitterSet};
use crate::geometry::{Geometry, Site};
use crate::lightmap::World;
use crate::rays::Hit;
use crate::rays::sampling::{R2, cosine_hemisphere, tangent_frame};

/// A receiver's hemisphere.
pub struct Hemisphere<'a> {
    geometry: &'a Geometry,
    emitters: &'a EmitterSet,
    site: Site,
    /// Points of the receiver's texel, for light of emitters.
    texel: Vec<Site>,
    /// Start of the rays in metres: the receiver's place, lifted off its surface.
    pub origin_m: Vec3,
    seed: u64,
    rays: u32,
}

/// Findings that are the same for every kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surroundings {
    /// Irradiance straight from each emitter, W·m⁻².
    pub emitters: Vec<[f32; 3]>,
    /// Mean length of the rays that met something, in metres.
    pub mean_path_m: f32,
    /// Occlusion rays cast.
    pub rays_occlusion: u64,
}

impl<'a> Hemisphere<'a> {
    /// The hemisphere of a receiver, or of the one whose light it takes. Its random numbers come from block and texel alone.
    pub fn new(world: &'a World, emitters: &'a EmitterSet, receiver: u32, rays: u32) -> Self {
        let geometry = world.geometry.as_ref();
        let receiver = world.lightmap.receivers[receiver as usize].light_of;
        let own = &world.lightmap.receivers[receiver as usize];
        let (site, seed) = (own.site(), world.lightmap.seed_of(own, 3));
        let origin_m = site.ray_origin_m(geometry.tracer.ray_offset_m());
        let texel = if emitters.is_empty() { vec![site] } else { world.lit_points_of(receiver) };
        Self { geometry, emitters, site, texel, origin_m, seed, rays }
    }

    /// Casts the rays: calls `met` with each direction and its hit, and gives the light straight from emitters.
    pub fn cast(&self, emitter_rays: u32, mut met: impl FnMut(Vec3, Option<&Hit>)) -> Surroundings {
        let sites = (self.site, &self.texel[..]);
        let mut emitted =
            EmitterIrradianceSum::new(self.geometry, self.emitters, sites, self.rays, emitter_rays);
        let Site { normal, face_normal, .. } = self.site;
        let (tangent, bitangent) = tangent_frame(normal);
        let points = R2::new(self.seed);
        let (mut path_m, mut hits) = (0.0, 0);
        for ray in 0..self.rays {
            let local = cosine_hemisphere(points.point(ray));
            let mut direction = tangent * local.x + bitangent * local.y + normal * local.z;
            // Where the shading normal leans, directions below the face are mirrored above it.
            let below = direction.dot(face_normal);
            if below < 0.0 {
                direction -= face_normal * (2.0 * below);
            }
            let hit = self.geometry.tracer.closest(self.origin_m, direction, f32::INFINITY);
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
        Surroundings { emitters: emitted.finish(), mean_path_m: path_m / hits.max(1) as f32, rays_occlusion }
    }
}
