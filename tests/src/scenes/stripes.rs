//! Walls and floors of several coplanar meshes.

use glam::{Vec2, Vec3};

use super::glb::{Glb, MaterialId, Surface};
use super::mesh::Mesh;
use super::shapes::{self, Side};

const PLASTER: [f32; 3] = [0.7, 0.69, 0.66];
/// Corners of the rooms.
const MIN: Vec3 = Vec3::new(-2.0, 0.0, -2.0);
const MAX: Vec3 = Vec3::new(2.0, 2.5, 2.0);

/// Borders between the meshes of [`striped_wall`] at the floor, x in metres: between stripes of 3, 10 and 25 cm.
pub const STRIPE_BORDERS_M: [f32; 10] =
    [-0.573, -0.543, -0.443, -0.193, -0.163, -0.063, 0.187, 0.217, 0.317, 0.567];
/// Borders between the meshes of [`parted_floor`], x in metres: a wall stands on the second.
pub const FLOOR_BORDERS_M: [f32; 3] = [-0.87, 0.04, 0.93];
/// Border between the panels of [`bent_panel`], x in metres.
pub const PANELS_BORDER_M: f32 = 0.03;
/// Border of the first two meshes of [`hollow_at_a_border`]: a line of a lattice of 1/8 m.
pub const CREST_M: f32 = 0.25;
/// Width of the strip that is free there.
pub const STRIP_M: f32 = 0.006;
/// Where the sheet of [`floor_through_a_wall`] stands, x in metres.
pub const BORDER_SHEET_M: f32 = 0.25;
/// Where the sheet of [`panel_through_a_wall`] stands, x in metres.
pub const PARTING_M: f32 = 0.085;

/// A closed room of 4 × 2.5 × 4 m with a lamp close to its back wall, at z = −2 m. That wall is of meshes with these albedos
/// in turn, each with a material of its own, or one mesh where there are none; their borders reach `lean_m` farther right
/// at the ceiling than at the floor.
pub fn striped_wall(albedos: &[[f32; 3]], lean_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("striped_wall");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let lamp = glb.material(Surface::diffuse("lamp", [0.78; 3]).emitting([30.0; 3]));
    glb.object("walls", &shapes::room(MIN, MAX, &[Side::Back]), plaster);
    let corner = Vec3::new(-0.25, 0.5, -1.4);
    glb.object("lamp", &shapes::cuboid(corner, corner + Vec3::splat(0.2), &[]), lamp);
    let borders = if albedos.is_empty() { &[][..] } else { &STRIPE_BORDERS_M[..] };
    let materials: Vec<MaterialId> = (0..=borders.len())
        .map(|index| {
            let albedo = albedos.get(index % albedos.len().max(1)).copied().unwrap_or(PLASTER);
            glb.material(Surface::diffuse(&format!("stripe {index}"), albedo))
        })
        .collect();
    let at = |x_m: f32, y_m: f32| Vec3::new(x_m, y_m, MIN.z);
    let of_border = |&x_m: &f32| [at(x_m, MIN.y), at(x_m + lean_m, MAX.y)];
    let ends = [MIN.x, MAX.x].map(|x_m| [at(x_m, MIN.y), at(x_m, MAX.y)]);
    strips(&mut glb, "stripe", ends, borders.iter().map(of_border), &materials);
    glb.finish()
}

/// A closed room of 4 × 2.5 × 4 m with a lamp and two panels in front of its back wall, side by side in the plane z = −1.8 m:
/// their border is at x = [`PANELS_BORDER_M`], and two thirds of the right one bend away, so that it has a lattice of its own.
pub fn bent_panel() -> Vec<u8> {
    let mut glb = Glb::new("bent_panel");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let lamp = glb.material(Surface::diffuse("lamp", [0.78; 3]).emitting([30.0; 3]));
    glb.object("room", &shapes::room(MIN, MAX, &[]), plaster);
    let corner = Vec3::new(-0.25, 0.5, -1.2);
    glb.object("lamp", &shapes::cuboid(corner, corner + Vec3::splat(0.2), &[]), lamp);
    let at = |x_m: f32, z_m: f32| [Vec3::new(x_m, 0.0, z_m), Vec3::new(x_m, 2.0, z_m)];
    let panel = |lines: &[[Vec3; 2]]| {
        let mut panel = Mesh::default();
        for pair in lines.windows(2) {
            let [[a, d], [b, c]] = [pair[0], pair[1]];
            panel.face([a, b, c, d], [Vec2::ZERO; 4]);
        }
        panel
    };
    let border = at(PANELS_BORDER_M, -1.8);
    glb.object("flat panel", &panel(&[at(-1.0, -1.8), border]), plaster);
    glb.object("bent panel", &panel(&[border, at(0.45, -1.8), at(0.87, -1.69), at(1.26, -1.49)]), plaster);
    glb.finish()
}

/// A closed room of 4 × 2.5 × 4 m without a lamp whose floor is of four meshes, side by side along x, and a wall of 2 cm
/// from floor to ceiling over the border in their middle.
pub fn parted_floor() -> Vec<u8> {
    let mut glb = Glb::new("parted_floor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let stone = glb.material(Surface::diffuse("stone", [0.5, 0.45, 0.38]));
    glb.object("walls", &shapes::room(MIN, MAX, &[Side::Bottom]), plaster);
    let across = |x_m: f32| [Vec3::new(x_m, MIN.y, MAX.z), Vec3::new(x_m, MIN.y, MIN.z)];
    let borders = FLOOR_BORDERS_M.into_iter().map(across);
    strips(&mut glb, "plank", [across(MIN.x), across(MAX.x)], borders, &[stone, plaster, stone, plaster]);
    let [_, middle_m, _] = FLOOR_BORDERS_M;
    let half = Vec3::new(0.01, 0.0, 0.0);
    let (low, high) = (Vec3::new(middle_m, -0.05, -2.01), Vec3::new(middle_m, 2.55, 2.01));
    glb.object("wall", &shapes::cuboid(low - half, high + half, &[]), plaster);
    glb.finish()
}

/// A closed room of 4 × 2.5 × 4 m with a lamp whose floor is of three meshes, with borders at [`CREST_M`] and 6 cm farther right;
/// the middle one falls by `drop_m`. On the left one stands a box of sheets, without a bottom, whose side leaves
/// [`STRIP_M`] of it free at the border.
pub fn hollow_at_a_border(drop_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("hollow_at_a_border");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let stone = glb.material(Surface::diffuse("stone", [0.5, 0.45, 0.38]));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let lamp = glb.material(Surface::diffuse("lamp", [0.78; 3]).emitting([30.0; 3]));
    glb.object("walls", &shapes::room(MIN, MAX, &[Side::Bottom]), plaster);
    let corner = Vec3::new(0.9, 1.2, -0.1);
    glb.object("lamp", &shapes::cuboid(corner, corner + Vec3::splat(0.2), &[]), lamp);
    let line = |x_m: f32, y_m: f32| [Vec3::new(x_m, y_m, MAX.z), Vec3::new(x_m, y_m, MIN.z)];
    let borders = [line(CREST_M, 0.0), line(CREST_M + 0.06, -drop_m)];
    let ends = [line(MIN.x, 0.0), line(MAX.x, -drop_m)];
    strips(&mut glb, "plank", ends, borders.into_iter(), &[stone, plaster, stone]);
    let (low, high) = (Vec3::new(-0.9, 0.0, -0.6), Vec3::new(CREST_M - STRIP_M, 0.8, 0.6));
    glb.object("box", &shapes::cuboid(low, high, &[Side::Bottom]), sheet);
    glb.finish()
}

/// A room of 4 × 2.5 × 4 m with a lamp in its right part; a sheet at x = [`PARTING_M`] keeps the left one dark. A panel stands 3 mm
/// before the back wall, at z = −2 m, and its end reaches 8 mm into the dark: texels of 1/8 m there have their middles beyond.
pub fn panel_through_a_wall() -> Vec<u8> {
    let mut glb = Glb::new("panel_through_a_wall");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let lamp = glb.material(Surface::diffuse("lamp", [0.78; 3]).emitting([30.0; 3]));
    glb.object("room", &shapes::room(MIN, MAX, &[]), plaster);
    let corner = Vec3::new(0.9, 1.2, -0.1);
    glb.object("lamp", &shapes::cuboid(corner, corner + Vec3::splat(0.2), &[]), lamp);
    let at = |x_m: f32, y_m: f32| Vec3::new(x_m, y_m, MIN.z + 0.003);
    let [left_m, right_m] = [PARTING_M - 0.008, 1.2];
    let mut panel = Mesh::default();
    panel.face([at(left_m, 0.0), at(right_m, 0.0), at(right_m, 2.0), at(left_m, 2.0)], [Vec2::ZERO; 4]);
    glb.object("panel", &panel, plaster);
    glb.object("parting", &sheet_across(PARTING_M), sheet);
    glb.finish()
}

/// A room of 4 × 2.5 × 4 m with a lamp in its right part; a sheet at x = [`BORDER_SHEET_M`], a line of a lattice of 1/8 m, keeps the left one
/// dark. The floor of the dark part goes on for 2 mm beyond the sheet, where that of the lit one begins.
pub fn floor_through_a_wall() -> Vec<u8> {
    let mut glb = Glb::new("floor_through_a_wall");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let stone = glb.material(Surface::diffuse("stone", [0.5, 0.45, 0.38]));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let lamp = glb.material(Surface::diffuse("lamp", [0.78; 3]).emitting([30.0; 3]));
    glb.object("walls", &shapes::room(MIN, MAX, &[Side::Bottom]), plaster);
    let corner = Vec3::new(1.2, 1.2, -0.1);
    glb.object("lamp", &shapes::cuboid(corner, corner + Vec3::splat(0.2), &[]), lamp);
    let across = |x_m: f32| [Vec3::new(x_m, MIN.y, MAX.z), Vec3::new(x_m, MIN.y, MIN.z)];
    let border = across(BORDER_SHEET_M + 0.002);
    strips(&mut glb, "plank", [across(MIN.x), across(MAX.x)], [border].into_iter(), &[stone, plaster]);
    glb.object("parting", &sheet_across(BORDER_SHEET_M), sheet);
    glb.finish()
}

/// A sheet across the whole room, which it reaches through.
fn sheet_across(x_m: f32) -> Mesh {
    let at = |y_m: f32, z_m: f32| Vec3::new(x_m, y_m, z_m);
    let (near_m, far_m, top_m) = (MAX.z + 0.1, MIN.z - 0.1, MAX.y + 0.1);
    let mut sheet = Mesh::default();
    sheet.face([at(-0.1, near_m), at(-0.1, far_m), at(top_m, far_m), at(top_m, near_m)], [Vec2::ZERO; 4]);
    sheet
}

/// Meshes between lines that each have a foot and a top, from left to right; neighbours share corners to the bit.
fn strips(
    glb: &mut Glb,
    name: &str,
    [left, right]: [[Vec3; 2]; 2],
    borders: impl Iterator<Item = [Vec3; 2]>,
    materials: &[MaterialId],
) {
    let lines: Vec<[Vec3; 2]> = [left].into_iter().chain(borders).chain([right]).collect();
    for (index, (lines, material)) in lines.windows(2).zip(materials).enumerate() {
        let [[a, d], [b, c]] = [lines[0], lines[1]];
        let mut strip = Mesh::default();
        strip.face([a, b, c, d], [Vec2::ZERO; 4]);
        glb.object(&format!("{name} {index}"), &strip, *material);
    }
}
