//! Paths: light of each vertex from lamps that it samples, and from the surface that its direction hits.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::emitters::{Chances, emission_of};
use super::guide::{Finding, Guide, SQUARE, cell_at, square_of};
use super::punctual::Target;
use super::sky::SkySample;
use super::tally::luminance;
use super::{EyeSurface, Reference, Site};
use crate::geometry::{Geometry, weights_of};
use crate::rays::Hit;
use crate::rays::sampling::Sequence;
use crate::scene::surface::{Footprint, SurfaceSample, surface_at};

/// Vertices before Russian roulette begins. More → less noise of long paths, more time.
const ROULETTE_FROM: u32 = 4;
/// Highest chance to go on, so that every path ends.
const SURVIVAL_MAX: f64 = 0.98;

/// Random numbers for one vertex' lamps.
#[derive(Clone, Copy, Debug)]
pub(super) struct LampPoints {
    pub pick: f32,
    pub point: [f32; 2],
}

impl LampPoints {
    fn next(random: &mut Sequence) -> Self {
        Self { pick: random.next_f32(), point: [random.next_f32(), random.next_f32()] }
    }
}

/// A path under way.
pub(super) struct Walk<'g> {
    pub random: Sequence,
    /// Where lamps' rays are tried; `None`: nowhere.
    guide: Option<&'g Guide>,
    /// Light that tries brought, if it is asked for.
    findings: Option<Vec<Finding>>,
}

impl<'g> Walk<'g> {
    /// A path of a seed.
    pub fn new(seed: u64, guide: Option<&'g Guide>) -> Self {
        Self { random: Sequence::new(seed), guide, findings: None }
    }

    /// A path that tells its findings.
    pub fn telling(seed: u64, guide: &'g Guide) -> Self {
        Self { findings: Some(Vec::new()), ..Self::new(seed, Some(guide)) }
    }

    /// The findings told.
    pub fn into_findings(self) -> Vec<Finding> {
        self.findings.unwrap_or_default()
    }

    fn tell(&mut self, region: u32, cell: u32, light: DVec3) {
        let light = luminance(light);
        if let Some(findings) = self.findings.as_mut().filter(|_| light > 0.0) {
            findings.push(Finding { region, cell, light });
        }
    }
}

/// Light by where it came from.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gathered {
    /// Straight from rectangles.
    pub rects: DVec3,
    /// Everything else that rays and samples find.
    pub rest: DVec3,
}

/// The surface that a ray hit.
#[derive(Clone, Copy, Debug)]
pub(super) struct HitSurface {
    /// The side that was hit.
    pub site: Site,
    /// That side is lit; the back of a single-sided surface is not.
    pub lit: bool,
    /// Albedo and emission at the point.
    pub surface: SurfaceSample,
}

/// Origin of a direction's density: the site and its chances of emitters. `None` for an eye's rays, which no lamp sampling
/// competes with.
type From<'a> = Option<(&'a Site, &'a Chances)>;

impl Reference<'_> {
    /// Where rays from a site start.
    fn origin_m(&self, site: &Site) -> Vec3 {
        site.ray_origin_m(self.geometry.tracer.ray_offset_m(site.position_m))
    }

    /// The surface at a hit.
    pub(super) fn met(&self, hit: &Hit) -> HitSurface {
        HitSurface {
            site: self.geometry.site_at(hit),
            lit: !self.geometry.is_back(hit),
            surface: self.surface(hit.triangle, hit.barycentric),
        }
    }

    fn surface(&self, triangle: u32, barycentric: [f32; 2]) -> SurfaceSample {
        let Geometry { scene, images, triangles, .. } = self.geometry;
        let reference = triangles[triangle as usize];
        let weights = weights_of(barycentric).to_array();
        let (instance, local) = (reference.instance as usize, reference.triangle as usize);
        surface_at(scene, images, instance, local, weights, &Footprint::POINT)
    }

    /// Irradiance straight from points, spots and suns: exact but for rounding.
    pub(super) fn by_punctual(&self, site: &Site) -> DVec3 {
        let arrivals = self.lamps.punctual.iter().filter_map(|light| light.arrival(site));
        arrivals
            .fold(DVec3::ZERO, |sum, arrival| sum + arrival.irradiance * self.passed(site, arrival.target))
    }

    /// As [`Reference::by_punctual`], by one of the lights, chosen by its unshadowed irradiance; and which one.
    fn by_one_punctual(&self, site: &Site, pick: f32) -> Option<(usize, DVec3)> {
        let arrivals = || {
            let lamps = self.lamps.punctual.iter().enumerate();
            lamps.filter_map(|(lamp, light)| Some((lamp, light.arrival(site)?)))
        };
        let total: f64 = arrivals().map(|(_, arrival)| luminance(arrival.irradiance)).sum();
        let mut left = f64::from(pick) * total;
        for (lamp, arrival) in arrivals() {
            let share = luminance(arrival.irradiance);
            if left < share {
                let passed = self.passed(site, arrival.target);
                return (passed > 0.0).then(|| (lamp, arrival.irradiance * (passed * total / share)));
            }
            left -= share;
        }
        None
    }

    /// Irradiance by way of a surface that a lamp's ray, tried from the lamp, ends on: ρ E of it, weighted against the
    /// direction from the site that would have met it (balance heuristic).
    pub(super) fn by_beam(&self, site: &Site, walk: &mut Walk) -> DVec3 {
        let Some(guide) = walk.guide else { return DVec3::ZERO };
        // Try a ray of a cell that lit this region before.
        let region = guide.region(site.position_m);
        let Some((cell, chance)) = guide.pick(region, walk.random.next_f32()) else { return DVec3::ZERO };
        let lamp = (cell / SQUARE) as usize;
        let beam = &self.lamps.beams[lamp];
        let within = [walk.random.next_f32(), walk.random.next_f32()];
        let (from_m, direction) = beam.ray(square_of(cell, within));
        let Some(hit) = self.geometry.tracer.met(from_m, direction, f32::INFINITY) else {
            return DVec3::ZERO;
        };
        // The lit side must face the site, and nothing stand between.
        let met = self.met(&hit);
        let by_direction = density_by_direction(site, &met.site);
        if !met.lit || by_direction <= 0.0 {
            return DVec3::ZERO;
        }
        let Some(arrival) = self.lamps.punctual[lamp].arrival(&met.site) else { return DVec3::ZERO };
        let passed = self.passed(site, Target::At(self.origin_m(&met.site)));
        if passed <= 0.0 {
            return DVec3::ZERO;
        }
        let by_beam = chance * f64::from(SQUARE) * beam.density(&met.site);
        let albedo = Vec3::from(met.surface.albedo).as_dvec3();
        // ρE/π · K cosθ/d² over the density, times its weight: K cosθ/d² is π `by_direction`.
        // Glass on the lamp's ray passed or stopped it by chance; that on the way here lets its share through.
        let light = albedo * arrival.irradiance * (passed * by_direction / (by_direction + by_beam));
        walk.tell(region, cell, light);
        light
    }

    /// Weight of a lamp's light on a site that a direction from `from` met, against the lamp's own rays.
    fn met_beam_weight(&self, from: From, lamp: usize, met: &Site, walk: &Walk) -> (f64, Option<(u32, u32)>) {
        let (Some((site, _)), Some(guide)) = (from, walk.guide) else { return (1.0, None) };
        let beam = &self.lamps.beams[lamp];
        let cell = cell_at(lamp, beam.square_at(met.position_m));
        let region = guide.region(site.position_m);
        let by_beam = guide.chance(region, cell) * f64::from(SQUARE) * beam.density(met);
        let by_direction = density_by_direction(site, met);
        let weight = if by_beam > 0.0 { by_direction / (by_direction + by_beam) } else { 1.0 };
        (weight, Some((region, cell)))
    }

    /// Irradiance straight from points, spots and suns at a site that a direction met.
    fn by_punctual_met(&self, from: From, met: &HitSurface, walk: &mut Walk) -> DVec3 {
        let pick = walk.random.next_f32();
        let Some((lamp, light)) = self.by_one_punctual(&met.site, pick) else { return DVec3::ZERO };
        let (weight, found) = self.met_beam_weight(from, lamp, &met.site, walk);
        if let Some((region, cell)) = found {
            walk.tell(region, cell, Vec3::from(met.surface.albedo).as_dvec3() * light * weight);
        }
        light * weight
    }

    /// Share of light that comes from a target to a site: 0 behind a wall, the product of what glass lets through.
    fn passed(&self, site: &Site, target: Target) -> f64 {
        let origin_m = self.origin_m(site);
        let to_m = match target {
            Target::At(point_m) => point_m,
            Target::Towards(direction) => origin_m + direction * self.far_m,
        };
        self.geometry.tracer.passed(origin_m, to_m).into()
    }

    /// Irradiance straight from rectangles, by one point on one of them.
    pub(super) fn by_rects(&self, site: &Site, points: LampPoints) -> DVec3 {
        let Some((arriving, direction, density)) = self.rect_point(site, points) else { return DVec3::ZERO };
        arriving * self.strategy.weight(true, density, site.density(direction))
    }

    /// As [`Reference::by_rects`] for those who send no other rays to rectangles.
    pub(super) fn by_rects_alone(&self, site: &Site, points: LampPoints) -> DVec3 {
        self.rect_point(site, points).map_or(DVec3::ZERO, |(arriving, _, _)| arriving)
    }

    /// Irradiance `L cosθ / density` by one point on one rectangle, its direction and density.
    fn rect_point(&self, site: &Site, points: LampPoints) -> Option<(DVec3, Vec3, f64)> {
        let rects = &self.lamps.rects;
        let scaled = points.pick * rects.len() as f32;
        let rect = rects.get((scaled as usize).min(rects.len().saturating_sub(1)))?;
        let sample = rect.sample(self.origin_m(site), points.point)?;
        let density = sample.density / rects.len() as f64;
        let cosine = site.lamp_cosine(sample.direction);
        let passed = if cosine > 0.0 { self.passed(site, Target::At(sample.point_m)) } else { 0.0 };
        let arriving = rect.radiance * (passed * cosine / density);
        (passed > 0.0).then_some((arriving, sample.direction, density))
    }

    /// Irradiance straight from the scene's emitters, by one point on one of them.
    pub(super) fn by_emitters(&self, site: &Site, chances: &Chances, points: LampPoints) -> DVec3 {
        let emitters = &self.lamps.emitters;
        if emitters.is_empty() {
            return DVec3::ZERO;
        }
        let Some(sample) = emitters.sample(site, chances, points.pick, points.point) else {
            return DVec3::ZERO;
        };
        let cosine = site.lamp_cosine(sample.direction);
        let lifted_m = sample.point_m + sample.normal * self.geometry.tracer.ray_offset_m(sample.point_m);
        let passed = if cosine > 0.0 { self.passed(site, Target::At(lifted_m)) } else { 0.0 };
        if passed <= 0.0 {
            return DVec3::ZERO;
        }
        // An emitter of glass emits as far as it is there.
        let surface = self.surface(sample.triangle, sample.barycentric);
        let share = passed * f64::from(surface.stopped);
        let weight = self.strategy.weight(true, sample.density, site.density(sample.direction));
        emission_of(surface.emission, emitters.scale()) * (share * weight * cosine / sample.density)
    }

    /// Irradiance straight from the sky, by one direction.
    pub(super) fn by_sky(&self, site: &Site, points: LampPoints) -> DVec3 {
        let sky = &self.lamps.sky;
        if sky.is_dark() {
            return DVec3::ZERO;
        }
        let SkySample { direction, radiance, density } = sky.sample(points.point);
        let own = site.density(direction);
        // A gradient may be black right on the horizon.
        let is_light = own > 0.0 && density > 0.0;
        let passed = if is_light { self.passed(site, Target::Towards(direction)) } else { 0.0 };
        if passed <= 0.0 {
            return DVec3::ZERO;
        }
        // K = π · own.
        let weight = self.strategy.weight(true, density, own);
        radiance * (passed * weight * PI * own / density)
    }

    /// Radiance that arrives from a direction, sampled with density K/π at `site` (for an eye: given).
    pub(super) fn arriving(
        &self,
        site: Option<&Site>,
        origin_m: Vec3,
        direction: Vec3,
        walk: &mut Walk,
    ) -> Gathered {
        let first_chances = site.map(|site| self.lamps.emitters.chances(site));
        let mut from: Option<(Site, Chances)> = site.copied().zip(first_chances);
        let (mut origin_m, mut direction) = (origin_m, direction);
        let mut gathered = Gathered::default();
        let mut throughput = DVec3::ONE;
        for vertex in 0.. {
            // Find the next surface, and the rectangles before it: they block nothing.
            let hit = self.geometry.tracer.met(origin_m, direction, f32::INFINITY);
            let by = from.as_ref().map(|(site, chances)| (site, chances));
            let t_max = hit.map_or(f32::INFINITY, |hit| hit.t);
            let rects = throughput * self.rects_met(by, origin_m, direction, t_max);
            // Rectangles seen directly are E_dir, bounced ones E_ind.
            if vertex == 0 {
                gathered.rects += rects;
            } else {
                gathered.rest += rects;
            }
            // A ray that leaves the scene ends in the sky, weighted against the sky's own samples.
            let Some(hit) = hit else {
                gathered.rest += throughput * self.sky_met(by, direction);
                break;
            };
            // The back of a single-sided surface returns no light.
            let met = self.met(&hit);
            if !met.lit {
                break;
            }
            // Add the surface's emission, weighted against sampling it from the vertex before.
            gathered.rest += throughput * self.emission_met(by, &hit, &met, direction);
            // Reflect, and end long paths by chance in proportion to the energy that they still carry.
            throughput *= Vec3::from(met.surface.albedo).as_dvec3();
            if vertex >= ROULETTE_FROM {
                let survival = throughput.max_element().min(SURVIVAL_MAX);
                if f64::from(walk.random.next_f32()) >= survival {
                    break;
                }
                throughput /= survival;
            }
            // Sample the lamps from here (next-event estimation).
            let chances = self.lamps.emitters.chances(&met.site);
            let straight = self.by_punctual_met(by, &met, walk) + self.by_lamps(&met.site, &chances, walk);
            gathered.rest += throughput * straight / PI;
            // Go on in a direction of density K/π, which cancels the cosine: the throughput stays the albedo's product.
            origin_m = self.origin_m(&met.site);
            direction = met.site.direction([walk.random.next_f32(), walk.random.next_f32()]);
            from = Some((met.site, chances));
        }
        gathered
    }

    /// Radiance straight along an eye's ray (lamps, emission, sky), and the surface that it ends at.
    pub(super) fn seen(&self, origin_m: Vec3, direction: Vec3) -> (DVec3, Option<EyeSurface>) {
        let hit = self.geometry.tracer.met(origin_m, direction, f32::INFINITY);
        let t_max = hit.map_or(f32::INFINITY, |hit| hit.t);
        let rects = self.rects_met(None, origin_m, direction, t_max);
        let Some(hit) = hit else { return (rects + self.sky_met(None, direction), None) };
        let met = self.met(&hit);
        let emission = if met.lit { self.emission_met(None, &hit, &met, direction) } else { DVec3::ZERO };
        let surface = EyeSurface { hit, site: met.site, lit: met.lit, albedo: met.surface.albedo };
        (rects + emission, Some(surface))
    }

    /// The surface that reflects light along a ray, or radiance of the sky where there is none.
    pub fn reflector(&self, origin_m: Vec3, direction: Vec3) -> Result<EyeSurface, DVec3> {
        let Some(hit) = self.geometry.tracer.met(origin_m, direction, f32::INFINITY) else {
            return Err(self.sky_met(None, direction));
        };
        let met = self.met(&hit);
        Ok(EyeSurface { hit, site: met.site, lit: met.lit, albedo: met.surface.albedo })
    }

    /// Radiance of the sky along a ray that leaves the scene.
    pub fn sky(&self, direction: Vec3) -> DVec3 {
        self.sky_met(None, direction)
    }

    /// Irradiance from one sample of each kind of lamp with extent, and by one ray of a lamp without.
    fn by_lamps(&self, site: &Site, chances: &Chances, walk: &mut Walk) -> DVec3 {
        let mut points = || LampPoints::next(&mut walk.random);
        let straight = self.by_rects(site, points())
            + self.by_emitters(site, chances, points())
            + self.by_sky(site, points());
        straight + self.by_beam(site, walk)
    }

    /// Radiance of the rectangles that a ray passes, weighted against sampling them.
    fn rects_met(&self, from: From, origin_m: Vec3, direction: Vec3, t_max: f32) -> DVec3 {
        let count = self.lamps.rects.len() as f64;
        let mut sum = DVec3::ZERO;
        for rect in &self.lamps.rects {
            if let Some(density) = rect.meet(origin_m, direction, t_max) {
                sum += rect.radiance * self.met_weight(from, direction, density / count);
            }
        }
        sum
    }

    fn emission_met(&self, from: From, hit: &Hit, met: &HitSurface, direction: Vec3) -> DVec3 {
        if self.lamps.emitters.is_empty() || met.surface.emission == [0.0; 3] {
            return DVec3::ZERO;
        }
        let density = from
            .map_or(0.0, |(_, chances)| self.lamps.emitters.density(hit.triangle, chances, direction, hit.t));
        let emission = emission_of(met.surface.emission, self.lamps.emitters.scale());
        emission * self.met_weight(from, direction, density)
    }

    /// Weight of a lamp that a ray met, `max(0, n·ω)/K` included.
    fn met_weight(&self, from: From, direction: Vec3, sampled: f64) -> f64 {
        let Some((site, _)) = from else { return 1.0 };
        let own = site.density(direction);
        if own <= 0.0 {
            return 0.0;
        }
        self.strategy.weight(false, own, sampled) * site.lamp_cosine(direction) / (PI * own)
    }

    /// Radiance of the sky that a ray met, weighted against sampling it.
    fn sky_met(&self, from: From, direction: Vec3) -> DVec3 {
        let sky = &self.lamps.sky;
        if sky.is_dark() {
            return DVec3::ZERO;
        }
        let weight = from.map_or(1.0, |(site, _)| {
            self.strategy.weight(false, site.density(direction), sky.density(direction))
        });
        sky.radiance(direction) * weight
    }
}

/// Density per m² with which directions from a site, of density K/π, end on another that faces it.
fn density_by_direction(from: &Site, to: &Site) -> f64 {
    let way = to.position_m - from.position_m;
    let squared_m2 = f64::from(way.length_squared());
    if squared_m2 <= 0.0 {
        return 0.0;
    }
    let direction = way / way.length();
    from.density(direction) * f64::from(-direction.dot(to.face_normal)).max(0.0) / squared_m2
}
