//! Scenes whose right answer is known beforehand: what METHOD's checks of a bake are run on.

use glam::Vec3;

use super::glb::{Glb, Lamp, Surface};
use super::mesh::Mesh;
use super::shapes::{self, Side};

const PLASTER: [f32; 3] = [0.7, 0.69, 0.66];
const WARM_LAMP: [f32; 3] = [3.0, 2.5, 1.8];

/// A closed cube of `size_m`, seen from inside, of one albedo and one emitted radiance: radiance everywhere inside
/// is `emission / (1 − albedo)`.
pub fn furnace(albedo: f32, emission: f32, size_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("furnace");
    let material = glb.material(Surface::diffuse("furnace", [albedo; 3]).emitting([emission; 3]));
    let half = 0.5 * size_m;
    let (min, max) = (Vec3::new(-half, 0.0, -half), Vec3::new(half, size_m, half));
    glb.object("furnace", &shapes::room(min, max, &[]), material);
    let eye = Vec3::new(0.8 * half, 0.6 * size_m, 0.8 * half);
    glb.camera("inside", eye, Vec3::new(-half, 0.4 * size_m, -half), 1.2);
    glb.finish()
}

/// A box of 4 m with walls of `thickness_m` in full sun, above a sunlit ground: inside, irradiance is exactly 0.
///
/// A second box inside gives receivers away from the walls. The sun is low enough to graze the top edges.
pub fn sealed_box(thickness_m: f32) -> Vec<u8> {
    let mut glb = Glb::new("sealed_box");
    let shell = glb.material(Surface::diffuse("shell", PLASTER));
    let ground = glb.material(Surface::diffuse("ground", [0.35, 0.33, 0.29]));
    let inner = glb.material(Surface::diffuse("inner", [0.6, 0.25, 0.2]));

    let (min, max) = (Vec3::new(-2.0, 0.25, -2.0), Vec3::new(2.0, 4.25, 2.0));
    glb.object("shell", &shapes::hollow_box(min, max, thickness_m), shell);
    let floor_m = Vec3::new(0.4, min.y + thickness_m, -0.3);
    glb.object("inner box", &shapes::standing_box(floor_m, Vec3::new(1.0, 1.4, 1.0), 0.4), inner);
    let mut plain = Mesh::default();
    plain.rectangle(Vec3::new(-8.0, 0.0, 8.0), Vec3::X * 16.0, Vec3::Z * -16.0);
    glb.object("ground", &plain, ground);

    glb.light("sun", Lamp::Sun, [4.0, 3.7, 3.2], Vec3::new(6.0, 9.0, 8.0), Vec3::ZERO);
    glb.camera("outside", Vec3::new(7.0, 4.5, 9.0), Vec3::new(0.0, 1.8, 0.0), 0.7);
    glb.camera("inside", Vec3::new(1.6, 3.2, 1.6), Vec3::new(-0.4, 1.4, -0.8), 1.2);
    glb.finish()
}

/// Thirty-six sealed boxes of 16 cm, hollow with walls of 2 cm, in rows above a ground in the open.
pub fn small_sealed_boxes() -> Vec<u8> {
    let mut glb = Glb::new("small_sealed_boxes");
    let shell = glb.material(Surface::diffuse("shell", PLASTER));
    let ground = glb.material(Surface::diffuse("ground", [0.35, 0.33, 0.29]));
    for index in 0..36_u8 {
        let min = Vec3::new(f32::from(index % 6), 0.0, f32::from(index / 6)) * 0.3 + Vec3::Y * 0.05;
        let mesh = shapes::hollow_box(min, min + Vec3::splat(0.16), 0.02);
        glb.object(&format!("box {index}"), &mesh, shell);
    }
    let mut plain = Mesh::default();
    plain.rectangle(Vec3::new(-0.4, 0.0, 2.1), Vec3::X * 2.5, Vec3::Z * -2.5);
    glb.object("ground", &plain, ground);
    glb.finish()
}

/// Twelve sealed boxes of 1 × 0.15 × 1 m of sheets without thickness, each turned otherwise, above a ground in the open.
pub fn flat_sealed_boxes() -> Vec<u8> {
    let mut glb = Glb::new("flat_sealed_boxes");
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let ground = glb.material(Surface::diffuse("ground", [0.35, 0.33, 0.29]));
    for index in 0..12_u8 {
        let half = Vec3::new(0.5, 0.075, 0.5);
        let place_m = Vec3::new(f32::from(index % 4), 0.0, f32::from(index / 4)) * 1.7 + Vec3::Y * 0.203;
        let mesh = shapes::cuboid(-half, half, &[]).turned(0.17 * f32::from(index)).translated(place_m);
        glb.object(&format!("box {index}"), &mesh, sheet);
    }
    let mut plain = Mesh::default();
    plain.rectangle(Vec3::new(-1.0, 0.0, 4.5), Vec3::X * 7.0, Vec3::Z * -5.5);
    glb.object("ground", &plain, ground);
    glb.finish()
}

/// Two rooms of 4 × 3 × 4 m under one roof with a lamp in the left one only: the right one receives exactly 0.
///
/// The wall between them is `thickness_m` thick, or a single double-sided sheet when that is 0. Floor, ceiling and
/// long walls run through under it, so one texel of theirs can lie in both rooms; the wall reaches 1 cm into them, so
/// no light passes along its edges.
pub fn two_rooms(thickness_m: f32) -> Vec<u8> {
    two_rooms_with_wall_at(thickness_m, 0.0)
}

/// As [`two_rooms`], with the middle of the wall at x = `wall_x_m`, e.g. where no line of the texel lattice is.
pub fn two_rooms_with_wall_at(thickness_m: f32, wall_x_m: f32) -> Vec<u8> {
    rooms(thickness_m, wall_x_m, true)
}

/// As [`two_rooms`], without a ceiling: both rooms see the sky, and nothing of each other.
pub fn two_rooms_under_the_sky(thickness_m: f32) -> Vec<u8> {
    rooms(thickness_m, 0.0, false)
}

fn rooms(thickness_m: f32, wall_x_m: f32, has_ceiling: bool) -> Vec<u8> {
    let mut glb = Glb::new(if thickness_m > 0.0 { "two_rooms" } else { "two_rooms_sheet" });
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let sheet = glb.material(Surface::diffuse("sheet", PLASTER).double_sided());
    let orange = glb.material(Surface::diffuse("orange", [0.65, 0.28, 0.08]));
    let teal = glb.material(Surface::diffuse("teal", [0.08, 0.42, 0.45]));
    let panel = glb.material(Surface::diffuse("panel", [0.78; 3]).emitting([4.0, 3.5, 2.8]));

    let half_wall = 0.5 * thickness_m;
    let (min, max) = (Vec3::new(-4.0 - half_wall, 0.0, -2.0), Vec3::new(4.0 + half_wall, 3.0, 2.0));
    for (name, side) in [
        ("floor", Side::Bottom),
        ("ceiling", Side::Top),
        ("left wall", Side::Left),
        ("right wall", Side::Right),
        ("back wall", Side::Back),
        ("front wall", Side::Front),
    ] {
        if has_ceiling || side != Side::Top {
            glb.object(name, &shapes::room_side(min, max, side), plaster);
        }
    }
    let reach = Vec3::new(0.0, 0.01, 0.01);
    let (wall_min, wall_max) =
        (Vec3::new(wall_x_m - half_wall, min.y, min.z), Vec3::new(wall_x_m + half_wall, max.y, max.z));
    if thickness_m > 0.0 {
        glb.object("partition", &shapes::cuboid(wall_min - reach, wall_max + reach, &[]), plaster);
    } else {
        let partition = shapes::box_side(wall_min - reach, wall_max + reach, Side::Right);
        glb.object("partition", &partition, sheet);
    }
    glb.object(
        "left box",
        &shapes::standing_box(Vec3::new(-1.1, 0.0, -0.7), Vec3::new(0.9, 1.2, 0.9), 0.3),
        orange,
    );
    glb.object(
        "right box",
        &shapes::standing_box(Vec3::new(1.1, 0.0, -0.7), Vec3::new(0.9, 1.2, 0.9), -0.3),
        teal,
    );

    let centre_m = Vec3::new(-2.2, max.y, 0.0);
    if has_ceiling {
        glb.object("ceiling panel", &ceiling_panel(centre_m, 0.7), panel);
    }
    glb.light("lamp", Lamp::Point, WARM_LAMP, Vec3::new(-2.2, 2.2, 0.4), Vec3::ZERO);
    glb.camera("left room", Vec3::new(-3.7, 1.9, 1.8), Vec3::new(-0.6, 1.1, -1.4), 1.1);
    glb.camera("right room", Vec3::new(3.7, 1.9, 1.8), Vec3::new(0.6, 1.1, -1.4), 1.1);
    glb.finish()
}

/// A corridor in the shape of a U, 2 m wide and 3 m high, closed at both ends, lit at the end of its left leg. Legs are
/// 8 m long and 4 m apart: light reaches the far end by four bounces or more.
pub fn u_corridor() -> Vec<u8> {
    let mut glb = Glb::new("u_corridor");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let floor = glb.material(Surface::diffuse("floor", [0.45, 0.38, 0.30]));
    let panel = glb.material(Surface::diffuse("panel", [0.78; 3]).emitting([7.0, 6.2, 5.0]));

    // (x, z) along each wall, the corridor on the right hand seen from above; a corner wherever floor pieces meet.
    for (name, corners) in [
        ("lit end wall", vec![(-4.0, 8.0), (-2.0, 8.0)]),
        ("left inner wall", vec![(-2.0, 8.0), (-2.0, 2.0)]),
        ("bridge inner wall", vec![(-2.0, 2.0), (2.0, 2.0)]),
        ("right inner wall", vec![(2.0, 2.0), (2.0, 8.0)]),
        ("far end wall", vec![(2.0, 8.0), (4.0, 8.0)]),
        ("right outer wall", vec![(4.0, 8.0), (4.0, 2.0), (4.0, 0.0)]),
        ("bridge outer wall", vec![(4.0, 0.0), (2.0, 0.0), (-2.0, 0.0), (-4.0, 0.0)]),
        ("left outer wall", vec![(-4.0, 0.0), (-4.0, 2.0), (-4.0, 8.0)]),
    ] {
        let mut wall = Mesh::default();
        for pair in corners.windows(2) {
            let [(x0, z0), (x1, z1)] = [pair[0], pair[1]];
            let back = Vec3::new(x0 - x1, 0.0, z0 - z1);
            wall.rectangle(Vec3::new(x1, 0.0, z1), back, Vec3::Y * 3.0);
        }
        glb.object(name, &wall, plaster);
    }
    // Cut so that parts meet at full edges.
    for (name, x, z, size_x, size_z) in [
        ("left leg", -4.0, 2.0, 2.0, 6.0),
        ("left corner", -4.0, 0.0, 2.0, 2.0),
        ("bridge", -2.0, 0.0, 4.0, 2.0),
        ("right corner", 2.0, 0.0, 2.0, 2.0),
        ("right leg", 2.0, 2.0, 2.0, 6.0),
    ] {
        let (min, max) = (Vec3::new(x, 0.0, z), Vec3::new(x + size_x, 3.0, z + size_z));
        glb.object(&format!("{name} floor"), &shapes::room_side(min, max, Side::Bottom), floor);
        glb.object(&format!("{name} ceiling"), &shapes::room_side(min, max, Side::Top), plaster);
    }

    glb.object("ceiling panel", &ceiling_panel(Vec3::new(-3.0, 3.0, 7.0), 1.0), panel);
    glb.light("lamp", Lamp::Point, WARM_LAMP.map(|s| 2.0 * s), Vec3::new(-3.0, 2.2, 7.2), Vec3::ZERO);
    glb.camera("lit leg", Vec3::new(-2.7, 1.7, 7.8), Vec3::new(-3.1, 1.5, 0.0), 1.1);
    glb.camera("bridge", Vec3::new(-3.7, 1.7, 0.3), Vec3::new(4.0, 1.4, 1.2), 1.1);
    glb.camera("dark leg", Vec3::new(3.7, 1.7, 7.7), Vec3::new(2.9, 1.4, 0.0), 1.1);
    glb.finish()
}

/// A lit square that hangs 4 cm below the ceiling as a closed tray, its top inside the ceiling.
fn ceiling_panel(centre_m: Vec3, width_m: f32) -> Mesh {
    let half = 0.5 * width_m;
    let drop_m = Vec3::Y * 0.04;
    let (min, max) = (Vec3::new(-half, 0.0, -half), Vec3::new(half, 0.0, half));
    shapes::cuboid(min - drop_m, max, &[Side::Top]).translated(centre_m)
}

/// A closed room of 3 × 2.5 × 3 m whose furniture has double-sided faces: a hollow bar along x, open at its
/// end at +x; a duct, open at its top; a board that lies a gap above the floor; and a closed chest.
pub fn hollow_furniture() -> Vec<u8> {
    let mut glb = Glb::new("hollow_furniture");
    let plaster = glb.material(Surface::diffuse("plaster", [0.7, 0.69, 0.66]));
    let white = glb.material(Surface::diffuse("white", [0.9; 3]).double_sided());
    let (min, max) = (Vec3::new(-1.5, 0.0, -1.5), Vec3::new(1.5, 2.5, 1.5));
    glb.object("room", &shapes::room(min, max, &[]), plaster);
    let mut hollow = |name: &str, [min, max]: [Vec3; 2], omitted: &[Side]| {
        glb.object(name, &shapes::cuboid(min, max, omitted), white);
    };
    hollow("bar", BAR_M, &[Side::Right]);
    hollow("duct", DUCT_M, &[Side::Top]);
    hollow("board", BOARD_M, &[]);
    hollow("chest", CHEST_M, &[]);
    glb.finish()
}

/// Corners of the stack of slats of [`shutter`].
pub const SLATS_M: [Vec3; 2] = [Vec3::new(-0.25, 0.5, -0.1875), Vec3::new(0.25, 0.7, 0.1875)];

/// Eight level slats of 50 × 37.5 cm, 4 mm thick and 2.4 cm apart, above the ground.
pub fn shutter() -> Vec<u8> {
    let mut glb = Glb::new("shutter");
    let ground = glb.material(Surface::diffuse("ground", [0.35, 0.33, 0.29]));
    let white = glb.material(Surface::diffuse("white", [0.75; 3]));
    let mut plain = Mesh::default();
    plain.rectangle(Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0);
    glb.object("ground", &plain, ground);
    let [min, max] = SLATS_M;
    for slat in 0..8 {
        let low = min.y + 0.028 * slat as f32;
        let (min, max) = (min.with_y(low), max.with_y(low + 0.004));
        glb.object(&format!("slat {slat}"), &shapes::cuboid(min, max, &[]), white);
    }
    glb.finish()
}

/// Corners of the bar of [`hollow_furniture`].
pub const BAR_M: [Vec3; 2] = [Vec3::new(-0.8, 1.5, -0.02), Vec3::new(0.8, 1.54, 0.02)];
/// Corners of its duct.
pub const DUCT_M: [Vec3; 2] = [Vec3::new(-1.2, 0.3, -1.2), Vec3::new(-0.8, 1.3, -0.8)];
/// Corners of its board.
pub const BOARD_M: [Vec3; 2] = [Vec3::new(0.2, 0.04, 0.2), Vec3::new(1.0, 0.06, 1.0)];
/// Corners of its chest.
pub const CHEST_M: [Vec3; 2] = [Vec3::new(0.5, 0.3, -1.2), Vec3::new(1.1, 0.9, -0.6)];
