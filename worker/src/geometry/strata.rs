//! Points spread over the scene's surfaces by area: one in each of equal strata along a Morton curve.

use glam::Vec3;

use super::{Geometry, Site};
use crate::rays::Hit;
use crate::rays::sampling::{R2, uniform_triangle};

/// Cells of the Morton curve along each axis.
const MORTON_CELLS: f32 = 1023.0;

/// One lit side of a triangle.
struct Side {
    morton: u32,
    triangle: u32,
    front: bool,
    area_m2: f64,
}

/// Equal strata of the lit area.
pub struct Strata {
    /// A point of each, as if a ray had met it.
    pub hits: Vec<Hit>,
    /// Area of all lit sides, in m².
    pub area_m2: f64,
}

impl Strata {
    /// Cuts the lit area into `count` strata and takes the point of a low-discrepancy sequence in each.
    pub fn new(geometry: &Geometry, count: u32) -> Self {
        let sides = sides(geometry);
        let area_m2: f64 = sides.iter().map(|side| side.area_m2).sum();
        let stratum_m2 = area_m2 / f64::from(count);
        let points = R2::new(0);
        let mut hits = Vec::with_capacity(count as usize);
        let mut before_m2 = 0.0;
        for side in &sides {
            let end_m2 = before_m2 + side.area_m2;
            while hits.len() < count as usize && (hits.len() as f64 + 0.5) * stratum_m2 < end_m2 {
                let barycentric = uniform_triangle(points.point(hits.len() as u32));
                hits.push(Hit { t: 0.0, triangle: side.triangle, barycentric, front: side.front });
            }
            before_m2 = end_m2;
        }
        Self { hits, area_m2 }
    }
}

/// Sites spread over the scene by area: of the scene alone, however it was baked.
pub fn spread_sites(geometry: &Geometry, count: u32) -> Vec<Site> {
    let site = |hit: &Hit| {
        let normal = geometry.side_normal(hit);
        Site { position_m: geometry.point_of(hit), normal, face_normal: normal }
    };
    Strata::new(geometry, count).hits.iter().map(site).collect()
}

/// Place of a point on a Morton curve through some bounds.
pub fn morton(point_m: Vec3, [low, high]: [Vec3; 2]) -> u32 {
    let scale = MORTON_CELLS / (high - low).max_element().max(f32::MIN_POSITIVE);
    let cell = ((point_m - low) * scale).clamp(Vec3::ZERO, Vec3::splat(MORTON_CELLS));
    let [x, y, z] = [cell.x, cell.y, cell.z].map(|axis| spread(axis as u32));
    x | y << 1 | z << 2
}

/// All lit sides, along the Morton curve of the triangles' middles.
fn sides(geometry: &Geometry) -> Vec<Side> {
    let bounds_m = geometry.bounds_m();
    let mut sides = Vec::new();
    for index in 0..geometry.triangles.len() as u32 {
        let [a, b, c] = geometry.corners(index);
        let area_m2 = 0.5 * f64::from((b - a).cross(c - a).length());
        let morton = morton((a + b + c) / 3.0, bounds_m);
        let side = |front| Side { morton, triangle: index, front, area_m2 };
        sides.push(side(true));
        if geometry.material(index).double_sided {
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
