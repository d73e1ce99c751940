//! Scenes for what happens where meshes touch each other.

use glam::Vec3;

use super::glb::{Glb, Surface};
use super::mesh::Mesh;
use super::shapes::{self, Side};

const PLASTER: [f32; 3] = [0.7, 0.69, 0.66];
/// How far the box and the column are turned, so that no edge lies on the texel lattice.
const YAW_RAD: f32 = 0.35;

/// Half the width of the box of [`box_on_floor`].
pub const BOX_HALF_M: f32 = 0.6;
/// Height of the plate of [`hollow_pier_on_plate`].
pub const PLATE_TOP_M: f32 = 0.25;
/// Distance of the lamp of [`lamp_close_to_a_ceiling`] from the ceiling.
pub const LAMP_GAP_M: f32 = 0.005;
/// Middle of the box there: its far sides see no lamp.
pub const BOX_BESIDE_LAMP_M: Vec3 = Vec3::new(0.93, 0.0, 0.91);
/// Half its width: its rim ends no texel of a decimal size.
pub const LAMP_HALF_M: f32 = 0.504;
/// Heights of the strip of the board's edge that is seen under the clamp of [`clamp_on_board`].
pub const UNDER_CLAMP_M: [f32; 2] = [0.041, 0.0517];
/// The clamp's ends along that edge.
pub const CLAMP_ALONG_M: [f32; 2] = [-0.0853, 0.0346];
/// See [`round_column`].
pub const ROUND_COLUMN_M: f32 = 0.35;
/// Half the width of [`column()`].
pub const COLUMN_HALF_M: f32 = 0.11;

/// A floor under the open sky and nothing else.
pub fn lone_floor(half_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("lone_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    glb.object("floor", &floor(half_m), plaster);
    glb.finish()
}

/// A closed box of 1.2 m on a floor of 5 × 5 m under the open sky, its underside at the height `bottom_m`: at 0 it lies
/// in the floor, below that the box is sunk through it.
///
/// The floor runs through under the box.
pub fn box_on_floor(bottom_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("box_on_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let red = glb.material(Surface::diffuse("red", [0.65, 0.2, 0.15]));
    glb.object("floor", &floor(2.5), plaster);
    let half = Vec3::new(BOX_HALF_M, 0.0, BOX_HALF_M);
    let block = shapes::cuboid(-half, half + Vec3::Y * (2.0 * BOX_HALF_M), &[]);
    glb.object("box", &block.turned(YAW_RAD).translated(Vec3::Y * bottom_m), red);
    glb.finish()
}

/// A square slab along the axes, of so half a width, on a floor of 5 × 5 m under the open sky.
pub fn slab_on_floor(half_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("slab_on_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    glb.object("floor", &floor(2.5), plaster);
    let half = Vec3::new(half_m, 0.0, half_m);
    glb.object("slab", &shapes::cuboid(-half, half + Vec3::Y * 0.02, &[]), plaster);
    glb.finish()
}

/// A square slab along the axes, of so half a width, that hovers 2 cm above a floor of 5 × 5 m under the open sky, as on feet.
pub fn slab_above_floor(half_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("slab_above_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    glb.object("floor", &floor(2.5), plaster);
    let half = Vec3::new(half_m, 0.0, half_m);
    glb.object("slab", &shapes::cuboid(-half + Vec3::Y * 0.02, half + Vec3::Y * 0.05, &[]), plaster);
    glb.finish()
}

/// Two dark boards 2 cm high on a floor of 5 × 5 m under the open sky, with a strip of the floor between them, of that reach along x.
pub fn strip_between_boards(strip_m: [f32; 2]) -> Vec<u8> {
    let mut glb = Glb::new("strip_between_boards");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let dark = glb.material(Surface::diffuse("dark", [0.1; 3]));
    glb.object("floor", &floor(2.5), plaster);
    for (name, [from_m, to_m]) in [("left", [-1.0, strip_m[0]]), ("right", [strip_m[1], 1.0])] {
        let (low, high) = (Vec3::new(from_m, 0.0, -1.0), Vec3::new(to_m, 0.02, 1.0));
        glb.object(name, &shapes::cuboid(low, high, &[Side::Bottom]), dark);
    }
    glb.finish()
}

/// On a floor under the open sky a square plate of half a width `plate_half_m`, its top at [`PLATE_TOP_M`], and on that a
/// pier of half a width `pier_half_m` that is hollow: four walls without thickness and a cap, no bottom.
pub fn hollow_pier_on_plate(plate_half_m: f32, pier_half_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("hollow_pier_on_plate");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    glb.object("floor", &floor(2.5), plaster);
    let standing = |half_m: f32, low_m: f32, high_m: f32| {
        let half = Vec3::new(half_m, 0.0, half_m);
        shapes::cuboid(-half + Vec3::Y * low_m, half + Vec3::Y * high_m, &[Side::Bottom])
    };
    glb.object("plate", &standing(plate_half_m, 0.0, PLATE_TOP_M), plaster);
    glb.object("pier", &standing(pier_half_m, PLATE_TOP_M, PLATE_TOP_M + 0.8), sheet);
    glb.finish()
}

/// A box of 1.2 m on a floor of 5 × 5 m under the open sky, turned about its middle, of sheets without thickness and
/// without a bottom: the floor runs through under it.
pub fn hollow_box_on_floor(yaw_rad: f32) -> Vec<u8> {
    let mut glb = Glb::new("hollow_box_on_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    glb.object("floor", &floor(2.5), plaster);
    let half = Vec3::new(BOX_HALF_M, 0.0, BOX_HALF_M);
    let hollow = shapes::cuboid(-half, half + Vec3::Y * (2.0 * BOX_HALF_M), &[Side::Bottom]);
    glb.object("box", &hollow.turned(yaw_rad), sheet);
    glb.finish()
}

/// A closed room of half a width `half_m` and a height of 2 m, turned about its middle, of sheets that face it; floor and ceiling
/// reach `beyond_m` beyond its walls, as those of a room do that was measured.
pub fn room_of_sheets(half_m: f32, beyond_m: f32, yaw_rad: f32) -> Vec<u8> {
    let mut glb = Glb::new("room_of_sheets");
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let corners = |half_m: f32| [Vec3::new(-half_m, 0.0, -half_m), Vec3::new(half_m, 2.0, half_m)];
    let [low, high] = corners(half_m);
    glb.object("walls", &shapes::room(low, high, &[Side::Bottom, Side::Top]).turned(yaw_rad), sheet);
    let [low, high] = corners(half_m + beyond_m);
    for (name, side) in [("floor", Side::Bottom), ("ceiling", Side::Top)] {
        glb.object(name, &shapes::room_side(low, high, side).turned(yaw_rad), sheet);
    }
    glb.finish()
}

/// A board of 3 × 80 × 160 cm under the open sky, its front edge in the plane x = 0, and in that edge a clamp of sheets: it
/// stands out by 2.4 mm, and leaves [`UNDER_CLAMP_M`] of the edge in sight. Texels of 1/16 m have their
/// middles there behind it, and a single triangle, as the edge's diagonal passes above them.
pub fn clamp_on_board() -> Vec<u8> {
    let mut glb = Glb::new("clamp_on_board");
    let wood = glb.material(Surface::diffuse("wood", PLASTER).double_sided());
    let metal = glb.material(Surface::diffuse("metal", PLASTER).double_sided());
    let board = [Vec3::new(0.0, UNDER_CLAMP_M[0], -1.24), Vec3::new(0.8, 0.071, 0.36)];
    glb.object("board", &shapes::cuboid(board[0], board[1], &[]), wood);
    let [low, high] = [UNDER_CLAMP_M[1], 0.0722];
    let [near, far] = CLAMP_ALONG_M;
    let clamp = shapes::cuboid(Vec3::new(-0.0024, low, near), Vec3::new(0.0583, high, far), &[]);
    glb.object("clamp", &clamp, metal);
    glb.finish()
}

/// A closed room of 3 × 2.5 × 3 m with a lamp that shines to both sides, [`LAMP_GAP_M`] below the ceiling and so far from
/// the room's middle to each side as [`LAMP_HALF_M`], and a box without a bottom on its floor, half as wide as
/// [`BOX_HALF_M`] and turned by `yaw_rad`, at [`BOX_BESIDE_LAMP_M`].
pub fn lamp_close_to_a_ceiling(yaw_rad: f32) -> Vec<u8> {
    let mut glb = Glb::new("lamp_close_to_a_ceiling");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let lamp = glb.material(Surface::diffuse("lamp", [0.78; 3]).emitting([17.0; 3]).double_sided());
    let (min, max) = (Vec3::new(-1.5, 0.0, -1.5), Vec3::new(1.5, 2.5, 1.5));
    glb.object("room", &shapes::room(min, max, &[]), plaster);
    let half = Vec3::new(LAMP_HALF_M, 0.0, LAMP_HALF_M);
    let height = Vec3::Y * (max.y - LAMP_GAP_M);
    glb.object("lamp", &shapes::room_side(height - half, height + half, Side::Top), lamp);
    let half = Vec3::new(0.5 * BOX_HALF_M, 0.0, 0.5 * BOX_HALF_M);
    let hollow = shapes::cuboid(-half, half + Vec3::Y * BOX_HALF_M, &[Side::Bottom]);
    glb.object("box", &hollow.turned(yaw_rad).translated(BOX_BESIDE_LAMP_M), sheet);
    glb.finish()
}

/// A closed room of 4 × 2.5 × 4 m whose floor is `tiles × tiles` coplanar meshes; the edges of the inner ones lie on
/// no line of the texel lattice. Every second one may be `turned`: double-sided, and seen from its back.
pub fn tiled_floor(tiles: u32, turned: bool) -> Vec<u8> {
    let mut glb = Glb::new("tiled_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let surface = Surface::diffuse("stone", [0.5, 0.45, 0.38]);
    let stone = glb.material(surface.clone());
    let sheet = glb.material(surface.double_sided());
    let (min, max) = (Vec3::new(-2.0, 0.0, -2.0), Vec3::new(2.0, 2.5, 2.0));
    glb.object("walls", &shapes::room(min, max, &[Side::Bottom]), plaster);
    let edge_m = |index: u32| 4.0 * index as f32 / tiles as f32 - 2.0;
    for j in 0..tiles {
        for i in 0..tiles {
            let (low, high) =
                (Vec3::new(edge_m(i), 0.0, edge_m(j)), Vec3::new(edge_m(i + 1), 0.0, edge_m(j + 1)));
            let mut tile = Mesh::default();
            let (a, b) = (Vec3::new(low.x, 0.0, high.z), Vec3::new(high.x, 0.0, low.z));
            // Corners as they are, not as sums: neighbours must share them to the bit.
            let (corners, material) = match turned && (i + j) % 2 == 1 {
                true => ([low, b, high, a], sheet),
                false => ([a, high, b, low], stone),
            };
            tile.face(corners, [glam::Vec2::ZERO; 4]);
            glb.object(&format!("tile {i} {j}"), &tile, material);
        }
    }
    glb.finish()
}

/// A closed room of 5 × 2.5 × 5 m with a round column of the radius [`ROUND_COLUMN_M`] in the middle: 24 faces, shaded as one.
pub fn round_column() -> Vec<u8> {
    const SIDES: u32 = 24;
    let mut glb = Glb::new("round_column");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let (min, max) = (Vec3::new(-2.5, 0.0, -2.5), Vec3::new(2.5, 2.5, 2.5));
    glb.object("room", &shapes::room(min, max, &[]), plaster);
    let mut column = Mesh::default();
    column.grid(SIDES, 1, |side, row| {
        let angle_rad = -std::f32::consts::TAU * (side % SIDES) as f32 / SIDES as f32;
        let normal = Vec3::new(libm::cosf(angle_rad), 0.0, libm::sinf(angle_rad));
        (normal * ROUND_COLUMN_M + Vec3::Y * (2.6 * row as f32 - 0.05), normal, glam::Vec2::ZERO)
    });
    glb.object("column", &column, plaster);
    glb.finish()
}

/// A closed room of 5 × 2.5 × 5 m with a thin column in the middle, from below the floor to above the ceiling.
pub fn column() -> Vec<u8> {
    let mut glb = Glb::new("column");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let (min, max) = (Vec3::new(-2.5, 0.0, -2.5), Vec3::new(2.5, 2.5, 2.5));
    glb.object("room", &shapes::room(min, max, &[]), plaster);
    let low = Vec3::new(-COLUMN_HALF_M, -0.05, -COLUMN_HALF_M);
    let high = Vec3::new(COLUMN_HALF_M, 2.55, COLUMN_HALF_M);
    glb.object("column", &shapes::cuboid(low, high, &[]).turned(YAW_RAD), plaster);
    glb.finish()
}

fn floor(half_m: f32) -> Mesh {
    let mut floor = Mesh::default();
    floor.rectangle(Vec3::new(-half_m, 0.0, half_m), Vec3::X * (2.0 * half_m), Vec3::Z * (-2.0 * half_m));
    floor
}

/// Horizontal distance of a point from the turned square of [`box_on_floor`] or [`column()`] around the origin; below 0
/// inside.
pub fn outside_m(position_m: Vec3, half_m: f32) -> f32 {
    outside_turned_m(position_m, half_m, YAW_RAD)
}

/// As [`outside_m`], of a square that is turned by `yaw_rad`.
pub fn outside_turned_m(position_m: Vec3, half_m: f32, yaw_rad: f32) -> f32 {
    let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
    let local = [cos * position_m.x - sin * position_m.z, cos * position_m.z + sin * position_m.x];
    let [x, z] = local.map(|axis| axis.abs() - half_m);
    if x > 0.0 && z > 0.0 { libm::sqrtf(x * x + z * z) } else { x.max(z) }
}
