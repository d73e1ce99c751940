//! The cosine-distributed rays of a receiver, along which every kind gathers light.

use std::ops::Range;

use glam::Vec3;

use crate::emitters::{EmitterIrradianceSum, EmitterSet};
use crate::geometry::{Geometry, Site};
use crate::lightmap::World;
use crate::rays::Hit;
use crate::rays::sampling::{R2, cosine_hemisphere, tangent_frame};

/// A receiver's hemisphere: a cosine-weighted mean over those of its texel's points.
pub struct Hemisphere<'a> {
    geometry: &'a Geometry,
    emitters: &'a EmitterSet,
    site: Site,
    /// Points of the receiver's texel that rays leave from, at least one.
    texel: Vec<Site>,
    seed: u64,
    rays: u32,
}

/// A ray of a hemisphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HemisphereRay {
    /// Start in metres: a point of the texel, lifted off its surface.
    pub origin_m: Vec3,
    /// Unit direction.
    pub direction: Vec3,
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
        Self { geometry, emitters, site, texel: world.lit_points_of(receiver), seed, rays }
    }

    /// Start of rays from the receiver's own point, in metres.
    pub fn origin_m(&self) -> Vec3 {
        self.site.ray_origin_m(self.geometry.tracer.ray_offset_m())
    }

    /// Casts the rays: calls `met` with each and its hit, and gives the light straight from emitters.
    pub fn cast(&self, emitter_rays: u32, mut met: impl FnMut(HemisphereRay, Option<&Hit>)) -> Surroundings {
        let sites = (self.site, &self.texel[..]);
        let mut emitted =
            EmitterIrradianceSum::new(self.geometry, self.emitters, sites, self.rays, emitter_rays);
        let offset_m = self.geometry.tracer.ray_offset_m();
        let points = R2::new(self.seed);
        let (mut path_m, mut hits) = (0.0, 0);
        for (index, site) in self.texel.iter().enumerate() {
            let (origin_m, sky) = (site.ray_origin_m(offset_m), Sky::over(site));
            for ray in self.rays_of(index) {
                let (direction, is_mirrored) = sky.direction(points.point(ray));
                let hit = self.geometry.tracer.closest(origin_m, direction, f32::INFINITY);
                if let Some(hit) = &hit {
                    (path_m, hits) = (path_m + hit.t, hits + 1);
                    // Mirrored directions have another density than the weights know; sampling covers them alone.
                    if !is_mirrored {
                        emitted.add_hit(hit, direction, site.normal);
                    }
                }
                met(HemisphereRay { origin_m, direction }, hit.as_ref());
            }
        }
        let rays_occlusion = emitted.sample_emitters(self.seed);
        Surroundings { emitters: emitted.finish(), mean_path_m: path_m / hits.max(1) as f32, rays_occlusion }
    }

    /// Rays that leave from a point of the texel: a run of the sequence, as any run of it is spread evenly.
    fn rays_of(&self, point: usize) -> Range<u32> {
        let start = |point: usize| (u64::from(self.rays) * point as u64 / self.texel.len() as u64) as u32;
        start(point)..start(point + 1)
    }
}

/// Directions above a point of a surface.
struct Sky {
    tangent: Vec3,
    bitangent: Vec3,
    normal: Vec3,
    face_normal: Vec3,
}

impl Sky {
    fn over(site: &Site) -> Self {
        let Site { normal, face_normal, .. } = *site;
        let (tangent, bitangent) = tangent_frame(normal);
        Self { tangent, bitangent, normal, face_normal }
    }

    /// A cosine-distributed direction; where the shading normal leans, those below the face are mirrored above it.
    fn direction(&self, point: [f32; 2]) -> (Vec3, bool) {
        let local = cosine_hemisphere(point);
        let direction = self.tangent * local.x + self.bitangent * local.y + self.normal * local.z;
        let above = direction.dot(self.face_normal);
        if above < 0.0 { (direction - self.face_normal * (2.0 * above), true) } else { (direction, false) }
    }
}
