//! The scene's emissive triangles, sampled by the light that a site can get from each.

use std::ops::Deref;

use glam::{DVec3, Vec3};

use super::tally::luminance;
use crate::emitters::{EmissiveTriangle, emissive_triangles};
use crate::geometry::{Geometry, Site, weights_of};
use crate::rays::sampling::uniform_triangle;

/// Triangles up to which every site weighs each one by distance and facing; beyond, all choose by power alone.
const BY_REACH_MAX: usize = 64;

/// An emissive triangle and its power: area × luminance of the mean radiance.
#[derive(Clone, Copy, Debug)]
struct Emitter {
    of: EmissiveTriangle,
    power: f64,
}

impl Deref for Emitter {
    type Target = EmissiveTriangle;

    fn deref(&self) -> &EmissiveTriangle {
        &self.of
    }
}

/// All of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Emitters {
    emitters: Vec<Emitter>,
    /// Index into `emitters` by triangle, or `u32::MAX`; empty when nothing emits.
    index_of: Vec<u32>,
    /// Running sum of chances by power, ending in 1.
    by_power: Vec<f64>,
    scale: f64,
}

/// Chances of the emitters as one site sees them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chances {
    by_reach: Option<([f64; BY_REACH_MAX], f64)>,
}

/// A point taken on an emitter.
#[derive(Clone, Copy, Debug)]
pub(super) struct EmitterSample {
    /// Triangle through all instances.
    pub triangle: u32,
    /// Weights of its corners 1 and 2.
    pub barycentric: [f32; 2],
    /// Point in metres.
    pub point_m: Vec3,
    /// The triangle's normal, of the side that faces the site.
    pub normal: Vec3,
    /// Unit direction to the point.
    pub direction: Vec3,
    /// Density per steradian.
    pub density: f64,
}

impl Emitters {
    /// Finds them; none when `scale` is 0.
    pub fn new(geometry: &Geometry, scale: f32) -> Self {
        let mut set = Self { scale: f64::from(scale), ..Self::default() };
        if scale <= 0.0 || geometry.scene.materials.iter().all(|material| material.emissive == [0.0; 3]) {
            return set;
        }
        set.index_of = vec![u32::MAX; geometry.triangles.len()];
        for of in emissive_triangles(geometry) {
            set.index_of[of.triangle as usize] = set.emitters.len() as u32;
            let luminance_of = |radiance: [f32; 3]| luminance(Vec3::from(radiance).as_dvec3());
            // A texture may be dark in the mean and still hold a lamp: a hundredth of the factor at least.
            let mean = luminance_of(of.mean_radiance).max(0.01 * luminance_of(of.factor));
            set.emitters.push(Emitter { of, power: f64::from(of.area_m2) * mean });
        }
        set.by_power = running_share(set.emitters.iter().map(|emitter| emitter.power));
        set
    }

    /// Nothing emits.
    pub fn is_empty(&self) -> bool {
        self.by_power.is_empty()
    }

    /// Factor on the file's emission.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Chances by which a site chooses.
    pub fn chances(&self, site: &Site) -> Chances {
        if self.emitters.len() > BY_REACH_MAX {
            return Chances { by_reach: None };
        }
        let mut weights = [0.0; BY_REACH_MAX];
        weights.iter_mut().zip(&self.emitters).for_each(|(weight, emitter)| *weight = emitter.reach(site));
        Chances { by_reach: Some((weights, weights.iter().sum())) }
    }

    /// A point on an emitter; `None` when none can reach the site, or the one chosen faces away.
    pub fn sample(
        &self,
        site: &Site,
        chances: &Chances,
        pick: f32,
        point: [f32; 2],
    ) -> Option<EmitterSample> {
        let index = self.choose(chances, f64::from(pick))?;
        let emitter = &self.emitters[index];
        let barycentric = uniform_triangle(point);
        let weights = weights_of(barycentric);
        let [a, b, c] = emitter.corners;
        let point_m = a * weights.x + b * weights.y + c * weights.z;
        let to_emitter = point_m - site.position_m;
        let direction = to_emitter.try_normalize()?;
        let density = self.density_of(index, chances, direction, f64::from(to_emitter.length_squared()))?;
        let normal = if direction.dot(emitter.normal) < 0.0 { emitter.normal } else { -emitter.normal };
        Some(EmitterSample { triangle: emitter.triangle, barycentric, point_m, normal, direction, density })
    }

    /// Density per steradian with which a site takes the point of a triangle at a distance; 0 for one that it never takes.
    pub fn density(&self, triangle: u32, chances: &Chances, direction: Vec3, distance_m: f32) -> f64 {
        let index = self.index_of.get(triangle as usize).copied().unwrap_or(u32::MAX) as usize;
        if index >= self.emitters.len() {
            return 0.0;
        }
        let squared_m2 = f64::from(distance_m) * f64::from(distance_m);
        self.density_of(index, chances, direction, squared_m2).unwrap_or(0.0)
    }

    fn choose(&self, chances: &Chances, pick: f64) -> Option<usize> {
        let Some((weights, total)) = &chances.by_reach else {
            return Some(self.by_power.partition_point(|sum| *sum <= pick).min(self.emitters.len() - 1));
        };
        let mut left = pick * total;
        let mut last = None;
        for (index, weight) in weights.iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            last = Some(index);
            if left < *weight {
                break;
            }
            left -= weight;
        }
        last
    }

    /// `P · d² / (A cosθ)`.
    fn density_of(&self, index: usize, chances: &Chances, direction: Vec3, squared_m2: f64) -> Option<f64> {
        let emitter = &self.emitters[index];
        let facing = -f64::from(direction.dot(emitter.normal));
        if facing == 0.0 || (facing < 0.0 && !emitter.double_sided) {
            return None;
        }
        let chance = match &chances.by_reach {
            Some((weights, total)) => weights[index] / total,
            None => self.by_power[index] - if index == 0 { 0.0 } else { self.by_power[index - 1] },
        };
        let density = chance * squared_m2 / (f64::from(emitter.area_m2) * facing.abs());
        (density > 0.0 && density.is_finite()).then_some(density)
    }
}

impl Emitter {
    /// Power over squared distance; 0 only where no light can come from.
    fn reach(&self, site: &Site) -> f64 {
        let behind = (site.position_m - self.corners[0]).dot(self.normal) <= 0.0 && !self.double_sided;
        let below =
            self.corners.iter().all(|corner| (*corner - site.position_m).dot(site.face_normal) <= 0.0);
        if behind || below {
            return 0.0;
        }
        let centre_m = (self.corners[0] + self.corners[1] + self.corners[2]) / 3.0;
        self.power / f64::from(centre_m.distance_squared(site.position_m)).max(f64::from(self.area_m2))
    }
}

/// Running sums over their total; empty when all are 0.
fn running_share(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut total = 0.0;
    let sums: Vec<f64> = values
        .map(|value| {
            total += value;
            total
        })
        .collect();
    if total > 0.0 { sums.iter().map(|sum| sum / total).collect() } else { Vec::new() }
}

/// Emission of a point as the file has it, W·m⁻²·sr⁻¹.
pub(super) fn emission_of(emission: [f32; 3], scale: f64) -> DVec3 {
    Vec3::from(emission).as_dvec3() * scale
}
