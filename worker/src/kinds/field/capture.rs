//! Light at a point as a probe holds it, by paths: coefficients of irradiance by normal, without that straight from points, spots, suns and
//! rectangles.
//!
//! `q_j = A_l 4π/N Σ_k Y_j(ω_k) L(ω_k)`, A_l = (π, 2π/3, π/4), for N rays that a seed turns. L is what the surface that a ray meets reflects,
//! or the sky. Emissive surfaces are sampled beside, and joined with the rays as for probes over patches.

use glam::{DVec3, Vec3};
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::kinds::field::PROBE_ROWS;

use super::gather::{turn, weights};
use crate::emitters::{EmitterSet, EmitterSphereSum};
use crate::geometry::{Geometry, Grid, Trail};
use crate::rays::sampling::seed_of;
use crate::reference::{Lighting, Reference};

/// Light of a scene's file: that of its lights and of emissive surfaces; `None` where it has none.
pub fn light_of_file(geometry: &Geometry) -> Option<Lighting> {
    let lights = geometry.scene.lights.clone();
    let is_lit = lights.iter().any(|light| light.strength != [0.0; 3]);
    let emits = geometry.scene.materials.iter().any(|material| material.emissive != [0.0; 3]);
    (is_lit || emits).then(|| Lighting { lights, emitter_scale: 1.0, ..Lighting::default() })
}

/// Coefficients of irradiance by normal, RGB, W·m⁻².
pub type Coefficients = [[f32; 3]; PROBE_ROWS];

/// Rays of a point.
#[derive(Clone, Copy, Debug)]
pub struct CaptureRays {
    /// From the point, spread over the sphere.
    pub rays: u32,
    /// Paths that go on from each surface that they meet.
    pub paths: u32,
    /// Shadow rays to emissive surfaces.
    pub emitter_rays: u32,
}

/// A scene under some light, ready to be captured.
pub struct Capture<'a> {
    geometry: &'a Geometry,
    emitters: &'a EmitterSet,
    reference: &'a Reference<'a>,
    emitter_scale: f32,
    /// Nobody asks what these rays cross: light comes from everywhere.
    grid: Grid,
}

impl<'a> Capture<'a> {
    /// Under the light of a reference, with emissive surfaces of that scale.
    pub fn new(
        geometry: &'a Geometry,
        emitters: &'a EmitterSet,
        reference: &'a Reference<'a>,
        emitter_scale: f32,
    ) -> Self {
        let grid = Grid::over(geometry.near_bounds_m(), geometry.near_diagonal_m());
        Self { geometry, emitters, reference, emitter_scale, grid }
    }

    /// A trail that nobody reads.
    pub fn trail(&self) -> Trail<'_> {
        Trail::new(&self.grid)
    }

    /// Light at a point.
    pub fn at(
        &self,
        position_m: Vec3,
        seed: u64,
        CaptureRays { rays, paths, emitter_rays }: CaptureRays,
    ) -> Coefficients {
        let turn = turn(seed);
        let mut emitted =
            EmitterSphereSum::new(self.geometry, self.emitters, position_m, [rays, emitter_rays]);
        let mut sums = [DVec3::ZERO; PROBE_ROWS];
        for ray in 0..rays {
            let direction = turn * relight_direction(ray, rays);
            let weights = weights(direction);
            let radiance = match self.geometry.tracer.met(position_m, direction, f32::INFINITY) {
                None => self.reference.sky(direction),
                Some(hit) => {
                    emitted.add_hit(&hit, direction, &weights);
                    self.reference.reflected(&hit, paths, seed_of(&[seed, 9, ray.into()]))
                }
            };
            sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += radiance * f64::from(weight));
        }
        emitted.sample(seed, &self.trail().from(position_m), weights);
        let of_ray = 4.0 * std::f64::consts::PI / f64::from(rays);
        let mut light = sums.map(|sum| (sum * of_ray).as_vec3().to_array());
        for of_emitter in emitted.finish() {
            let pairs = light.as_flattened_mut().iter_mut().zip(of_emitter.as_flattened());
            pairs.for_each(|(sum, own)| *sum += self.emitter_scale * own);
        }
        light
    }
}
