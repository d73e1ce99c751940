//! Whether a scene is open to the sky, and where a sun shines into it.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Geometry, Site, spread_sites};
use crate::rays::sampling::{R2, seed_of};

/// Sites that a sun is tried on.
const TRIED_SITES: u32 = 2048;
/// Rays that tell how open a site is.
const OPENNESS_RAYS: u32 = 32;
/// Share of a site's rays that meet backs beyond which it stands outside.
const OUTSIDE_BACK_SHARE: f32 = 0.25;
/// Share of its directions up to which a site sees the sky past something.
const PARTLY_MAX: f32 = 0.75;
/// Share of sites that see the sky beyond which the scene is open anyway.
const SEEING_MIN: f32 = 0.05;

/// The sky as the scene's surfaces see it.
pub struct Openness {
    sites: Vec<Site>,
    /// Share of each site's directions that leave the scene.
    open: Vec<f32>,
}

impl Openness {
    /// Looks out from sites spread over the scene.
    pub fn of(geometry: &Geometry) -> Self {
        let sites = spread_sites(geometry, TRIED_SITES);
        // A site that mostly sees backs of single-sided surfaces stands outside: on a rim of a wall that sticks out.
        let open_of = |site: &Site| {
            let points = R2::new(seed_of(&site.identity()));
            let (mut escaped, mut backs) = (0, 0);
            for ray in 0..OPENNESS_RAYS {
                let direction = site.direction(points.point(ray));
                let origin_m = site.ray_origin_m(geometry.tracer.ray_offset_m(site.position_m));
                match geometry.tracer.closest(origin_m, direction, f32::INFINITY) {
                    None => escaped += 1,
                    Some(hit) => backs += u32::from(geometry.is_back(&hit)),
                }
            }
            let share = |count: u32| count as f32 / OPENNESS_RAYS as f32;
            (share(backs) <= OUTSIDE_BACK_SHARE).then(|| share(escaped))
        };
        let looked: Vec<Option<f32>> = sites.par_iter().map(open_of).collect();
        let (sites, open) =
            sites.into_iter().zip(looked).filter_map(|(site, open)| Some((site, open?))).unzip();
        Self { sites, open }
    }

    /// Sky comes in: some site sees it past something, or a good share of them at all. A rim that sticks out of a closed
    /// room is no opening.
    pub fn has_opening(&self) -> bool {
        let partly = |open: &f32| *open > 0.0 && *open <= PARTLY_MAX;
        let seeing = self.open.iter().filter(|open| **open > 0.0).count();
        self.open.iter().any(partly) || seeing as f32 > SEEING_MIN * self.open.len() as f32
    }

    /// Sum over sites that a sun lights, weighted towards those that see little sky, and their count: `Σ cosθ · (1 − openness)⁸`, so that it shines
    /// on a room's floor rather than on the reveals of its windows.
    pub fn lit_by(&self, geometry: &Geometry, travel: Vec3) -> (f32, usize) {
        let far_m = geometry.diagonal_m() * 2.0 + 1.0;
        let (mut sum, mut count) = (0.0, 0);
        for (site, open) in self.sites.iter().zip(&self.open) {
            let cosine = site.lamp_cosine(-travel) as f32;
            let origin_m = site.ray_origin_m(geometry.tracer.ray_offset_m(site.position_m));
            if cosine > 0.0 && !geometry.tracer.is_occluded(origin_m, origin_m - travel * far_m) {
                sum += cosine * (1.0 - open).powi(8);
                count += 1;
            }
        }
        (sum, count)
    }
}
