//! Sites near each other that face alike.

use glam::Vec3;
use rayon::prelude::*;

use super::Site;
use crate::geometry::morton;

/// Neighbours of a site, itself among them.
const NEIGHBOURS: usize = 9;
/// Places along the curve on either side that are looked at.
const WINDOW: usize = 48;
/// Least cosine between normals that face alike.
const ALIKE_MIN: f32 = 0.7;

/// For each site, itself and the nearest of those that face alike, among those near it on a Morton curve through
/// the scene's bounds.
pub(super) fn neighbours(sites: &[Site], bounds_m: [Vec3; 2]) -> Vec<Vec<u32>> {
    let codes: Vec<u32> = sites.iter().map(|site| morton(site.position_m, bounds_m)).collect();
    let mut order: Vec<u32> = (0..sites.len() as u32).collect();
    order.sort_by_key(|&site| (codes[site as usize], site));
    let of_place = |place: usize| {
        let own = &sites[order[place] as usize];
        let window = place.saturating_sub(WINDOW)..(place + WINDOW + 1).min(order.len());
        let mut near: Vec<(f32, u32)> = order[window]
            .iter()
            .filter(|&&site| sites[site as usize].normal.dot(own.normal) > ALIKE_MIN)
            .map(|&site| (sites[site as usize].position_m.distance_squared(own.position_m), site))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        (order[place], near.into_iter().take(NEIGHBOURS).map(|(_, site)| site).collect())
    };
    let mut found: Vec<(u32, Vec<u32>)> = (0..order.len()).into_par_iter().map(of_place).collect();
    found.sort_by_key(|(site, _)| *site);
    found.into_iter().map(|(_, near)| near).collect()
}
