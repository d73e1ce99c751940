//! Receivers to measure at: a stratified sample of the scene's lit area.

use std::collections::BTreeMap;

use glam::{Mat3, Vec3};

use crate::prt::stage::Stage;
use crate::prt::{Surface, World, corners_of, weights_of};
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
    /// Share of the area in cavities that nothing in the open sees, not in `share_without`.
    pub share_in_cavities: f64,
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
        let (hits, area_m2) = strata(world, count);
        let stratum_m2 = area_m2 / f64::from(count);
        let mut area_of: BTreeMap<u32, f64> = BTreeMap::new();
        let (mut without_m2, mut in_cavities_m2) = (0.0, 0.0);
        for hit in hits {
            match world.surface_at(&hit) {
                Surface::Receiver(receiver) => *area_of.entry(receiver).or_default() += stratum_m2,
                Surface::Dark if world.is_in_cavity(&hit) => in_cavities_m2 += stratum_m2,
                Surface::Dark => without_m2 += stratum_m2,
            }
        }
        let receivers =
            area_of.into_iter().map(|(receiver, area_m2)| Sampled { receiver, area_m2 }).collect();
        let share_of = |part_m2: f64| if area_m2 > 0.0 { part_m2 / area_m2 } else { 0.0 };
        let (share_without, share_in_cavities) = (share_of(without_m2), share_of(in_cavities_m2));
        Self { receivers, area_m2, share_without, share_in_cavities }
    }

    /// Their places, in order.
    pub fn sites(&self, stage: &Stage) -> Vec<Site> {
        self.receivers.iter().map(|sampled| site_of(stage, sampled.receiver)).collect()
    }
}

/// Sites spread over the scene by area: of the scene alone, however it was baked.
pub fn spread_sites(world: &World, count: u32) -> Vec<Site> {
    let site = |hit: Hit| {
        let [a, b, c] = corners_of(&world.scene, world.geometry.triangles[hit.triangle as usize]);
        let position_m = Mat3::from_cols(a, b, c) * weights_of(hit.barycentric);
        let normal = world.side_normal(&hit);
        Site { position_m, normal, face_normal: normal }
    };
    strata(world, count).0.into_iter().map(site).collect()
}

/// A point in each of `count` equal strata of the lit area, as if a ray had met it, and that area in m².
fn strata(world: &World, count: u32) -> (Vec<Hit>, f64) {
    let sides = sides(world);
    let area_m2: f64 = sides.iter().map(|side| side.area_m2).sum();
    let stratum_m2 = area_m2 / f64::from(count);
    let points = R2::new(0);
    let mut hits = Vec::with_capacity(count as usize);
    let mut before_m2 = 0.0;
    for side in &sides {
        while hits.len() < count as usize && (hits.len() as f64 + 0.5) * stratum_m2 < before_m2 + side.area_m2
        {
            let barycentric = uniform_triangle(points.point(hits.len() as u32));
            hits.push(Hit { t: 0.0, triangle: side.triangle, barycentric, front: side.front });
        }
        before_m2 += side.area_m2;
    }
    (hits, area_m2)
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
