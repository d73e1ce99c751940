//! Candidates of a walk: elements that can end it, and which of those in a sub-voxel does.

use glam::Vec3;

use super::super::table::ElementRow;
use super::{Start, WalkHit};

/// Share of h₀ by which starts are raised along their normal.
const RAISED: f32 = 1.0 / 256.0;
/// Share of h within which a plane is that of the start's own sheet.
const OWN_HEIGHT: f32 = 0.02;
/// Least cosine between the normals of the start and of its own sheet.
const OWN_COSINE: f32 = 0.9;
/// Sine of the angle at which a walk goes into its own sheet at least where that ends it. More: walks get out of hollows at their rims; less:
/// rounding ends walks at their start.
const OWN_FACING: f32 = 1.0 / 256.0;
/// Share of h₀ by which a plane may lie before a start in front of it: a start at the rim of two faces is in front of both. Less than starts are
/// raised by, so that it is behind the other side of its own sheet.
const RIM: f32 = 1.0 / 2048.0;

/// A line from a start: x, ω and n, the latter 0 in free space.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// x, raised off the surface.
    pub from_m: Vec3,
    /// ω, of length 1.
    pub direction: Vec3,
    /// n of the surface that it starts on.
    pub normal: Vec3,
    /// See [`RIM`].
    rim_m: f32,
}

impl Line {
    /// Of walks from a start along a direction, through voxels of that side at level 0.
    pub fn new(start: &Start, direction: Vec3, voxel_m: f32) -> Self {
        let normal = start.normal.unwrap_or(Vec3::ZERO);
        let from_m = start.at_m + normal * (RAISED * voxel_m);
        Self { from_m, direction, normal, rim_m: RIM * voxel_m }
    }

    /// Length to the plane of an element of a voxel, and whether it is seen from behind; `None`: it is no candidate.
    pub fn candidate(&self, element: &ElementRow, middle_m: Vec3, side_m: f32) -> Option<(f32, bool)> {
        let normal = element.normal();
        let height_m = normal.dot(self.from_m - middle_m) - element.height_m;
        let facing = normal.dot(self.direction);
        let turn = normal.dot(self.normal);
        let is_own = height_m.abs() < OWN_HEIGHT * side_m && turn.abs() > OWN_COSINE;
        // The start's own sheet ends walks where it bends towards them, be its mean plane before the start or behind.
        let is_front =
            if is_own { turn > 0.0 && facing < -OWN_FACING } else { facing < 0.0 && height_m > -self.rim_m };
        let is_back = !is_own && element.is_backed() && facing > 0.0 && height_m < 0.0;
        (is_front || is_back).then(|| (-height_m / facing, is_back))
    }
}

/// Of candidates in a sub-voxel, sides that are seen from before, then the one whose plane is nearest to the walk's way through it, then the one
/// met first, then the first element. At the edge of a solid a sub-voxel holds backs of faces beyond, which its front hides.
#[derive(Clone, Copy, Debug, Default)]
pub struct Nearest {
    /// The candidate.
    pub hit: Option<WalkHit>,
    /// Length between its plane and the sub-voxel, 0 if it is within.
    off_m: f32,
    /// There are several patches.
    pub is_mixed: bool,
}

impl Nearest {
    /// Adds a hit at its plane; the way through the sub-voxel is between two lengths.
    pub fn add(&mut self, hit: WalkHit, [from_m, to_m]: [f32; 2]) {
        let off_m = (from_m - hit.t_m).max(hit.t_m - to_m).max(0.0);
        let hit = WalkHit { t_m: hit.t_m.clamp(from_m, to_m), ..hit };
        let Some(best) = self.hit else {
            (self.hit, self.off_m) = (Some(hit), off_m);
            return;
        };
        self.is_mixed |= best.patch != hit.patch;
        let is_nearer = off_m < self.off_m || off_m == self.off_m && hit.t_m < best.t_m;
        if (best.is_back && !hit.is_back) || best.is_back == hit.is_back && is_nearer {
            (self.hit, self.off_m) = (Some(hit), off_m);
        }
    }
}

/// The nearer hit, the former if both are as near.
pub fn nearer(former: Option<WalkHit>, latter: Option<WalkHit>) -> Option<WalkHit> {
    match (former, latter) {
        (Some(a), Some(b)) if b.t_m < a.t_m => Some(b),
        _ => former.or(latter),
    }
}
