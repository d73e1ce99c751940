//! Receivers to measure at: a stratified sample of the scene's lit area.

use std::collections::BTreeMap;

use glam::Vec3;

use crate::prt::stage::Stage;
use crate::prt::{Surface, World, corners_of};
use crate::rays::Hit;
use crate::rays::sampling::{R2, uniform_triangle};
use crate::reference::Site;

/// Cells of the Morton curve along each axis.
const MORTON_CELLS: f32 = 1023.0;

/// A receiver and the area that it stands for in the sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampled {
    /// Index into the stage's receivers.
    pub receiver: u32,
    /// Area in m²; those of a sample sum up to the scene's, less what has no receiver.
    pub area_m2: f64,
}

/// A sample of receivers, ascending.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// The receivers.
    pub receivers: Vec<Sampled>,
    /// Area of all lit sides of the scene, in m².
    pub area_m2: f64,
    /// Share of it whose surface is too small or too deep in geometry for a receiver.
    pub share_without: f64,
}

/// One lit side of a triangle.
struct Side {
    morton: u32,
    triangle: u32,
    front: bool,
    area_m2: f64,
}

impl Sample {
    /// Cuts the lit area into `count` equal strata along a Morton curve over the triangles, takes the point of a
    /// low-discrepancy sequence in each, and of that point the receiver that stands for it.
    pub fn new(world: &World, count: u32) -> Self {
        let sides = sides(world);
        let area_m2: f64 = sides.iter().map(|side| side.area_m2).sum();
        let stratum_m2 = area_m2 / f64::from(count);
        let points = R2::new(0);
        let mut area_of: BTreeMap<u32, f64> = BTreeMap::new();
        let (mut next, mut before_m2, mut without_m2) = (0, 0.0, 0.0);
        for side in &sides {
            while next < count && (f64::from(next) + 0.5) * stratum_m2 < before_m2 + side.area_m2 {
                let barycentric = uniform_triangle(points.point(next));
                let hit = Hit { t: 0.0, triangle: side.triangle, barycentric, front: side.front };
                match world.surface_at(&hit) {
                    Surface::Receiver(receiver) => *area_of.entry(receiver).or_default() += stratum_m2,
                    Surface::Dark => without_m2 += stratum_m2,
                }
                next += 1;
            }
            before_m2 += side.area_m2;
        }
        let receivers =
            area_of.into_iter().map(|(receiver, area_m2)| Sampled { receiver, area_m2 }).collect();
        Self { receivers, area_m2, share_without: if area_m2 > 0.0 { without_m2 / area_m2 } else { 0.0 } }
    }

    /// Their places, in order.
    pub fn sites(&self, stage: &Stage) -> Vec<Site> {
        self.receivers.iter().map(|sampled| site_of(stage, sampled.receiver)).collect()
    }
}

/// A receiver as a site of the reference.
pub fn site_of(stage: &Stage, receiver: u32) -> Site {
    let receiver = &stage.receivers[receiver as usize];
    Site { position_m: receiver.position_m, normal: receiver.normal, face_normal: receiver.face_normal }
}

/// All lit sides, along the Morton curve of the triangles' middles.
fn sides(world: &World) -> Vec<Side> {
    let positions = || world.scene.instances.iter().flat_map(|instance| &instance.positions_m);
    let low = positions().fold(Vec3::INFINITY, |low, p| low.min(*p));
    let high = positions().fold(Vec3::NEG_INFINITY, |high, p| high.max(*p));
    let scale = MORTON_CELLS / (high - low).max_element().max(f32::MIN_POSITIVE);
    let mut sides = Vec::new();
    for (index, &reference) in world.geometry.triangles.iter().enumerate() {
        let [a, b, c] = corners_of(&world.scene, reference);
        let area_m2 = 0.5 * f64::from((b - a).cross(c - a).length());
        let cell = (((a + b + c) / 3.0 - low) * scale).clamp(Vec3::ZERO, Vec3::splat(MORTON_CELLS));
        let morton = [cell.x, cell.y, cell.z].map(|axis| spread(axis as u32));
        let side = |front| Side {
            morton: morton[0] | morton[1] << 1 | morton[2] << 2,
            triangle: index as u32,
            front,
            area_m2,
        };
        sides.push(side(true));
        if world.material(index as u32).double_sided {
            sides.push(side(false));
        }
    }
    sides.sort_by_key(|side| (side.morton, side.triangle, !side.front));
    sides
}

/// The ten low bits, two zeros after each.
fn spread(value: u32) -> u32 {
    (0..10).fold(0, |spread, bit| spread | (value >> bit & 1) << (3 * bit))
}
