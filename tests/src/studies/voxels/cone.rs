//! Cones through the levels of an octree (§5.6).

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_worker::rays::sampling::tangent_frame;

use super::brick::{Levels, quadrilinear};
use super::shade::shaded;
use super::tree::Tree;
use super::{Kind, Manner, Sampling};

/// Opacity at which a mended cone ends.
const OPAQUE: f32 = 0.9999;
/// Samples of a cone at most.
const SAMPLES_MAX: usize = 1 << 12;
/// Half angle from which cones are wide: one sample a level.
const WIDE_RAD: f32 = 0.2;
/// Most diffuse cones in one ring.
const RING_MAX: u32 = 12;
/// Turn from cone to cone of a spiral.
const GOLDEN_ANGLE_RAD: f32 = 2.399_963_2;

/// A scene's voxels, filled and filtered.
#[derive(Clone, Debug)]
pub struct Volume {
    /// The octree.
    pub tree: Tree,
    /// Its bricks.
    pub levels: Levels,
    /// The model, and how it is read.
    pub kind: Kind,
    /// Places of samples.
    pub sampling: Sampling,
    /// Distance from a surface at which mended cones start, in voxels.
    pub start: f32,
}

/// A cone from a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Its tip in metres.
    pub from_m: Vec3,
    /// Unit normal of the surface there.
    pub normal: Vec3,
    /// Unit axis.
    pub direction: Vec3,
    /// α/2.
    pub half_angle_rad: f32,
}

/// Light and opacity along a cone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Met {
    /// Mean radiance of what stops it, times its share of the cone.
    pub light: Vec3,
    /// Share of the cone that is stopped; 1 at most.
    pub opacity: f32,
    /// Opacity weighted by (1 − t/R)².
    pub near: f32,
}

impl Volume {
    /// Follows a cone. `reach_m` is R of ambient occlusion.
    pub fn trace(&self, cone: &Cone, reach_m: f32) -> Met {
        let cube = &self.tree.cube;
        let voxel_m = cube.voxel_m();
        let is_mended = self.kind.manner == Manner::Mended;
        let off_m = if is_mended { self.start * voxel_m } else { 0.0 };
        let from_m = cone.from_m + cone.normal * off_m;
        let mut met = Met::default();
        for (along_m, size_m) in self.samples(cone.half_angle_rad) {
            let point_m = from_m + cone.direction * along_m;
            if size_m > cube.side_m || cube.outside_m(point_m) > 2.0 * size_m {
                break;
            }
            let sample = quadrilinear(&self.tree, &self.levels, size_m, point_m, self.kind.manner);
            let (light, opacity) = shaded(&sample, cone.direction, cone.half_angle_rad, self.kind);
            let left = 1.0 - met.opacity;
            met.light += left * light;
            // As written opacities add up, whatever is left.
            let stopped = if is_mended { left * opacity } else { opacity.min(left) };
            met.opacity += stopped;
            met.near += stopped * (1.0 - ((off_m + along_m) / reach_m).min(1.0)).powi(2);
            if met.opacity >= if is_mended { OPAQUE } else { 1.0 } {
                break;
            }
        }
        met
    }

    /// Distances of samples, and diameters there.
    fn samples(&self, half_angle_rad: f32) -> impl Iterator<Item = (f32, f32)> {
        let voxel_m = self.tree.cube.voxel_m();
        let widening = 2.0 * half_angle_rad.tan();
        let by_levels = match self.sampling {
            Sampling::Paper => self.kind.manner == Manner::Written && half_angle_rad >= WIDE_RAD,
            Sampling::Levels => true,
            Sampling::Diameters => false,
        };
        let is_mended = self.kind.manner == Manner::Mended;
        let first_m = if by_levels || !is_mended { voxel_m / widening } else { 0.5 * voxel_m };
        let next = move |along_m: f32| {
            if by_levels { 2.0 * along_m } else { along_m + voxel_m.max(widening * along_m) }
        };
        std::iter::successors(Some(first_m), move |along_m| Some(next(*along_m)))
            .take(SAMPLES_MAX)
            .map(move |along_m| (along_m, voxel_m.max(widening * along_m)))
    }
}

/// Diffuse cones about +z, all of one solid angle that together fill the hemisphere, with their weights by the cosine: one along it, the others in a ring; more than
/// twelve in a spiral.
pub fn diffuse_cones(count: u32) -> (f32, Vec<(Vec3, f32)>) {
    let cap = 1.0 - 1.0 / count as f32;
    let (up, out) = (0.5 * cap, (1.0 - 0.25 * cap * cap).sqrt());
    let ring = (1..count).map(|at| {
        let turn = 2.0 * PI * at as f32 / (count - 1) as f32;
        Vec3::new(out * turn.cos(), out * turn.sin(), up)
    });
    let spiral = (0..count).map(|at| {
        let up = 1.0 - (at as f32 + 0.5) / count as f32;
        let turn = GOLDEN_ANGLE_RAD * at as f32;
        let out = (1.0 - up * up).sqrt();
        Vec3::new(out * turn.cos(), out * turn.sin(), up)
    });
    let axes: Vec<Vec3> =
        if count <= RING_MAX { std::iter::once(Vec3::Z).chain(ring).collect() } else { spiral.collect() };
    let total: f32 = axes.iter().map(|axis| axis.z).sum();
    (cap.acos(), axes.into_iter().map(|axis| (axis, axis.z / total)).collect())
}

impl Volume {
    /// Irradiance by diffuse cones with what is left by the sky, and ambient occlusion within a reach. Of `written` volumes nothing is left to the sky.
    pub fn diffuse(
        &self,
        (from_m, normal): (Vec3, Vec3),
        count: u32,
        reach_m: f32,
        sky: impl Fn(Vec3) -> Vec3,
    ) -> Diffuse {
        let (half_angle_rad, cones) = diffuse_cones(count);
        let (x, y) = tangent_frame(normal);
        let mut found = Diffuse { open: 1.0, ..Diffuse::default() };
        for (local, weight) in cones {
            let direction = x * local.x + y * local.y + normal * local.z;
            let met = self.trace(&Cone { from_m, normal, direction, half_angle_rad }, reach_m);
            found.irradiance += PI * weight * self.with_sky(&met, direction, &sky);
            found.open -= weight * met.near;
            found.unstopped += weight * (1.0 - met.opacity);
        }
        found
    }

    /// Light of a cone, what is left of it by the sky.
    pub fn with_sky(&self, met: &Met, direction: Vec3, sky: impl Fn(Vec3) -> Vec3) -> Vec3 {
        match self.kind.manner {
            Manner::Written => met.light,
            Manner::Mended => met.light + (1.0 - met.opacity) * sky(direction),
        }
    }
}

/// Irradiance and occlusion of a point by diffuse cones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Diffuse {
    /// Irradiance in W·m⁻².
    pub irradiance: Vec3,
    /// Ambient occlusion, 1 where nothing is near.
    pub open: f32,
    /// Share that nothing stops.
    pub unstopped: f32,
}
