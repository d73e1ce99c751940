//! Light straight from emissive surfaces at a point in free space, as any weighted means over directions: by sampling them from there and
//! by the point's own rays, weighted by the balance heuristic as for receivers.

use std::borrow::Cow;

use glam::Vec3;

use super::irradiance::{EmitterSet, summed};
use crate::geometry::{Geometry, TrailFrom, weights_of};
use crate::rays::Hit;
use crate::rays::sampling::{R2, Sequence, seed_of, uniform_triangle};

/// Sums of `∫ Lₑ w_i(ω) dω` by emitter, for N weights w.
pub struct EmitterSphereSum<'a, const N: usize> {
    geometry: &'a Geometry,
    set: &'a EmitterSet,
    position_m: Vec3,
    own_rays: f32,
    samples: u32,
    /// Chance of each emissive triangle, summed; empty when none can reach the point.
    cumulative: Cow<'a, [f32]>,
    /// For radiance 1.
    sums: Vec<[[f32; 3]; N]>,
}

impl<'a, const N: usize> EmitterSphereSum<'a, N> {
    /// Nothing summed yet; so many of the point's own rays, spread evenly over the sphere, and so many shadow rays will be.
    pub fn new(
        geometry: &'a Geometry,
        set: &'a EmitterSet,
        position_m: Vec3,
        [own_rays, samples]: [u32; 2],
    ) -> Self {
        let cumulative = match set.by_power() {
            Some(sums) => Cow::Borrowed(sums),
            None => {
                let chance = |index: usize| {
                    let (triangle, power) = set.emissive(index);
                    let [a, b, c] = triangle.corners;
                    let is_behind = (position_m - a).dot(triangle.normal) <= 0.0 && !triangle.double_sided;
                    let squared_m2 = ((a + b + c) / 3.0 - position_m).length_squared();
                    if is_behind { 0.0 } else { power / squared_m2.max(triangle.area_m2) }
                };
                Cow::Owned(summed((0..set.len()).map(chance)))
            }
        };
        let sums = vec![[[0.0; 3]; N]; set.count()];
        Self { geometry, set, position_m, own_rays: own_rays as f32, samples, cumulative, sums }
    }

    /// Adds the emitter that one of the point's own rays meets.
    pub fn add_hit(&mut self, hit: &Hit, direction: Vec3, weights: &[f32; N]) {
        let Some(index) = self.set.index_of(hit.triangle) else { return };
        let (triangle, _) = self.set.emissive(index);
        if !hit.front && !triangle.double_sided {
            return;
        }
        let facing = triangle.normal.dot(direction).abs().max(1e-9);
        let sampled = self.samples as f32 * self.density(index) * hit.t * hit.t / facing;
        let glow = self.set.surface(self.geometry, index, hit.barycentric).glow;
        self.add(triangle.emitter, glow, 1.0 / (self.own() + sampled), weights);
    }

    /// Casts the shadow rays and marks their `trail`; `weights` are those of a direction.
    pub fn sample(&mut self, seed: u64, trail: &TrailFrom, weights: impl Fn(Vec3) -> [f32; N]) {
        if self.cumulative.is_empty() {
            return;
        }
        let points = R2::new(seed_of(&[seed, 4]));
        // Of its own seed: a stratum's place must not tell the point that is taken in it.
        let shift = Sequence::new(seed_of(&[seed, 6])).next_f32();
        for sample in 0..self.samples {
            let pick = (sample as f32 + shift) / self.samples as f32;
            let index = self.cumulative.partition_point(|sum| *sum <= pick).min(self.cumulative.len() - 1);
            self.add_sample(index, uniform_triangle(points.point(sample)), trail, &weights);
        }
    }

    /// The sums, one per emitter, for the radiance of materials.
    pub fn finish(self) -> Vec<[[f32; 3]; N]> {
        let of = |(sums, radiance): ([[f32; 3]; N], &[f32; 3])| {
            sums.map(|sum| [0, 1, 2].map(|channel| sum[channel] * radiance[channel]))
        };
        self.sums.into_iter().zip(self.set.radiance()).map(of).collect()
    }

    fn add_sample(
        &mut self,
        index: usize,
        barycentric: [f32; 2],
        trail: &TrailFrom,
        weights: impl Fn(Vec3) -> [f32; N],
    ) {
        let (triangle, _) = self.set.emissive(index);
        let corners = weights_of(barycentric);
        let [a, b, c] = triangle.corners;
        let point_m = a * corners.x + b * corners.y + c * corners.z;
        let to_light = point_m - self.position_m;
        let Some(direction) = to_light.try_normalize() else { return };
        let facing = -direction.dot(triangle.normal);
        if facing == 0.0 || (facing < 0.0 && !triangle.double_sided) {
            return;
        }
        let offset_m = self.geometry.tracer.ray_offset_m(point_m);
        let lifted_m = point_m + triangle.normal * offset_m.copysign(facing);
        trail.mark(lifted_m - self.position_m, Some(1.0));
        let passed = self.geometry.tracer.passed(self.position_m, lifted_m);
        if passed <= 0.0 {
            return;
        }
        let sampled = self.samples as f32 * self.density(index) * to_light.length_squared() / facing.abs();
        let surface = self.set.surface(self.geometry, index, barycentric);
        let factor = surface.stopped * passed / (sampled + self.own());
        self.add(triangle.emitter, surface.glow, factor, &weights(direction));
    }

    /// Own rays per steradian.
    fn own(&self) -> f32 {
        self.own_rays / (4.0 * std::f32::consts::PI)
    }

    /// Density of sampled points on an emissive triangle, per m².
    fn density(&self, index: usize) -> f32 {
        let Some(&to) = self.cumulative.get(index) else { return 0.0 };
        let from = if index == 0 { 0.0 } else { self.cumulative[index - 1] };
        (to - from) / self.set.emissive(index).0.area_m2.max(1e-12)
    }

    fn add(&mut self, emitter: u16, glow: [f32; 3], factor: f32, weights: &[f32; N]) {
        for (sum, weight) in self.sums[usize::from(emitter)].iter_mut().zip(weights) {
            sum.iter_mut().zip(glow).for_each(|(sum, glow)| *sum += glow * factor * weight);
        }
    }
}
