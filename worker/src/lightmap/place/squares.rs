//! Squares of the lattice: the place of each texel on the plane of its face, by which texels of different charts are found to
//! be the same.

use glam::{DVec3, Vec2, Vec3};
use lightkiln_proto::content::Texel;
use rayon::prelude::*;

use super::blocks::sides;
use crate::geometry::lattice::cell_of;
use crate::geometry::{Geometry, Site, TriangleRef, corners_of, face_normal_of};
use crate::lightmap::polygon::{area_and_middle, clipped, source_weights, texels_of};
use crate::lightmap::texel_points::site_of;
use crate::lightmap::{Charts, World};
use crate::task::{Cancelled, Progress};
use crate::unwrap::{UnwrapBlock, UnwrappedTriangle};

/// Distance in texels, at the middle and along each side, within which two squares are one.
const TOLERANCE: f32 = 1.0 / 16.0;
/// Distance in texels across their plane within which two squares are one: planks lie millimetres above the floor in the joints
/// between them.
const LEVEL: f32 = 1.0 / 512.0;
/// Side in texels of the cells that squares are looked up by.
const CELL: f32 = 0.25;
/// Cosine between normals, of faces and of shading, from which on two points gather the same light.
pub const COPLANAR_COSINE_MIN: f32 = 0.98;
/// How far from a texel, in texels, surface is interpolated with it.
const READ_FROM: f32 = 0.5;

/// How far from the rim of a triangle, in texels, the points beside and beyond it lie.
const FROM_RIM: f32 = 1.0 / 64.0;
/// Distance in texels within which a point of a piece's outline lies on the rim of its triangle.
const ON_RIM: f32 = 1e-3;
/// Most places of rims, and of corners, that are kept of a texel.
const RIMS_MAX: usize = 16;

/// No chart reads a texel, or more than one does.
const NO_CHART: u32 = u32::MAX;
const SEVERAL_CHARTS: u32 = u32::MAX - 1;

/// A texel's square on the plane of a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Square {
    /// Its middle.
    pub middle_m: Vec3,
    /// Its sides along the texel's axes.
    pub right_m: Vec3,
    /// See `right_m`.
    pub up_m: Vec3,
}

impl Square {
    /// The square of a texel on the plane of a triangle, or piece of one, with these corners; `None` if that has no area.
    fn of(corners_m: [Vec3; 3], uv_texels: &[Vec2; 3], [x, y]: Texel) -> Option<Self> {
        let [p, q, r] = corners_m.map(|corner| corner.as_dvec3());
        let [a, b, c] = uv_texels.map(|corner| corner.as_dvec2());
        let (to_b, to_c) = (b - a, c - a);
        let area = to_b.perp_dot(to_c);
        let right: DVec3 = ((q - p) * to_c.y - (r - p) * to_b.y) / area;
        let up: DVec3 = ((r - p) * to_b.x - (q - p) * to_c.x) / area;
        let middle = p + right * (f64::from(x) + 0.5 - a.x) + up * (f64::from(y) + 0.5 - a.y);
        let square = Self { middle_m: middle.as_vec3(), right_m: right.as_vec3(), up_m: up.as_vec3() };
        (square.middle_m.is_finite() && square.right_m.is_finite() && square.up_m.is_finite())
            .then_some(square)
    }

    /// Both are the same to within a distance. They may be mirrored: faces wound the other way than their neighbours have
    /// their texels on the same plane from its back.
    fn coincides(&self, other: &Self, tolerance_m: f32) -> bool {
        let is_near = |one: Vec3, other: Vec3| one.distance(other) <= tolerance_m;
        let is_along = |one: Vec3, other: Vec3| is_near(one, other) || is_near(one, -other);
        is_near(self.middle_m, other.middle_m)
            && is_along(self.right_m, other.right_m)
            && is_along(self.up_m, other.up_m)
    }

    /// Of two that coincide: the axes along which one is the other's mirror image.
    pub fn mirrored(&self, other: &Self) -> [bool; 2] {
        [self.right_m.dot(other.right_m) < 0.0, self.up_m.dot(other.up_m) < 0.0]
    }
}

/// One side of the charts of a block.
#[derive(Clone, Copy)]
pub struct Faces<'a> {
    instance: u32,
    block: u32,
    charts: &'a UnwrapBlock,
    is_back: bool,
}

/// A texel that surface of one chart is interpolated with, and where the chart has no receiver.
#[derive(Clone, Debug)]
pub struct Reading {
    /// Block.
    pub block: u32,
    /// Texel there.
    pub texel: Texel,
    /// Its square.
    pub square: Square,
    /// Middle of the largest piece of that surface.
    pub site: Site,
    /// Places along the rims of that surface's triangles, the nearest to the texel first.
    pub rims: Vec<Rim>,
    /// Places right inside the corners of what surface lies in the texel itself.
    pub corners: Vec<Site>,
}

/// A place at the rim of a triangle, which may be the border of its chart.
#[derive(Clone, Copy, Debug)]
pub struct Rim {
    /// Point beside the rim, on the triangle.
    pub site: Site,
    /// Point as far beyond the rim, on the triangle's plane.
    pub across_m: Vec3,
    /// Place of that point in the block, were the triangle to go on.
    pub across: Vec2,
    /// The point on the triangle lies in the texel itself.
    pub is_inside: bool,
}

/// Squares of a block.
#[derive(Default)]
pub struct Found {
    /// Of receivers.
    pub own: Vec<(u32, Square)>,
    /// Of texels beside them.
    pub read: Vec<Reading>,
}

/// The triangle whose plane a texel lies on: the one with the largest piece there.
#[derive(Clone, Copy)]
struct Largest {
    area: f32,
    /// Index in the block, or `u32::MAX`.
    triangle: u32,
    middle: Vec2,
}

impl<'a> Faces<'a> {
    /// Those of a scene, in the order of blocks.
    pub fn all(world: &World, charts: &'a Charts) -> Vec<Self> {
        let of_block = |(instance, part, charts): (u32, usize, &'a UnwrapBlock)| {
            let sides = sides(&world.geometry.scene, instance as usize);
            let front = world.lightmap.first_block[instance as usize] + part as u32 * sides;
            (0..sides).map(move |side| Faces { instance, block: front + side, charts, is_back: side == 1 })
        };
        let instances = (0..).zip(&charts.unwraps);
        instances
            .flat_map(|(instance, unwrap)| {
                unwrap.blocks.iter().enumerate().map(move |(part, block)| (instance, part, block))
            })
            .flat_map(of_block)
            .collect()
    }

    fn reference(&self, triangle: &UnwrappedTriangle) -> TriangleRef {
        TriangleRef { instance: self.instance, triangle: triangle.source_triangle }
    }

    /// Normal of the side.
    fn normal(&self, geometry: &Geometry, triangle: &UnwrappedTriangle) -> Vec3 {
        let front = face_normal_of(&geometry.scene, self.reference(triangle));
        if self.is_back { -front } else { front }
    }

    fn square(&self, geometry: &Geometry, triangle: u32, texel: Texel) -> Option<Square> {
        let triangle = &self.charts.triangles[triangle as usize];
        let source = corners_of(&geometry.scene, self.reference(triangle));
        let corner = |weights: &Vec3| source[0] * weights.x + source[1] * weights.y + source[2] * weights.z;
        let corners_m =
            triangle.piece_corners.as_deref().map_or(source, |piece| piece.each_ref().map(corner));
        Square::of(corners_m, &triangle.uv_texels, texel)
    }
}

impl Found {
    /// Those of one side of the block's charts.
    pub fn of(world: &World, faces: Faces, progress: &Progress) -> Result<Self, Cancelled> {
        let Faces { block, charts, .. } = faces;
        let (geometry, size) = (world.geometry.as_ref(), [charts.width, charts.height]);
        let count = size[0] as usize * size[1] as usize;
        let mut largest = vec![Largest { area: 0.0, triangle: u32::MAX, middle: Vec2::ZERO }; count];
        let mut reader = vec![NO_CHART; count];
        let own = |[x, y]: Texel| world.receiver_on(block, x.into(), y.into());
        for (index, triangle) in charts.triangles.iter().enumerate() {
            progress.check()?;
            let corners = &triangle.uv_texels;
            let normal = faces.normal(geometry, triangle);
            let low = corners.iter().copied().fold(Vec2::INFINITY, Vec2::min) - READ_FROM;
            let high = corners.iter().copied().fold(Vec2::NEG_INFINITY, Vec2::max) + READ_FROM;
            for (place, texel, corner) in texels_of(&[low, high, low], size) {
                let receiver = own(texel).map(|receiver| &world.lightmap.receivers[receiver as usize]);
                let from = match receiver {
                    Some(receiver) if receiver.face_normal.dot(normal) < COPLANAR_COSINE_MIN => continue,
                    Some(_) => 0.0,
                    None => READ_FROM,
                };
                let polygon = clipped(corners, corner - from, corner + 1.0 + from);
                let Some((area, middle)) = area_and_middle(&polygon) else { continue };
                reader[place] = match reader[place] {
                    NO_CHART => triangle.chart,
                    other if other == triangle.chart => other,
                    _ => SEVERAL_CHARTS,
                };
                if area > largest[place].area {
                    largest[place] = Largest { area, triangle: index as u32, middle };
                }
            }
        }
        let mut found = Self::default();
        for (place, Largest { triangle, middle, .. }) in largest.into_iter().enumerate() {
            let texel = [(place % size[0] as usize) as u16, (place / size[0] as usize) as u16];
            if triangle == u32::MAX {
                continue;
            }
            let Some(square) = faces.square(geometry, triangle, texel) else { continue };
            if let Some(receiver) = own(texel) {
                found.own.push((receiver, square));
            } else if reader[place] != SEVERAL_CHARTS {
                let of = &charts.triangles[triangle as usize];
                let front = site_of(geometry, faces.reference(of), source_weights(of, middle));
                let site = if faces.is_back { front.turned() } else { front };
                let (rims, corners) = (Vec::new(), Vec::new());
                found.read.push(Reading { block, texel, square, site, rims, corners });
            }
        }
        found.add_rims(geometry, faces, progress)?;
        Ok(found)
    }

    /// Adds the rims of the triangles that are interpolated with texels without receivers.
    fn add_rims(&mut self, geometry: &Geometry, faces: Faces, progress: &Progress) -> Result<(), Cancelled> {
        let size = [faces.charts.width, faces.charts.height];
        let order = |[x, y]: Texel| (y, x);
        for triangle in &faces.charts.triangles {
            progress.check()?;
            let corners = &triangle.uv_texels;
            let low = corners.iter().copied().fold(Vec2::INFINITY, Vec2::min) - READ_FROM;
            let high = corners.iter().copied().fold(Vec2::NEG_INFINITY, Vec2::max) + READ_FROM;
            for (_, texel, corner) in texels_of(&[low, high, low], size) {
                let Ok(at) = self.read.binary_search_by_key(&order(texel), |read| order(read.texel)) else {
                    continue;
                };
                let Reading { square, site, rims, corners: places, .. } = &mut self.read[at];
                // A chart may hold specks that are folded over: what goes on beyond them faces the other side.
                if faces.normal(geometry, triangle).dot(site.face_normal) <= 0.0 {
                    continue;
                }
                let on_triangle = |at: Vec2| {
                    let weights = source_weights(triangle, at);
                    let front = site_of(geometry, faces.reference(triangle), weights);
                    if faces.is_back { front.turned() } else { front }
                };
                let room = RIMS_MAX - places.len();
                places.extend(
                    inside_corners(&clipped(corners, corner, corner + 1.0)).take(room).map(on_triangle),
                );
                let piece = clipped(corners, corner - READ_FROM, corner + 1.0 + READ_FROM);
                for [inside, across] in beside_rims(&piece, corners) {
                    let site = on_triangle(inside);
                    let step = across - inside;
                    let across_m = site.position_m + square.right_m * step.x + square.up_m * step.y;
                    let is_inside = inside.cmpge(corner).all() && inside.cmple(corner + 1.0).all();
                    rims.push(Rim { site, across_m, across, is_inside });
                }
            }
        }
        for Reading { square, rims, .. } in &mut self.read {
            let away_m = |rim: &Rim| rim.site.position_m.distance_squared(square.middle_m);
            rims.sort_by(|a, b| away_m(a).total_cmp(&away_m(b)));
            rims.truncate(RIMS_MAX);
        }
        Ok(())
    }
}

/// Points right inside the corners of a piece.
fn inside_corners(piece: &[Vec2]) -> impl Iterator<Item = Vec2> + '_ {
    let middle = area_and_middle(piece).map(|(_, middle)| middle);
    let inwards = move |at: &Vec2| Some(*at + (middle? - at).clamp_length_max(FROM_RIM));
    piece.iter().filter_map(inwards)
}

/// Of each side of a piece of a triangle that lies on the triangle's rim the point beside its middle, and the one beyond it.
fn beside_rims(piece: &[Vec2], corners: &[Vec2; 3]) -> Vec<[Vec2; 2]> {
    let Some((_, middle)) = area_and_middle(piece) else { return Vec::new() };
    let next = piece.iter().cycle().skip(1);
    let sides = piece.iter().zip(next).map(|(from, to)| from.midpoint(*to));
    let is_on_rim = |at: &Vec2| {
        (0..3).any(|side| {
            let (from, along) = (corners[side], corners[(side + 1) % 3] - corners[side]);
            along.perp_dot(*at - from).abs() <= ON_RIM * along.length()
        })
    };
    let points = |at: Vec2| {
        let inwards = (middle - at).clamp_length_max(FROM_RIM);
        [at + inwards, at - inwards]
    };
    sides.filter(is_on_rim).map(points).collect()
}

/// Squares of receivers by place.
pub struct Squares {
    /// That of each receiver, if its face has an area.
    pub of_receiver: Vec<Option<Square>>,
    /// Cell of each square's middle among those of texels as long, and its receiver; ascending.
    by_cell: Vec<(Cell, u32)>,
}

/// Bits of the length of a texel, and a cell of a lattice that suits it.
type Cell = (u32, [i32; 3]);

impl Squares {
    /// Of the receivers of a world.
    pub fn new<'a>(world: &World, own: impl Iterator<Item = &'a (u32, Square)>) -> Self {
        let lightmap = &world.lightmap;
        let mut squares = Self { of_receiver: vec![None; lightmap.receivers.len()], by_cell: Vec::new() };
        for &(receiver, square) in own {
            squares.of_receiver[receiver as usize] = Some(square);
            squares.by_cell.push((cell_at(square.middle_m, lightmap.texel_m_of(receiver)), receiver));
        }
        squares.by_cell.par_sort_unstable();
        squares
    }

    /// Receivers of a square of a block whose points gather as the given ones do, ascending.
    pub fn receivers(
        &self,
        world: &World,
        block: u32,
        square: &Square,
        normals @ [_, face_normal]: [Vec3; 2],
    ) -> Vec<u32> {
        let texel_m = world.lightmap.blocks[block as usize].texel_m;
        let tolerance_m = TOLERANCE * texel_m;
        let [(size, low), (_, high)] =
            [-tolerance_m, tolerance_m].map(|step_m| cell_at(square.middle_m + Vec3::splat(step_m), texel_m));
        let mut found = Vec::new();
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                // Cells along z follow each other.
                let first = self.by_cell.partition_point(|(cell, _)| *cell < (size, [x, y, low[2]]));
                let last = (size, [x, y, high[2]]);
                let cells = self.by_cell[first..].iter().take_while(|(cell, _)| *cell <= last);
                found.extend(cells.map(|(_, receiver)| *receiver).filter(|&receiver| {
                    let other = &world.lightmap.receivers[receiver as usize];
                    let is_same = |of: Square| {
                        let above_m = (of.middle_m - square.middle_m).dot(face_normal);
                        of.coincides(square, tolerance_m)
                            && above_m.abs() <= level_m(world, block, square.middle_m)
                    };
                    self.of_receiver[receiver as usize].is_some_and(is_same)
                        && gather_alike([other.normal, other.face_normal], normals)
                }));
            }
        }
        found.sort_unstable();
        found
    }
}

/// Points with these normals, of shading and of the face, gather the same light.
pub fn gather_alike(one: [Vec3; 2], other: [Vec3; 2]) -> bool {
    (0..2).all(|of| one[of].dot(other[of]) >= COPLANAR_COSINE_MIN)
}

/// Distance from a plane, in metres, of what lies on it about a point of a block.
pub fn level_m(world: &World, block: u32, at_m: Vec3) -> f32 {
    LEVEL * world.lightmap.blocks[block as usize].texel_m + world.geometry.tracer.ray_offset_m(at_m)
}

fn cell_at(at_m: Vec3, texel_m: f32) -> Cell {
    (texel_m.to_bits(), cell_of(at_m, texel_m * CELL).to_array())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use lightkiln_proto::settings::{PlaceSettings, Preset, SettingsGroup};

    use super::*;
    use crate::lightmap::place::place;
    use crate::lightmap::polygon::is_inside;
    use crate::scene::model::{Material, MeshInstance, Scene};
    use crate::unwrap::{UnwrapSettings, unwrap_generated};

    /// A triangle on the plane x + z = 1 whose lightmap lies at `offset` from the lattice's.
    fn square_by(corners: [Vec2; 3], offset: Vec2, texel: Texel) -> Option<Square> {
        let at = |p: &Vec2| Vec3::new(1.0 - 0.1 * p.x, 0.1 * p.y, 0.1 * p.x);
        Square::of(corners.each_ref().map(at), &corners.map(|corner| corner + offset), texel)
    }

    #[test]
    fn squares_of_one_plane_are_the_same_by_any_triangle_and_in_any_block() {
        let wide = [Vec2::new(1.2, 1.1), Vec2::new(7.9, 2.0), Vec2::new(3.0, 6.5)];
        let sliver = [Vec2::new(4.0, 0.0), Vec2::new(4.02, 5.0), Vec2::new(4.01, 9.0)];
        let first = square_by(wide, Vec2::ZERO, [3, 2]).unwrap();
        assert!(first.middle_m.distance(Vec3::new(0.65, 0.25, 0.35)) < 1e-6, "{first:?}");
        let other = square_by(sliver, Vec2::new(8.0, 4.0), [11, 6]).unwrap();
        assert!(first.coincides(&other, 1e-4), "{first:?} and {other:?}");
        assert_eq!(first.mirrored(&other), [false; 2]);
        for mirrored @ [x, y] in [[true, false], [false, true], [true; 2]] {
            let along = |axis_m: Vec3, is_mirrored: bool| if is_mirrored { -axis_m } else { axis_m };
            let image = Square { right_m: along(other.right_m, x), up_m: along(other.up_m, y), ..other };
            assert!(first.coincides(&image, 1e-4) && first.mirrored(&image) == mirrored, "{image:?}");
        }
        let [beside, between] = [Vec2::new(9.0, 4.0), Vec2::new(8.1, 4.0)];
        for offset in [beside, between] {
            assert!(!first.coincides(&square_by(sliver, offset, [11, 6]).unwrap(), TOLERANCE * 0.1));
        }
        assert_eq!(square_by([Vec2::ONE; 3], Vec2::ZERO, [1, 1]), None);
    }

    #[test]
    fn rims_of_a_piece_are_those_of_its_triangle_with_points_on_both_sides() {
        let corners = [Vec2::new(1.0, 1.0), Vec2::new(1.01, 1.0), Vec2::new(1.0, 9.0)];
        let piece = clipped(&corners, Vec2::new(0.5, 1.5), Vec2::new(1.5, 2.5));
        let found = beside_rims(&piece, &corners);
        assert_eq!(found.len(), 2, "the ends of the piece are no rims: {found:?}");
        for [inside, across] in found {
            assert!(is_inside(&corners, inside) && !is_inside(&corners, across), "{inside} {across}");
            assert!((across.y - 2.0).abs() < 0.6 && inside.distance(across) <= 2.0 * FROM_RIM);
        }
    }
    /// A plate with a hole, and at the hole's rim a sliver of the plate that is folded over, as modellers leave them: in the plate's chart, nearly on
    /// its plane, and turned away from it. Light from beyond the sliver's rim is that of the plate's other side.
    #[test]
    fn rims_of_a_surface_face_the_side_that_it_does() {
        const TEXEL_M: f32 = 0.25;
        let at = |[x, z]: [f32; 2]| Vec3::new(x, 0.0, z) * TEXEL_M;
        let square = |[low_x, low_z]: [f32; 2], [high_x, high_z]: [f32; 2]| {
            [[low_x, low_z], [low_x, high_z], [high_x, high_z], [high_x, low_z]].map(at)
        };
        let hole = square([0.669, 0.446], [2.589, 2.366]);
        let mut plate = square([0.42, 0.197], [2.838, 2.615]).to_vec();
        plate.extend(hole);
        plate.extend([[2.589, 1.146], [2.619, 0.8]].map(at));
        // A fold right back to back with the plate has a chart of its own.
        plate[9].y = 0.02 * TEXEL_M;
        let around = (0..4).flat_map(|i| [[i, (i + 1) % 4, 4 + (i + 1) % 4], [i, 4 + (i + 1) % 4, 4 + i]]);
        // The hole's side of larger x runs from corner 7 to corner 6; the sliver lies along the first part of it.
        let whole = around.filter(|corners| *corners != [2, 7, 6]);
        let triangles: Vec<[u32; 3]> = whole.chain([[2, 7, 8], [2, 8, 6], [8, 7, 9]]).collect();
        assert_eq!(triangles.len(), 10);
        let sheet = Material { double_sided: true, ..Material::opaque("sheet", [0.5; 3]) };
        let plate = MeshInstance {
            path: "plate".into(),
            normals: vec![Vec3::Y; plate.len()],
            positions_m: plate,
            triangles,
            ..MeshInstance::default()
        };
        let scene = Scene { instances: vec![plate], materials: vec![sheet], ..Scene::default() };
        let (geometry, progress) = (Arc::new(Geometry::new(scene).unwrap()), Progress::new());
        let unwrap = |instance: &MeshInstance| {
            let MeshInstance { positions_m, normals, triangles, .. } = instance;
            let unwrap = UnwrapSettings::with_texel_m(TEXEL_M);
            unwrap_generated(positions_m, normals, triangles, &unwrap, &progress).unwrap()
        };
        let charts =
            Charts { texel_m: TEXEL_M, unwraps: geometry.scene.instances.iter().map(unwrap).collect() };
        let settings = PlaceSettings::read(&Default::default(), Preset::Draft).unwrap();
        let (lightmap, _) = place(&geometry, &charts, &settings, &progress).unwrap();
        let world = World::new(geometry, &charts, lightmap, &progress);
        for face in Faces::all(&world, &charts) {
            let found = Found::of(&world, face, &progress).unwrap();
            let rims =
                || found.read.iter().flat_map(|read| read.rims.iter().map(|rim| (read.site, rim.site)));
            assert!(rims().count() > 20);
            assert!(rims().all(|(site, rim)| rim.face_normal.dot(site.face_normal) > 0.9));
        }
        let is_folded = |triangle: &UnwrappedTriangle| triangle.source_triangle == 9;
        let [block] = &charts.unwraps[0].blocks[..] else { panic!("several blocks") };
        assert_eq!(block.triangles.iter().find(|t| is_folded(t)).unwrap().chart, block.triangles[0].chart);
    }
}
