//! The cosine-distributed rays of a receiver, along which every kind gathers light.

use std::ops::Range;

use glam::Vec3;

use crate::emitters::{EmitterIrradianceSum, EmitterSet, Radiance};
use crate::geometry::{Geometry, Site, Trail};
use crate::lightmap::World;
use crate::rays::Hit;
use crate::rays::sampling::R2;

/// A receiver's hemisphere: a cosine-weighted mean over those of its texel's points.
pub struct Hemisphere<'a> {
    geometry: &'a Geometry,
    emitters: &'a EmitterSet,
    site: Site,
    /// Points of the receiver's texel that rays leave from, at least one.
    texel: Vec<Site>,
    seed: u64,
    rays: u32,
    radiance: Radiance,
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
}

impl<'a> Hemisphere<'a> {
    /// The hemisphere of a receiver, or of the one whose light it takes. Its random numbers come from block and texel alone.
    pub fn new(world: &'a World, emitters: &'a EmitterSet, receiver: u32, rays: u32) -> Self {
        let geometry = world.geometry.as_ref();
        let lender = world.lightmap.receivers[receiver as usize].light_of;
        let own = &world.lightmap.receivers[lender as usize];
        let (site, seed) = (own.site(), world.lightmap.seed_of(own, 3));
        Self {
            geometry,
            emitters,
            site,
            texel: world.gathering_points_of(receiver),
            seed,
            rays,
            radiance: Radiance::OfMaterials,
        }
    }

    /// The same, with the light of emitters told for that radiance.
    #[must_use]
    pub fn for_radiance(self, radiance: Radiance) -> Self {
        Self { radiance, ..self }
    }

    /// Start of rays from the receiver's own point, in metres.
    pub fn origin_m(&self) -> Vec3 {
        self.site.ray_origin_m(self.geometry.tracer.ray_offset_m(self.site.position_m))
    }

    /// Casts the rays: marks their `trail`, calls `met` with each and its hit, and gives the light straight from emitters.
    pub fn cast(
        &self,
        emitter_rays: u32,
        trail: &Trail,
        mut met: impl FnMut(HemisphereRay, Option<&Hit>),
    ) -> Surroundings {
        let mut emitted = self.emitted(emitter_rays);
        let points = R2::new(self.seed);
        let (mut path_m, mut hits) = (0.0, 0);
        for (index, site) in self.texel.iter().enumerate() {
            let offset_m = self.geometry.tracer.ray_offset_m(site.position_m);
            let (origin_m, directions) = (site.ray_origin_m(offset_m), site.directions());
            let trail = trail.from(origin_m);
            for ray in self.rays_of(index) {
                let (direction, is_mirrored) = directions.at(points.point(ray));
                let hit = self.geometry.tracer.met(origin_m, direction, f32::INFINITY);
                trail.mark(direction, hit.map(|hit| hit.t));
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
        emitted.sample_emitters(self.seed, trail);
        Surroundings { emitters: emitted.finish(self.radiance), mean_path_m: path_m / hits.max(1) as f32 }
    }

    fn emitted(&self, emitter_rays: u32) -> EmitterIrradianceSum<'_> {
        let sites = (self.site, &self.texel[..]);
        EmitterIrradianceSum::new(self.geometry, self.emitters, sites, self.rays, emitter_rays)
    }

    /// Rays that leave from a point of the texel: a run of the sequence, as any run of it is spread evenly.
    fn rays_of(&self, point: usize) -> Range<u32> {
        let start = |point: usize| (u64::from(self.rays) * point as u64 / self.texel.len() as u64) as u32;
        start(point)..start(point + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::scene::model::Scene;

    #[test]
    fn rays_of_a_point_are_spread_about_its_own_normal() {
        let geometry = Geometry::new(Scene::default()).unwrap();
        let normals = [Vec3::X, Vec3::Y, Vec3::new(0.6, 0.0, 0.8)];
        let texel = normals.map(|normal| Site { position_m: normal, normal, face_normal: normal }).to_vec();
        let (site, emitters) =
            (Site { normal: Vec3::Z, face_normal: Vec3::Z, ..texel[0] }, EmitterSet::default());
        let hemisphere = Hemisphere {
            geometry: &geometry,
            emitters: &emitters,
            site,
            texel,
            seed: 5,
            rays: 3 * 4096,
            radiance: Radiance::One,
        };
        let grid = Grid::default();
        let mut sums = [Vec3::ZERO; 3];
        hemisphere.cast(0, &Trail::new(&grid), |ray, _| {
            let point = normals.iter().position(|normal| ray.origin_m.distance(*normal) < 0.1).unwrap();
            sums[point] += ray.direction / 4096.0;
        });
        // The mean of cosine-distributed directions is 2/3 n.
        for (sum, normal) in sums.into_iter().zip(normals) {
            assert!(sum.distance(normal * (2.0 / 3.0)) < 3e-3, "{sum} about {normal}");
        }
    }
}
