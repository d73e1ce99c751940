//! Whether a surface can be looked at: insides of hollow and solid things cannot, and their light is nobody's concern.

use glam::Vec3;

use crate::geometry::{Geometry, Site};
use crate::rays::sampling::{R2, seed_of};
use crate::vantage::vantage_points;

/// Vantage points that a surface is looked at from, the nearest first.
const NEAREST: usize = 16;
/// Rays from a surface that none of them sees, to others that they may see.
const RAYS: u32 = 64;

/// The free space of a scene, by its vantage points.
#[derive(Clone, Debug, Default)]
pub struct OpenSpace {
    points_m: Vec<Vec3>,
}

impl OpenSpace {
    /// Finds the vantage points.
    pub fn of(geometry: &Geometry) -> Self {
        Self { points_m: vantage_points(geometry).iter().map(|point| point.position_m).collect() }
    }

    /// A vantage point sees the site, or something that the site sees; or the sky does. All sites count where there is no
    /// vantage point.
    pub fn sees(&self, geometry: &Geometry, site: &Site) -> bool {
        if self.points_m.is_empty() || self.sees_at_once(geometry, site) {
            return true;
        }
        let points = R2::new(seed_of(&site.identity()));
        let origin_m = site.ray_origin_m(geometry.tracer.ray_offset_m(site.position_m));
        (0..RAYS).any(|ray| {
            let met = geometry.tracer.closest(origin_m, site.direction(points.point(ray)), f32::INFINITY);
            met.is_none_or(|hit| {
                !geometry.is_back(&hit) && self.sees_at_once(geometry, &geometry.site_at(&hit))
            })
        })
    }

    fn sees_at_once(&self, geometry: &Geometry, site: &Site) -> bool {
        let from_m = site.ray_origin_m(geometry.tracer.ray_offset_m(site.position_m));
        let mut before: Vec<Vec3> = self
            .points_m
            .iter()
            .copied()
            .filter(|to_m| (*to_m - from_m).dot(site.face_normal) > 0.0)
            .collect();
        let distance = |to_m: &Vec3| to_m.distance_squared(from_m);
        let nearer = |a: &Vec3, b: &Vec3| distance(a).total_cmp(&distance(b));
        if before.len() > NEAREST {
            before.select_nth_unstable_by(NEAREST, nearer);
            before.truncate(NEAREST);
        }
        before.iter().any(|to_m| !geometry.tracer.is_occluded(from_m, *to_m))
    }
}
