//! Voxels of the finest level from a scene's triangles.

use std::collections::HashMap;

use glam::{IVec3, Vec2, Vec3};
use lightkiln_worker::geometry::{Geometry, weights_of};
use lightkiln_worker::rays::Hit;
use lightkiln_worker::scene::surface::{Footprint, SurfaceSample, surface_at};

use super::corner::{Corner, lobe, towards};
use super::tree::Cube;
use super::{Kind, Manner, Model};

/// Least cosine between a surface and an axis that it faces.
const FACING_MIN: f32 = 0.02;
/// Weight of surfaces that lie along an axis among those that face it.
const ALONG: f32 = 1e-3;
/// Least albedo that light is divided by.
const ALBEDO_MIN: f32 = 0.01;

/// A voxel fragment: a point of a triangle, drawn once along its main axis (§5.2.1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Cell of its voxel.
    pub voxel: IVec3,
    /// The point, on the front of its triangle.
    pub hit: Hit,
    /// Area that it stands for, of a voxel's face.
    pub share: f32,
}

/// The voxels that hold something.
#[derive(Clone, Debug, Default)]
pub struct Leaves {
    /// Their cells.
    pub cells: Vec<IVec3>,
    /// Their values.
    pub rows: Vec<Corner>,
    /// ρ of each.
    pub albedo: Vec<Vec3>,
    index: HashMap<IVec3, u32>,
}

impl Leaves {
    /// Voxels by their cells, with values and ρ; cells are unlike each other.
    pub fn new(voxels: impl IntoIterator<Item = (IVec3, Corner, Vec3)>) -> Self {
        let mut leaves = Self::default();
        for (cell, row, albedo) in voxels {
            leaves.index.insert(cell, leaves.cells.len() as u32);
            leaves.cells.push(cell);
            leaves.rows.push(row);
            leaves.albedo.push(albedo);
        }
        leaves
    }

    /// Number of the voxel of a cell.
    pub fn number(&self, cell: IVec3) -> Option<usize> {
        self.index.get(&cell).map(|at| *at as usize)
    }

    /// Values of the voxel of a cell.
    pub fn find(&self, cell: IVec3) -> Option<&Corner> {
        self.number(cell).map(|at| &self.rows[at])
    }
}

/// All fragments of a scene, holes of masks left out, in the order of their triangles.
pub fn fragments(geometry: &Geometry, cube: &Cube) -> Vec<Fragment> {
    let mut found = Vec::new();
    for triangle in 0..geometry.triangles.len() as u32 {
        draw(geometry, cube, triangle, &mut found);
    }
    found
}

fn draw(geometry: &Geometry, cube: &Cube, triangle: u32, found: &mut Vec<Fragment>) {
    let voxel_m = cube.voxel_m();
    let corners = geometry.corners(triangle).map(|corner| (corner - cube.low_m) / voxel_m);
    let normal = geometry.face_normal(triangle);
    let main = normal.abs().max_position();
    let flat = corners.map(|corner| Vec2::new(corner[(main + 1) % 3], corner[(main + 2) % 3]));
    let [a, b, c] = flat;
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    // Middles of pixels, half a unit off whole numbers.
    let first = (a.min(b).min(c) - 0.5).ceil().max(Vec2::ZERO).as_ivec2();
    let last = (a.max(b).max(c) - 0.5).floor().min(Vec2::splat((1u32 << cube.depth) as f32)).as_ivec2();
    for y in first.y..=last.y {
        for x in first.x..=last.x {
            let pixel = Vec2::new(x as f32, y as f32) + 0.5;
            let barycentric = [(pixel - a).perp_dot(c - a) / area, (b - a).perp_dot(pixel - a) / area];
            let weights = weights_of(barycentric);
            if weights.min_element() < 0.0 {
                continue;
            }
            let hit = Hit { t: 0.0, triangle, barycentric, front: true };
            if surface_of(geometry, &hit).stopped >= 0.5 {
                let voxel = cube.voxel_of(geometry.point_of(&hit));
                found.push(Fragment { voxel, hit, share: 1.0 / normal[main].abs() });
            }
        }
    }
}

/// The material at a hit.
pub fn surface_of(geometry: &Geometry, hit: &Hit) -> SurfaceSample {
    let place = geometry.triangles[hit.triangle as usize];
    let weights = weights_of(hit.barycentric).to_array();
    let (instance, triangle) = (place.instance as usize, place.triangle as usize);
    surface_at(&geometry.scene, &geometry.images, instance, triangle, weights, &Footprint::POINT)
}

/// A side of a fragment, lit or black.
struct Side {
    normal: Vec3,
    radiance: Vec3,
    share: f32,
}

/// The voxels of some fragments. As written the first of a voxel fills it and light comes later; mended all of them do, with the radiance that `light` gives
/// their sides.
pub fn leaves(
    geometry: &Geometry,
    fragments: &[Fragment],
    kind: Kind,
    light: impl Fn(&Hit) -> Vec3,
) -> Leaves {
    let mut sorted: Vec<&Fragment> = fragments.iter().collect();
    sorted.sort_by_key(|fragment| fragment.voxel.to_array());
    Leaves::new(sorted.chunk_by(|a, b| a.voxel == b.voxel).map(|of_voxel| {
        let (row, albedo) = match kind.manner {
            Manner::Written => first_of(geometry, of_voxel[0], kind.model),
            Manner::Mended => all_of(geometry, of_voxel, kind.model, &light),
        };
        (of_voxel[0].voxel, row, albedo)
    }))
}

fn first_of(geometry: &Geometry, fragment: &Fragment, model: Model) -> (Corner, Vec3) {
    let albedo = Vec3::from(surface_of(geometry, &fragment.hit).albedo);
    let mut row = Corner { opacity: Vec3::ONE, weight: 1.0, ..Corner::default() };
    if model == Model::Lobes {
        row.values[lobe::ALBEDO] = albedo;
        row.values[lobe::NORMAL] = geometry.face_normal(fragment.hit.triangle);
    }
    (row, albedo)
}

fn all_of(
    geometry: &Geometry,
    fragments: &[&Fragment],
    model: Model,
    light: &impl Fn(&Hit) -> Vec3,
) -> (Corner, Vec3) {
    let total: f32 = fragments.iter().map(|fragment| fragment.share).sum();
    let of = |fragment: &&Fragment| Vec3::from(surface_of(geometry, &fragment.hit).albedo) * fragment.share;
    let albedo = (fragments.iter().map(of).sum::<Vec3>() / total).max(Vec3::splat(ALBEDO_MIN));
    let sides: Vec<Vec<Side>> = fragments
        .iter()
        .map(|fragment| {
            let is_double = geometry.material(fragment.hit.triangle).double_sided;
            let backs = if is_double { 2 } else { 1 };
            let side = |front| {
                let hit = Hit { front, ..fragment.hit };
                Side { normal: geometry.side_normal(&hit), radiance: light(&hit), share: fragment.share }
            };
            [true, false].into_iter().take(backs).map(side).collect()
        })
        .collect();
    let mut row = Corner { opacity: Vec3::ONE, weight: 1.0, ..Corner::default() };
    match model {
        Model::Axes => {
            for axis in 0..3 {
                row.values[towards(axis, false)] = seen_along(&sides, axis, -1.0);
                row.values[towards(axis, true)] = seen_along(&sides, axis, 1.0);
            }
        }
        Model::Lobes => {
            let mean = |of: &dyn Fn(&Side) -> Vec3| {
                sides.iter().map(|sides| of(brighter(sides)) * sides[0].share).sum::<Vec3>() / total
            };
            row.values[lobe::ALBEDO] = albedo;
            row.values[lobe::NORMAL] = mean(&|side| side.normal);
            // Light that falls along the normal, so that ρ/π times it is the radiance.
            row.values[lobe::LIGHT_DIRECTION] = mean(&|side| side.normal);
            row.values[lobe::INCOMING] = mean(&|side| side.radiance) * std::f32::consts::PI / albedo;
        }
    }
    (row, albedo)
}

/// The side of a fragment that lobes have: those of both would have no mean normal.
fn brighter(sides: &[Side]) -> &Side {
    let [front, back] = sides else { return &sides[0] };
    if back.radiance.element_sum() > front.radiance.element_sum() { back } else { front }
}

/// Radiance seen from an end of an axis: the mean over sides by their projected areas; black where only backs are seen.
fn seen_along(sides: &[Vec<Side>], axis: usize, end: f32) -> Vec3 {
    let weight = |side: &Side| {
        let cosine = end * side.normal[axis];
        let facing = if cosine > FACING_MIN {
            cosine
        } else if cosine > -FACING_MIN {
            ALONG
        } else {
            0.0
        };
        facing * side.share
    };
    let all = || sides.iter().flatten();
    let total: f32 = all().map(weight).sum();
    let sum: Vec3 = all().map(|side| side.radiance * weight(side)).sum();
    if total > 0.0 { sum / total } else { Vec3::ZERO }
}
