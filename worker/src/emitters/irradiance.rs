//! Irradiance straight from emissive surfaces, the mean over points of a receiver's texel: by sampling them from there and by
//! the rays that leave there.
//!
//! We differ from relighting emission like any other radiance (METHOD.md §2.7): a lamp is met by a handful of rays, so its
//! energy would be off by tens of percent at each receiver and its shadows blurred by the columns. Here both estimators are
//! weighted by the balance heuristic (\[Veach1995\]), so neither a small nor a near lamp is noisy; columns then carry only
//! light that has bounced.

use std::borrow::Cow;
use std::ops::Deref;
use std::sync::Arc;

use glam::Vec3;

use super::{EmissiveTriangle, emissive_triangles, radiance_of_emitters};
use crate::geometry::{Geometry, Site, Trail, weights_of};
use crate::rays::Hit;
use crate::rays::sampling::{R2, Sequence, seed_of, uniform_triangle};
use crate::scene::surface::{Footprint, SurfaceSample, surface_at};
use crate::task::{Context, TaskError};

/// Emissive triangles up to which each receiver weighs every one by the light it can get from it; beyond, all receivers
/// choose by power alone.
const BY_REACH_MAX: usize = 4096;

/// Fraction of the golden ratio: its multiples are spread evenly, any run of them.
const GOLDEN: f32 = 0.618_034;

/// Ratio of radiances that emitters are told apart by when chances are given out: chances only spread the noise, and an emitter
/// that becomes a little brighter shall leave them as they are.
const STRENGTH_STEP: f32 = 16.0;
/// Steps below the brightest emitter in which the others are.
const STRENGTH_STEPS: i32 = 3;

/// Radiance that irradiance is told for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Radiance {
    /// That of the emitters' materials.
    OfMaterials,
    /// 1 in each channel, wherever the texture is white: then materials may change afterwards.
    One,
}

/// A triangle with its chance where nothing else is known: area × mean radiance, the latter in steps.
#[derive(Clone, Copy, Debug)]
struct Weighted {
    of: EmissiveTriangle,
    power: f32,
}

impl Deref for Weighted {
    type Target = EmissiveTriangle;

    fn deref(&self) -> &EmissiveTriangle {
        &self.of
    }
}

/// All emissive triangles of a scene, ready to be sampled.
#[derive(Clone, Debug, Default)]
pub struct EmitterSet {
    triangles: Vec<Weighted>,
    /// Index into `triangles` of each triangle of the scene, or `u32::MAX`; empty when nothing emits.
    index_of: Vec<u32>,
    /// Radiance of each emitter's material.
    radiance: Vec<[f32; 3]>,
    /// Summed share of power of each triangle, where there are too many to weigh.
    by_power: Vec<f32>,
}

impl EmitterSet {
    /// Finds the emissive triangles.
    pub fn new(geometry: &Geometry) -> Self {
        let radiance = radiance_of_emitters(&geometry.scene);
        let strengths = strengths(&radiance);
        let mut set = Self { radiance, ..Self::default() };
        if set.radiance.is_empty() {
            return set;
        }
        set.index_of = vec![u32::MAX; geometry.triangles.len()];
        for of in emissive_triangles(geometry) {
            set.index_of[of.triangle as usize] = set.triangles.len() as u32;
            // A texture may be dark on the average and still hold a lamp: never below a hundredth of the whole.
            let glow = of.mean_glow.iter().sum::<f32>().max(0.03);
            let power = of.area_m2 * strengths[usize::from(of.emitter)] * glow;
            set.triangles.push(Weighted { of, power });
        }
        if set.triangles.len() > BY_REACH_MAX {
            set.by_power = summed(set.triangles.iter().map(|triangle| triangle.power));
        }
        set
    }

    /// Emitters: materials that emit.
    pub fn count(&self) -> usize {
        self.radiance.len()
    }

    /// Radiance of each emitter's material.
    pub fn radiance(&self) -> &[[f32; 3]] {
        &self.radiance
    }

    /// Emissive triangles.
    pub(super) fn len(&self) -> usize {
        self.triangles.len()
    }

    /// An emissive triangle, and its chance where nothing else is known.
    pub(super) fn emissive(&self, index: usize) -> (&EmissiveTriangle, f32) {
        let Weighted { of, power } = &self.triangles[index];
        (of, *power)
    }

    /// Number among the emissive triangles of a triangle of the scene.
    pub(super) fn index_of(&self, triangle: u32) -> Option<usize> {
        let index = *self.index_of.get(triangle as usize)?;
        (index != u32::MAX).then_some(index as usize)
    }

    /// Summed chances of all triangles, where there are too many to weigh.
    pub(super) fn by_power(&self) -> Option<&[f32]> {
        (!self.by_power.is_empty()).then_some(&self.by_power)
    }

    /// The surface at a point of an emissive triangle.
    pub(super) fn surface(&self, geometry: &Geometry, index: usize, barycentric: [f32; 2]) -> SurfaceSample {
        let Geometry { scene, images, triangles, .. } = geometry;
        let reference = triangles[self.triangles[index].triangle as usize];
        let weights = weights_of(barycentric).to_array();
        let (instance, local) = (reference.instance as usize, reference.triangle as usize);
        surface_at(scene, images, instance, local, weights, &Footprint::POINT)
    }

    /// Nothing emits.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Whether a triangle of the scene emits.
    pub fn is_emissive(&self, triangle: u32) -> bool {
        self.index_of(triangle).is_some()
    }

    /// The emissive triangles, each with its chance where nothing else is known, ascending.
    pub fn chances(&self) -> impl Iterator<Item = (&EmissiveTriangle, f32)> {
        self.triangles.iter().map(|triangle| (&triangle.of, triangle.power))
    }

    /// Emitters of the scene among a task's inputs, found once per worker.
    pub fn of(context: &Context, geometry: &Geometry) -> Result<Arc<Self>, TaskError> {
        context.memory.get_or_insert(context.digest(crate::scene::ARTEFACT)?, || {
            let set = Self::new(geometry);
            let bytes = 4 * set.index_of.len() + size_of::<Weighted>() * set.triangles.len();
            Ok((set, bytes))
        })
    }
}

/// Sums one receiver's irradiance from each emitter.
pub struct EmitterIrradianceSum<'a> {
    geometry: &'a Geometry,
    set: &'a EmitterSet,
    /// Points of the receiver's texel, at least one.
    texel: &'a [Site],
    own_rays: f32,
    samples: u32,
    /// Chance of each emissive triangle, summed; empty when none can reach the receiver.
    cumulative: Cow<'a, [f32]>,
    /// For radiance 1.
    sums: Vec<[f32; 3]>,
}

impl<'a> EmitterIrradianceSum<'a> {
    /// Nothing summed yet; `own_rays` cosine-distributed rays and `samples` shadow rays will be, these from the points of
    /// the texel in turn.
    pub fn new(
        geometry: &'a Geometry,
        set: &'a EmitterSet,
        (site, texel): (Site, &'a [Site]),
        own_rays: u32,
        samples: u32,
    ) -> Self {
        let cumulative = if set.by_power.is_empty() {
            let reach = Reach::of(site, texel, geometry.tracer.ray_offset_m(site.position_m));
            Cow::Owned(summed(set.triangles.iter().map(|triangle| reach.chance(triangle))))
        } else {
            Cow::Borrowed(set.by_power.as_slice())
        };
        let sums = vec![[0.0; 3]; set.radiance.len()];
        Self { geometry, set, texel, own_rays: own_rays as f32, samples, cumulative, sums }
    }

    /// Adds the emitter that one of the texel's own rays meets: `π/N · Lₑ` times its weight against sampling.
    pub fn add_hit(&mut self, hit: &Hit, direction: Vec3, normal: Vec3) {
        let set = self.set;
        let Some(index) = set.index_of(hit.triangle) else { return };
        let triangle = &set.triangles[index];
        if !hit.front && !triangle.double_sided {
            return;
        }
        let cosine = direction.dot(normal);
        if cosine <= 0.0 {
            return;
        }
        let own = self.own_rays * cosine / std::f32::consts::PI;
        let facing = triangle.normal.dot(direction).abs().max(1e-9);
        let sampled = self.samples as f32 * self.density(index) * hit.t * hit.t / facing;
        let surface = set.surface(self.geometry, index, hit.barycentric);
        self.add(
            triangle.emitter,
            surface.glow,
            std::f32::consts::PI / self.own_rays * own / (own + sampled),
        );
    }

    /// Casts the shadow rays.
    pub fn sample_emitters(&mut self, seed: u64, trail: &Trail) {
        if self.cumulative.is_empty() {
            return;
        }
        let points = R2::new(seed_of(&[seed, 4]));
        // Of its own seed: a stratum's place must not tell the point that is taken in it.
        let shift = Sequence::new(seed_of(&[seed, 6])).next_f32();
        let turn = Sequence::new(seed_of(&[seed, 7])).next_f32();
        for sample in 0..self.samples {
            let pick = (sample as f32 + shift) / self.samples as f32;
            let index = self.cumulative.partition_point(|sum| *sum <= pick).min(self.cumulative.len() - 1);
            // Of its own sequence: strata are those of triangles, and each is to be seen from all over the texel.
            let place = (sample as f32 * GOLDEN + turn).fract() * self.texel.len() as f32;
            let site = &self.texel[(place as usize).min(self.texel.len() - 1)];
            self.add_sample(site, index, uniform_triangle(points.point(sample)), trail);
        }
    }

    /// The sums, one per emitter, for the radiance that is asked for.
    pub fn finish(self, of: Radiance) -> Vec<[f32; 3]> {
        match of {
            Radiance::One => self.sums,
            Radiance::OfMaterials => {
                let all = self.sums.into_iter().zip(&self.set.radiance);
                all.map(|(sum, radiance)| [0, 1, 2].map(|channel| sum[channel] * radiance[channel])).collect()
            }
        }
    }

    /// `Lₑ cosθ_x cosθ_y / d² / density`, weighted against the texel's own rays.
    fn add_sample(&mut self, site: &Site, index: usize, barycentric: [f32; 2], trail: &Trail) {
        let triangle = &self.set.triangles[index];
        let weights = weights_of(barycentric);
        let [a, b, c] = triangle.corners;
        let point_m = a * weights.x + b * weights.y + c * weights.z;
        let origin_m = site.ray_origin_m(self.geometry.tracer.ray_offset_m(site.position_m));
        let to_light = point_m - origin_m;
        let squared_m2 = to_light.length_squared();
        let Some(direction) = to_light.try_normalize() else { return };
        let cosine = direction.dot(site.normal);
        let facing = -direction.dot(triangle.normal);
        let above = direction.dot(site.face_normal) > 0.0;
        if cosine <= 0.0 || !above || (facing <= 0.0 && !triangle.double_sided) || facing == 0.0 {
            return;
        }
        let offset_m = self.geometry.tracer.ray_offset_m(point_m);
        let lifted_m = point_m + triangle.normal * offset_m.copysign(facing);
        trail.from(origin_m).mark(lifted_m - origin_m, Some(1.0));
        let passed = self.geometry.tracer.passed(origin_m, lifted_m);
        if passed <= 0.0 {
            return;
        }
        let density = self.density(index) * squared_m2 / facing.abs();
        let sampled = self.samples as f32 * density;
        let own = self.own_rays * cosine / std::f32::consts::PI;
        let surface = self.set.surface(self.geometry, index, barycentric);
        // cosθ / (M · density) · M·density / (M·density + N·cosθ/π), of what is there and of what passes
        self.add(triangle.emitter, surface.glow, surface.stopped * passed * cosine / (sampled + own));
    }

    /// Density of sampled points on an emissive triangle, per m².
    fn density(&self, index: usize) -> f32 {
        let Some(&to) = self.cumulative.get(index) else { return 0.0 };
        let from = if index == 0 { 0.0 } else { self.cumulative[index - 1] };
        (to - from) / self.set.triangles[index].area_m2.max(1e-12)
    }

    fn add(&mut self, emitter: u16, glow: [f32; 3], factor: f32) {
        let sum = &mut self.sums[emitter as usize];
        sum.iter_mut().zip(glow).for_each(|(sum, glow)| *sum += glow * factor);
    }
}

/// Radiance of each emitter over that of the brightest, in steps.
fn strengths(radiance: &[[f32; 3]]) -> Vec<f32> {
    let sums: Vec<f32> = radiance.iter().map(|channels| channels.iter().sum()).collect();
    let brightest = sums.iter().fold(f32::MIN_POSITIVE, |most, sum| most.max(*sum));
    let strength = |sum: &f32| {
        let steps =
            (0..STRENGTH_STEPS).filter(|step| sum * STRENGTH_STEP.powi(*step) * 4.0 < brightest).count();
        STRENGTH_STEP.powi(-(steps as i32))
    };
    sums.iter().map(strength).collect()
}

/// Running sums of chances, normalised to end in 1; empty when all are 0.
pub(super) fn summed(chances: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut total = 0.0_f64;
    let sums: Vec<f64> = chances
        .map(|chance| {
            total += f64::from(chance);
            total
        })
        .collect();
    if total > 0.0 { sums.iter().map(|sum| (sum / total) as f32).collect() } else { Vec::new() }
}

/// A receiver, and how far the points of its texel may be from what it sees.
struct Reach {
    site: Site,
    origin_m: Vec3,
    /// Distance of the farthest point, in metres.
    slack_m: f32,
    /// Whether all have the receiver's normal.
    is_flat: bool,
}

impl Reach {
    fn of(site: Site, texel: &[Site], offset_m: f32) -> Self {
        let apart = |point: &Site| point.position_m.distance(site.position_m);
        Self {
            origin_m: site.ray_origin_m(offset_m),
            slack_m: texel.iter().map(apart).fold(0.0, f32::max),
            is_flat: texel.iter().all(|point| point.normal == site.normal),
            site,
        }
    }

    /// Chance, not yet normalised, that an emissive triangle is sampled; 0 only where no light can come from it.
    fn chance(&self, triangle: &Weighted) -> f32 {
        let Self { site, origin_m, slack_m, is_flat } = self;
        let above_m = |corner: &Vec3| (*corner - *origin_m).dot(site.normal);
        let before_m = (*origin_m - triangle.corners[0]).dot(triangle.normal);
        let behind = before_m <= -slack_m && !triangle.double_sided;
        let below = *is_flat && triangle.corners.iter().all(|corner| above_m(corner) <= -slack_m);
        if behind || below {
            return 0.0;
        }
        let centre_m = (triangle.corners[0] + triangle.corners[1] + triangle.corners[2]) / 3.0;
        triangle.power / (centre_m - *origin_m).length_squared().max(triangle.area_m2)
    }
}
