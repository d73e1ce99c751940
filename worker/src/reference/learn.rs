//! Learning where lamps' rays bring light: paths from points all over the scene, whose findings make the next ones better.

use rayon::prelude::*;

use super::guide::{Finding, Guide};
use super::path::Walk;
use super::{Reference, Site, Strategy};
use crate::geometry::spread_sites;
use crate::rays::sampling::{R2, seed_of};
use crate::task::{Cancelled, Progress};

/// Points that paths start from. More → surer chances, more time.
const SITES: u32 = 4096;
/// Paths from each, a round each: the first tries all rays of a lamp alike, later ones those that brought light.
const PATHS: [u32; 3] = [8, 8, 16];

impl Reference<'_> {
    /// The guide of this scene and its lamps, learned when it is first asked for; `None` without lamps that need one. It
    /// depends on scene and lamps alone.
    pub(super) fn guide(&self, progress: &Progress) -> Result<Option<&Guide>, Cancelled> {
        if self.lamps.punctual.is_empty() || self.strategy != Strategy::Both {
            return Ok(None);
        }
        if let Some(guide) = self.guide.get() {
            return Ok(Some(guide));
        }
        let learned = self.learn(progress)?;
        Ok(Some(self.guide.get_or_init(|| learned)))
    }

    fn learn(&self, progress: &Progress) -> Result<Guide, Cancelled> {
        let sites = spread_sites(self.geometry, SITES);
        let mut guide = Guide::even(self.lamps.punctual.len(), self.geometry.bounds_m());
        let mut findings: Vec<Finding> = Vec::new();
        for (round, paths) in PATHS.into_iter().enumerate() {
            let found: Vec<Vec<Finding>> = sites
                .par_iter()
                .map(|site| {
                    progress.check()?;
                    Ok(self.findings(site, &guide, round as u64, paths))
                })
                .collect::<Result<_, Cancelled>>()?;
            findings.extend(found.into_iter().flatten());
            guide = guide.learned(&findings);
        }
        Ok(guide)
    }

    /// Light that paths from a site find, at the site and on their way.
    fn findings(&self, site: &Site, guide: &Guide, round: u64, paths: u32) -> Vec<Finding> {
        let seed = seed_of(&[seed_of(&site.identity()), round, 26]);
        let mut walk = Walk::telling(seed, guide);
        let directions = R2::new(walk.random.next_u64());
        let origin_m = site.ray_origin_m(self.geometry.tracer.ray_offset_m(site.position_m));
        for index in 0..paths {
            self.by_beam(site, &mut walk);
            self.arriving(Some(site), origin_m, site.direction(directions.point(index)), &mut walk);
        }
        walk.into_findings()
    }
}
