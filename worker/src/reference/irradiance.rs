//! Irradiance at sites, each with its own standard error, in rounds until it is small enough.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use super::path::LampPoints;
use super::tally::{Estimate, Tally};
use super::{Reference, Site};
use crate::rays::sampling::{R2, Sequence, seed_of};
use crate::task::{Cancelled, Progress};

/// Paths of one batch; their first directions and lamp points are spread evenly, batches are independent.
const BATCH: u32 = 16;
/// Batches of the first round: enough for an error of the error of an eighth.
const FIRST_BATCHES: u32 = 32;

/// Precision of estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Precision {
    /// Standard error of the indirect part's luminance over the mean of all sites, or over the geometric mean of both where
    /// it is brighter: sums of squares over sites have most of their noise from the brightest. Smaller → more paths,
    /// with its inverse square.
    pub rel_error: f64,
    /// Most paths per site.
    pub paths_max: u32,
}

impl Default for Precision {
    fn default() -> Self {
        Self { rel_error: 0.03, paths_max: 1 << 15 }
    }
}

/// Irradiance at a site in W·m⁻².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IrradianceEstimate {
    /// E_dir: straight from punctual lights and panels.
    pub direct: Estimate,
    /// E_ind: everything else, i.e. bounced light, the scene's own emitters and the sky.
    pub indirect: Estimate,
    /// Paths taken.
    pub paths: u32,
}

/// Both parts of a site while they are summed.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    direct: Tally,
    indirect: Tally,
}

impl Sums {
    fn paths(&self) -> u32 {
        self.indirect.count() * BATCH
    }
}

impl Reference<'_> {
    /// Irradiance at every site, in their order.
    ///
    /// A first round gives the mean of all sites, which errors are relative to; then each site doubles its
    /// paths until it is sure enough or has [`Precision::paths_max`].
    pub fn irradiance(
        &self,
        sites: &[Site],
        precision: &Precision,
        progress: &Progress,
    ) -> Result<Vec<IrradianceEstimate>, Cancelled> {
        let first: Vec<Sums> = sites
            .par_iter()
            .map(|site| {
                progress.check()?;
                let mut sums = Sums::default();
                self.add_batches(site, &mut sums, FIRST_BATCHES);
                Ok(sums)
            })
            .collect::<Result<_, Cancelled>>()?;
        let total: f64 = first.iter().map(|sums| sums.indirect.estimate().luminance()).sum();
        let floor = total / sites.len().max(1) as f64;
        sites
            .par_iter()
            .zip(first)
            .map(|(site, mut sums)| {
                while sums.paths() < precision.paths_max && !is_sure(&sums, floor, precision.rel_error) {
                    progress.check()?;
                    let left = (precision.paths_max - sums.paths()).div_ceil(BATCH);
                    let more = sums.indirect.count().min(left);
                    self.add_batches(site, &mut sums, more);
                }
                Ok(self.finished(site, &sums))
            })
            .collect()
    }

    /// E_dir at a site: shadow rays to every punctual light, and `panel_points` points over the panels.
    pub fn direct_irradiance(&self, site: &Site, panel_points: u32) -> DVec3 {
        let mut panels = DVec3::ZERO;
        if !self.lamps.panels.is_empty() {
            let points = R2::new(seed_of(&[seed_of(&site.identity()), 23]));
            let picks = Sequence::new(seed_of(&[seed_of(&site.identity()), 24])).next_f32();
            for index in 0..panel_points {
                let pick = (index as f32 + picks) / panel_points as f32;
                let sample = LampPoints { pick, point: points.point(index) };
                panels += self.by_panels_alone(site, sample) / f64::from(panel_points);
            }
        }
        self.by_punctual(site) + panels
    }

    fn add_batches(&self, site: &Site, sums: &mut Sums, count: u32) {
        let own = seed_of(&site.identity());
        for _ in 0..count {
            let (direct, indirect) = self.batch(site, seed_of(&[own, u64::from(sums.indirect.count()), 21]));
            sums.direct.add(direct);
            sums.indirect.add(indirect);
        }
    }

    /// Means of one batch: panels' part of E_dir, and E_ind.
    fn batch(&self, site: &Site, seed: u64) -> (DVec3, DVec3) {
        let mut random = Sequence::new(seed);
        let directions = R2::new(random.next_u64());
        let lamp_points = R2::new(random.next_u64());
        let shift = random.next_f32();
        let origin_m = site.ray_origin_m(self.geometry.tracer.ray_offset_m());
        let chances = self.lamps.emitters.chances(site);
        let (mut direct, mut indirect) = (DVec3::ZERO, DVec3::ZERO);
        for index in 0..BATCH {
            let pick = (index as f32 + shift) / BATCH as f32;
            let points = LampPoints { pick, point: lamp_points.point(index) };
            direct += self.by_panels(site, points);
            indirect += self.by_emitters(site, &chances, points) + self.by_sky(site, points);
            let direction = site.direction(directions.point(index));
            let gathered = self.arriving(Some(site), origin_m, direction, &mut random);
            // π · L · K / (π · density), and density is K/π.
            direct += PI * gathered.panels;
            indirect += PI * gathered.rest;
        }
        (direct / f64::from(BATCH), indirect / f64::from(BATCH))
    }

    fn finished(&self, site: &Site, sums: &Sums) -> IrradianceEstimate {
        let mut direct = sums.direct.estimate();
        direct.mean += self.by_punctual(site);
        IrradianceEstimate { direct, indirect: sums.indirect.estimate(), paths: sums.paths() }
    }
}

fn is_sure(sums: &Sums, floor: f64, rel_error: f64) -> bool {
    let estimate = sums.indirect.estimate();
    estimate.luminance_error <= rel_error * (estimate.luminance().max(floor) * floor).sqrt()
}
