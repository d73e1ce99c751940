//! Scenes for tests: shells and sheets of triangles, and their elements by exact overlap with sub-voxels.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use glam::{DMat3, DVec3, IVec3, Vec3};

use super::content::{
    Brick, BrickKey, Element, NormalCode, SUBS, Voxel, VoxelPart, place_in_brick, sub_in_voxel,
};
use super::table::{VoxelTable, mixed, patch_numbers};
use crate::content::{Patch, PatchKey, PatchSet};

/// Random numbers.
pub struct Random(pub u32);

impl Random {
    /// Uniform in 0..1.
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9);
        (mixed(mixed(self.0)) >> 8) as f32 / (1 << 24) as f32
    }

    /// Uniform in the cube from −1 to 1.
    pub fn point(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }

    /// Uniform over the sphere.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let at = self.point();
            if at.length_squared() < 1.0 && at.length_squared() > 0.01 {
                return at.normalize();
            }
        }
    }
}

/// A triangle, seen from where its corners turn to the left.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    /// Corners in metres.
    pub corners: [DVec3; 3],
    /// Number of the surface that it is part of: another one has other patches.
    pub surface: u32,
    /// Its other side is dark; otherwise it is not there.
    pub is_backed: bool,
    /// Level below which it has no elements.
    pub finest: u32,
}

impl Facet {
    fn new(corners: [DVec3; 3], surface: u32) -> Self {
        Self { corners, surface, is_backed: false, finest: 0 }
    }

    /// Its unit normal.
    pub fn normal(&self) -> DVec3 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a).normalize()
    }

    /// Length of a line to its front; `None` where it passes by or comes from behind.
    pub fn meets(&self, from_m: Vec3, direction: Vec3) -> Option<f32> {
        let [a, b, c] = self.corners.map(|at| at - from_m.as_dvec3());
        let direction = direction.as_dvec3();
        let inside = [(a, b), (b, c), (c, a)].map(|(a, b)| direction.dot(a.cross(b)) <= 0.0);
        let t_m = a.dot(self.normal()) / direction.dot(self.normal());
        (inside == [true; 3] && direction.dot(self.normal()) < 0.0 && t_m >= 0.0).then_some(t_m as f32)
    }

    /// A random point of it.
    pub fn point(&self, random: &mut Random) -> Vec3 {
        let [a, b, c] = self.corners;
        let (u, v) = (f64::from(random.next()), f64::from(random.next()));
        let [u, v] = if u + v > 1.0 { [1.0 - u, 1.0 - v] } else { [u, v] };
        (a + (b - a) * u + (c - a) * v).as_vec3()
    }
}

/// A parallelogram of a corner and the sides along two neighbours, seen from where `x`, `y` turn to the left.
pub fn sheet(corner: DVec3, x: DVec3, y: DVec3, surface: u32) -> Vec<Facet> {
    let [a, b, c, d] = [corner, corner + x, corner + x + y, corner + y];
    vec![Facet::new([a, b, c], surface), Facet::new([a, c, d], surface)]
}

/// The inner side of a turned box; a surface each face.
pub fn box_shell(half: DVec3, turn: DMat3) -> Vec<Facet> {
    let mut facets = Vec::new();
    for axis in 0..3 {
        let [x, y, z] = [1, 2, 0].map(|next| turn.col((axis + next) % 3) * half[(axis + next) % 3]);
        facets.extend(sheet(-x - y - z, x * 2.0, y * 2.0, 2 * axis as u32));
        facets.extend(sheet(z - x - y, y * 2.0, x * 2.0, 2 * axis as u32 + 1));
    }
    facets
}

/// The inner side of a sphere of 8·4^halvings facets.
pub fn sphere_shell(radius: f64, halvings: u32) -> Vec<Facet> {
    let mut facets = Vec::new();
    for eighth in 0..8 {
        let sign = |axis: u32| if eighth >> axis & 1 == 0 { 1.0 } else { -1.0 };
        let [x, y, z] = [DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2)];
        let is_left = sign(0) * sign(1) * sign(2) > 0.0;
        facets.push(if is_left { [x, z, y] } else { [x, y, z] });
    }
    for _ in 0..halvings {
        let halved = facets.iter().flat_map(|&[a, b, c]: &[DVec3; 3]| {
            let [ab, bc, ca] = [a + b, b + c, c + a].map(DVec3::normalize);
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        });
        facets = halved.collect();
    }
    facets.into_iter().map(|corners| Facet::new(corners.map(|at| at * radius), 0)).collect()
}

/// A turn about a slanted axis by an odd angle.
pub fn odd_turn() -> DMat3 {
    DMat3::from_axis_angle(DVec3::new(0.3, -0.7, 0.64).normalize(), 0.87)
}

/// Elements of facets, and the keys of their patches, ascending: one a voxel and surface.
pub struct Scene {
    /// Elements.
    pub part: VoxelPart,
    /// All patches.
    pub patches: PatchSet,
}

impl Scene {
    /// Elements of levels.
    pub fn new(voxel_m: f64, levels: Range<u32>, facets: &[Facet]) -> Self {
        let mut bricks = Vec::new();
        for level in levels.rev() {
            bricks.extend(level_bricks(voxel_m * f64::from(1 << level), level, facets));
        }
        let elements = bricks.iter().flat_map(|brick: &Brick| &brick.elements);
        let keys: BTreeSet<PatchKey> = elements.filter_map(|element| element.patch).collect();
        let patch = |key| Patch { key, first_leaf: 0, leaf_count: 0 };
        let patches = PatchSet { patches: keys.into_iter().map(patch).collect(), ..PatchSet::default() };
        Self { part: VoxelPart { voxel_m: voxel_m as f32, glows: Vec::new(), bricks }, patches }
    }

    /// Its table.
    pub fn table(&self) -> VoxelTable {
        self.table_of(|_| true)
    }

    /// The table of some of its bricks.
    pub fn table_of(&self, is_there: impl Fn(BrickKey) -> bool) -> VoxelTable {
        let bricks = self.part.bricks.iter().filter(|brick| is_there(brick.key)).cloned().collect();
        let part = VoxelPart { bricks, ..self.part.clone() };
        VoxelTable::join([&part].into_iter(), patch_numbers(&self.patches).unwrap()).unwrap()
    }

    /// Surface of a patch by its number.
    pub fn surface(&self, patch: u32) -> u32 {
        self.patches.patches[patch as usize].key.ordinal()
    }

    /// Level of a patch by its number, which is that of its elements.
    pub fn level(&self, patch: u32) -> u32 {
        self.patches.patches[patch as usize].key.level() as u32
    }
}

/// An element that facets are added to.
struct Growing {
    facet: Facet,
    point: DVec3,
    normals: DVec3,
    points: DVec3,
    area: f64,
    bits: u64,
}

fn level_bricks(side_m: f64, level: u32, facets: &[Facet]) -> Vec<Brick> {
    let mut voxels: BTreeMap<(BrickKey, u16), (IVec3, Vec<Growing>)> = BTreeMap::new();
    for facet in facets.iter().filter(|facet| facet.finest <= level) {
        for voxel in touched(&facet.corners, side_m) {
            let place = (BrickKey::of_voxel(level, voxel), place_in_brick(voxel));
            let (_, growing) = voxels.entry(place).or_insert((voxel, Vec::new()));
            grow(growing, facet, voxel, side_m);
        }
    }
    let mut bricks: Vec<Brick> = Vec::new();
    for ((key, place), (voxel, growing)) in voxels {
        if bricks.last().is_none_or(|brick| brick.key != key) {
            bricks.push(Brick { key, voxels: Vec::new(), elements: Vec::new() });
        }
        let Some(brick) = bricks.last_mut() else { continue };
        brick.voxels.push(Voxel { place, elements: growing.len() as u16 });
        brick.elements.extend(growing.iter().map(|growing| element(growing, voxel, side_m, level)));
    }
    bricks
}

/// Cells of a lattice that a triangle touches.
fn touched(corners: &[DVec3; 3], side_m: f64) -> Vec<IVec3> {
    let [a, b, c] = corners.map(|at| at / side_m);
    let low = a.min(b).min(c).ceil().as_ivec3() - 1;
    let high = a.max(b).max(c).floor().as_ivec3();
    let mut cells = Vec::new();
    for z in low.z..=high.z {
        for y in low.y..=high.y {
            cells.extend((low.x..=high.x).map(|x| IVec3::new(x, y, z)));
        }
    }
    cells.retain(|cell| overlaps(corners, (cell.as_dvec3() + 0.5) * side_m, 0.5 * side_m));
    cells
}

/// Whether a triangle touches a cube: no axis of thirteen parts them.
fn overlaps(corners: &[DVec3; 3], middle: DVec3, half: f64) -> bool {
    let [a, b, c] = corners.map(|at| at - middle);
    let edges = [b - a, c - b, a - c];
    let crosses = edges.into_iter().flat_map(|edge| DVec3::AXES.map(|axis| axis.cross(edge)));
    let mut axes = DVec3::AXES.into_iter().chain([edges[0].cross(edges[1])]).chain(crosses);
    axes.all(|axis| {
        let [a, b, c] = [a, b, c].map(|at| at.dot(axis));
        let reach = half * axis.abs().element_sum();
        a.min(b).min(c) <= reach && a.max(b).max(c) >= -reach
    })
}

/// Adds what lies of a facet in a voxel: to an element whose surface bends away by less than 25° and h/8, or as a new one.
fn grow(growing: &mut Vec<Growing>, facet: &Facet, voxel: IVec3, side_m: f64) {
    let mut bits = 0_u64;
    let sub_m = side_m / f64::from(SUBS);
    for sub in 0..SUBS.pow(3) {
        let sub = voxel * SUBS + IVec3::new(sub % SUBS, sub / SUBS % SUBS, sub / (SUBS * SUBS));
        if overlaps(&facet.corners, (sub.as_dvec3() + 0.5) * sub_m, 0.5 * sub_m) {
            bits |= 1 << sub_in_voxel(sub);
        }
    }
    let (area, point) = clipped(&facet.corners, voxel.as_dvec3() * side_m, side_m);
    let normal = facet.normal();
    let fits = |other: &&mut Growing| {
        other.facet.surface == facet.surface
            && other.facet.finest == facet.finest
            && other.facet.normal().dot(normal) > 25.0_f64.to_radians().cos()
            && other.facet.normal().dot(point - other.point).abs() < side_m / 8.0
    };
    // What merely touches counts next to nothing.
    let area = area + 1e-9 * side_m * side_m;
    match growing.iter_mut().find(fits) {
        Some(other) => {
            other.normals += normal * area;
            other.points += point * area;
            other.area += area;
            other.bits |= bits;
        }
        None => growing.push(Growing {
            facet: *facet,
            point,
            normals: normal * area,
            points: point * area,
            area,
            bits,
        }),
    }
}

fn element(growing: &Growing, voxel: IVec3, side_m: f64, level: u32) -> Element {
    let normal = NormalCode::of(growing.normals.normalize());
    let middle = (voxel.as_dvec3() + 0.5) * side_m;
    let height_m = normal.normal().as_dvec3().dot(growing.points / growing.area - middle);
    Element {
        normal,
        plane: Element::plane_code(height_m, side_m),
        bits: growing.bits,
        patch: Some(PatchKey::of_cell(level, voxel.to_array(), 0, growing.facet.surface)),
        glow: 0,
        is_backed: growing.facet.is_backed,
        is_finest: growing.facet.finest == level,
    }
}

/// Area and middle of a triangle's part in a cube.
fn clipped(corners: &[DVec3; 3], low: DVec3, side_m: f64) -> (f64, DVec3) {
    let mut polygon = corners.to_vec();
    for axis in DVec3::AXES {
        for (axis, bound) in [(axis, low.dot(axis) + side_m), (-axis, -low.dot(axis))] {
            let beyond = |at: DVec3| at.dot(axis) - bound;
            let mut kept = Vec::new();
            for (index, &a) in polygon.iter().enumerate() {
                let b = polygon[(index + 1) % polygon.len()];
                if beyond(a) <= 0.0 {
                    kept.push(a);
                }
                if beyond(a) * beyond(b) < 0.0 {
                    kept.push(a + (b - a) * (beyond(a) / (beyond(a) - beyond(b))));
                }
            }
            polygon = kept;
        }
    }
    let Some(&first) = polygon.first() else { return (0.0, corners[0]) };
    let (mut area, mut sum) = (0.0, DVec3::ZERO);
    for pair in polygon.windows(2) {
        let of = 0.5 * (pair[0] - first).cross(pair[1] - first).length();
        area += of;
        sum += (first + pair[0] + pair[1]) / 3.0 * of;
    }
    if area > 0.0 { (area, sum / area) } else { (0.0, first) }
}
