//! Irradiance at sites, each with its own standard error: a pilot that tells how many paths a site needs, then those.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::guide::Guide;
use super::neighbours::neighbours;
use super::path::{LampPoints, Walk};
use super::tally::{Estimate, Tally};
use super::{Reference, Site};
use crate::rays::Hit;
use crate::rays::sampling::{R2, Sequence, seed_of};
use crate::task::{Cancelled, Progress};

/// Paths of one batch; their first directions and lamp points are spread evenly, batches are independent.
const BATCH: u32 = 16;
/// Batches of the pilot: enough for a variance within a third, with that of neighbours within a sixth.
const PILOT_BATCHES: u32 = 16;
/// Fewest batches of the main phase: enough for a standard error of its own.
const MAIN_BATCHES_MIN: u32 = 8;
/// Batches that a variance shared by neighbours counts for beside a site's own.
const SHARED_BATCHES: f64 = 8.0;

/// Precision of estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Precision {
    /// Standard error of the indirect part's luminance over the mean of all sites, or over the geometric mean of both where
    /// it is brighter: sums of squares over sites have most of their noise from the brightest. A target of v times the mean weight
    /// may have 1/√v times as much. Smaller → more paths, with its inverse square.
    pub rel_error: f64,
    /// Most paths per site, the pilot's not among them; 32 at least.
    pub paths_max: u32,
}

impl Default for Precision {
    fn default() -> Self {
        Self { rel_error: 0.03, paths_max: 1 << 15 }
    }
}

/// Points whose mean irradiance is estimated.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    /// Where they are.
    pub site: Site,
    /// The points, one at least.
    pub points: Vec<Site>,
    /// Positive weight in means over targets.
    pub weight: f64,
}

impl Target {
    /// A site alone.
    pub fn of(site: Site) -> Self {
        Self { site, points: vec![site], weight: 1.0 }
    }

    /// The point of a batch. Even and odd batches each take points by a golden-ratio sequence of their own, so that halves
    /// are independent and a few batches spread over all points.
    fn point(&self, seed: u64, batch: u32) -> &Site {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let half = u64::from(batch % 2);
        let first = f64::from(Sequence::new(seed_of(&[seed, 27, half])).next_f32());
        let place = (first + GOLDEN * f64::from(batch / 2)).fract() * self.points.len() as f64;
        &self.points[(place as usize).min(self.points.len() - 1)]
    }
}

/// Irradiance at a site in W·m⁻².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IrradianceEstimate {
    /// E_dir: straight from punctual lights and rectangles.
    pub direct: Estimate,
    /// E_ind: everything else, i.e. bounced light, the scene's own emitters and the sky.
    pub indirect: Estimate,
    /// E_ind by every other batch: two estimates, independent of each other, whose mean is `indirect`'s.
    pub halves: [DVec3; 2],
    /// Paths taken.
    pub paths: u32,
}

/// Both parts of a site while they are summed.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    direct: Tally,
    indirect: Tally,
    halves: [DVec3; 2],
}

/// Phase of an estimate; each has random numbers of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Pilot = 20,
    Main = 21,
}

impl Reference<'_> {
    /// Irradiance at every site, in their order.
    ///
    /// A pilot tells the mean of all sites, which errors are relative to, and how much the light of paths varies about each
    /// site and its neighbours. From that alone follows how many paths the main phase takes at a site, and the main phase
    /// alone gives the estimate: a number of paths that hung on what they found would count places as dark, and as sure,
    /// whose light the first paths had missed.
    pub fn irradiance(
        &self,
        sites: &[Site],
        precision: &Precision,
        progress: &Progress,
    ) -> Result<Vec<IrradianceEstimate>, Cancelled> {
        let targets: Vec<Target> = sites.iter().map(|site| Target::of(*site)).collect();
        self.mean_irradiance(&targets, precision, progress)
    }

    /// As [`Reference::irradiance`], of each target the mean over its points, and for means over the targets with their weights:
    /// one of half the mean weight may have √2 times the standard error.
    pub fn mean_irradiance(
        &self,
        targets: &[Target],
        precision: &Precision,
        progress: &Progress,
    ) -> Result<Vec<IrradianceEstimate>, Cancelled> {
        let guide = self.guide(progress)?;
        let pilot: Vec<Estimate> = targets
            .par_iter()
            .map(|target| {
                progress.check()?;
                Ok(self.summed(target, guide, Phase::Pilot, PILOT_BATCHES).indirect.estimate())
            })
            .collect::<Result<_, Cancelled>>()?;
        let count = targets.len().max(1) as f64;
        // Sums over all are of one order, whatever that of the targets.
        let mut order: Vec<usize> = (0..targets.len()).collect();
        order.sort_by_key(|&index| targets[index].site.identity());
        let mean_weight = order.iter().map(|&index| targets[index].weight).sum::<f64>() / count;
        let shares: Vec<f64> = targets.iter().map(|target| target.weight / mean_weight).collect();
        let light = |&index: &usize| shares[index] * pilot[index].luminance();
        let floor = order.iter().map(light).sum::<f64>() / count;
        let sites: Vec<Site> = targets.iter().map(|target| target.site).collect();
        let expected = expected(neighbours(&sites, self.geometry.bounds_m()), &order, &pilot, &shares);
        targets
            .par_iter()
            .zip(expected.into_par_iter().zip(shares))
            .map(|(target, (expected, share))| {
                progress.check()?;
                let batches = expected.batches(floor, share, precision);
                let sums = self.summed(target, guide, Phase::Main, batches);
                Ok(self.finished(target, &sums, &expected))
            })
            .collect()
    }

    /// E_dir at a site: shadow rays to every punctual light, and `rect_points` points over the rectangles.
    pub fn direct_irradiance(&self, site: &Site, rect_points: u32) -> DVec3 {
        let mut rects = DVec3::ZERO;
        if !self.lamps.rects.is_empty() {
            let points = R2::new(seed_of(&[seed_of(&site.identity()), 23]));
            let picks = Sequence::new(seed_of(&[seed_of(&site.identity()), 24])).next_f32();
            for index in 0..rect_points {
                let pick = (index as f32 + picks) / rect_points as f32;
                let sample = LampPoints { pick, point: points.point(index) };
                rects += self.by_rects_alone(site, sample) / f64::from(rect_points);
            }
        }
        self.by_punctual(site) + rects
    }

    fn summed(&self, target: &Target, guide: Option<&Guide>, phase: Phase, batches: u32) -> Sums {
        let own = seed_of(&target.site.identity());
        let mut sums = Sums::default();
        for batch in 0..batches {
            let seed = seed_of(&[own, u64::from(batch), phase as u64]);
            let (direct, indirect) = self.batch(target.point(own, batch), &mut Walk::new(seed, guide), BATCH);
            sums.direct.add(direct);
            sums.indirect.add(indirect);
            sums.halves[batch as usize % 2] += indirect;
        }
        sums
    }

    /// Radiance reflected at a hit, under all light, by some paths that go on from there; nothing guides them.
    pub fn reflected(&self, hit: &Hit, paths: u32, seed: u64) -> DVec3 {
        let met = self.met(hit);
        if !met.lit || paths == 0 {
            return DVec3::ZERO;
        }
        let (rects, indirect) = self.batch(&met.site, &mut Walk::new(seed, None), paths);
        let irradiance = self.by_punctual(&met.site) + rects + indirect;
        Vec3::from(met.surface.albedo).as_dvec3() / PI * irradiance
    }

    /// Means of a batch of paths: rectangles' part of E_dir, and E_ind.
    fn batch(&self, site: &Site, walk: &mut Walk, paths: u32) -> (DVec3, DVec3) {
        let directions = R2::new(walk.random.next_u64());
        let lamp_points = R2::new(walk.random.next_u64());
        let shift = walk.random.next_f32();
        let origin_m = site.ray_origin_m(self.geometry.tracer.ray_offset_m(site.position_m));
        let chances = self.lamps.emitters.chances(site);
        let (mut direct, mut indirect) = (DVec3::ZERO, DVec3::ZERO);
        for index in 0..paths {
            let pick = (index as f32 + shift) / paths as f32;
            let points = LampPoints { pick, point: lamp_points.point(index) };
            direct += self.by_rects(site, points);
            indirect += self.by_emitters(site, &chances, points) + self.by_sky(site, points);
            indirect += self.by_beam(site, walk);
            let direction = site.direction(directions.point(index));
            let gathered = self.arriving(Some(site), origin_m, direction, walk);
            // π · L · K / (π · density), and density is K/π.
            direct += PI * gathered.rects;
            indirect += PI * gathered.rest;
        }
        (direct / f64::from(paths), indirect / f64::from(paths))
    }

    fn finished(&self, target: &Target, sums: &Sums, expected: &Expected) -> IrradianceEstimate {
        let mut direct = sums.direct.estimate();
        let points = &target.points;
        direct.mean += points.iter().map(|site| self.by_punctual(site)).sum::<DVec3>() / points.len() as f64;
        let batches = sums.indirect.count();
        let counts = [batches.div_ceil(2), batches / 2];
        let halves = [0, 1].map(|half| sums.halves[half] / f64::from(counts[half]));
        let indirect = sums.indirect.estimate_beside(expected.variance, SHARED_BATCHES);
        IrradianceEstimate { direct, indirect, halves, paths: batches * BATCH }
    }
}

/// Findings of the pilot about a site: mean luminance in W·m⁻², variances of a batch about its mean: r, g, b, luminance.
#[derive(Clone, Copy, Debug, Default)]
struct Expected {
    luminance: f64,
    variance: [f64; 4],
}

impl Expected {
    /// The mean of some with their weights.
    fn mean(of: impl Iterator<Item = (f64, Self)>) -> Self {
        let (mut sum, mut total) = (Self::default(), 0.0);
        for (weight, one) in of {
            sum.luminance += weight * one.luminance;
            sum.variance =
                std::array::from_fn(|channel| sum.variance[channel] + weight * one.variance[channel]);
            total += weight;
        }
        Self { luminance: sum.luminance / total, variance: sum.variance.map(|variance| variance / total) }
    }

    /// Batches for the precision at a site of `share` times the mean weight: an even number, for halves alike.
    fn batches(&self, floor: f64, share: f64, precision: &Precision) -> u32 {
        let wanted = precision.rel_error * (self.luminance.max(floor) * floor / share).sqrt();
        let most = (precision.paths_max / BATCH).max(2);
        let least = MAIN_BATCHES_MIN.min(most);
        let needed = (self.variance[3] / (wanted * wanted)).ceil();
        // No variance over no error is no number: nothing is there to be found.
        let batches = if needed.is_nan() { least } else { needed.clamp(least.into(), most.into()) as u32 };
        batches & !1
    }
}

/// Means over each site, its nearest neighbours that face alike, and one more that stands for all sites: a single pilot
/// may miss what the others find.
fn expected(neighbours: Vec<Vec<u32>>, order: &[usize], pilot: &[Estimate], shares: &[f64]) -> Vec<Expected> {
    let of_site = |estimate: &Estimate| {
        let Estimate { error, luminance_error, .. } = *estimate;
        let variance = [error.x, error.y, error.z, luminance_error]
            .map(|error| error * error * f64::from(PILOT_BATCHES));
        Expected { luminance: estimate.luminance(), variance }
    };
    let all = Expected::mean(order.iter().map(|&index| (shares[index], of_site(&pilot[index]))));
    let around = |near: Vec<u32>| near.into_iter().map(|site| (1.0, of_site(&pilot[site as usize])));
    neighbours.into_par_iter().map(|near| Expected::mean(around(near).chain([(1.0, all)]))).collect()
}
