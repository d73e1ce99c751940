//! Working volume of a field: a scene's near bounds, and a step around them where a front is near, as above a roof.

use glam::Vec3;

use super::looks::sees_front;
use crate::geometry::Geometry;

/// How near a front is, over the distance between probes: the diagonal of a face of a cage.
const REACH: f32 = 1.5;

/// The volume of a scene, for probes that far apart.
#[derive(Clone, Copy)]
pub struct Volume<'a> {
    geometry: &'a Geometry,
    spacing_m: f32,
    /// Near bounds of the scene.
    pub bounds_m: [Vec3; 2],
}

impl<'a> Volume<'a> {
    /// Of a scene.
    pub fn of(geometry: &'a Geometry, spacing_m: f32) -> Self {
        Self { geometry, spacing_m, bounds_m: geometry.near_bounds_m() }
    }

    /// Bounds of all of it.
    pub fn outer_m(&self) -> [Vec3; 2] {
        let [low_m, high_m] = self.bounds_m;
        [low_m - self.spacing_m, high_m + self.spacing_m]
    }

    /// A place is within the scene's bounds, or outside of them beside a front.
    pub fn holds(&self, at_m: Vec3) -> bool {
        let is_beside_front = || sees_front(self.geometry, at_m, REACH * self.spacing_m);
        lies_in(self.bounds_m, at_m) || lies_in(self.outer_m(), at_m) && is_beside_front()
    }
}

fn lies_in([low_m, high_m]: [Vec3; 2], at_m: Vec3) -> bool {
    at_m.cmpge(low_m).all() && at_m.cmple(high_m).all()
}
