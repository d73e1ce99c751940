//! Cornell boxes.
//!
//! Walls are single-sided and face inwards: their backs block light and return none. The front is open.

use glam::Vec3;

use super::glb::{Glb, Lamp, Surface};
use super::shapes::{self, Side};

/// Diffuse reflectances of the measured box, as linear Rec.709.
const WHITE: [f32; 3] = [0.725, 0.71, 0.68];
const RED: [f32; 3] = [0.63, 0.065, 0.05];
const GREEN: [f32; 3] = [0.14, 0.45, 0.091];

/// The classic box: 5.5 m, red wall on the left, green on the right, two boxes, and one warm ceiling panel that
/// lies flush in a hole of the ceiling.
pub fn cornell() -> Vec<u8> {
    classic("cornell", Parts::default())
}

/// The same with a floor that reflects, and a short box of rough metal.
pub fn cornell_glossy() -> Vec<u8> {
    classic("cornell_glossy", Parts { is_glossy: true, ..Parts::default() })
}

/// The same without the short box.
pub fn cornell_of_one_box() -> Vec<u8> {
    classic("cornell", Parts { has_short_box: false, ..Parts::default() })
}

struct Parts {
    has_short_box: bool,
    is_glossy: bool,
}

impl Default for Parts {
    fn default() -> Self {
        Self { has_short_box: true, is_glossy: false }
    }
}

fn classic(name: &str, Parts { has_short_box, is_glossy }: Parts) -> Vec<u8> {
    let mut glb = Glb::new(name);
    let white = glb.material(Surface::diffuse("white", WHITE));
    let red = glb.material(Surface::diffuse("red", RED));
    let green = glb.material(Surface::diffuse("green", GREEN));
    let panel = glb.material(Surface::diffuse("panel", [0.78; 3]).emitting([38.0, 30.0, 19.0]));

    let (min, max) = (Vec3::new(-2.75, 0.0, -5.5), Vec3::new(2.75, 5.5, 0.0));
    let (panel_min, panel_max) = (Vec3::new(-0.65, 5.5, -3.3), Vec3::new(0.65, 5.5, -2.25));
    let ceiling =
        shapes::floor_with_hole(Vec3::new(min.x, max.y, min.z), max, panel_min, panel_max).flipped();
    let (mut floor, mut metal) = (white, white);
    if is_glossy {
        floor = glb.material(Surface::diffuse("floor", WHITE).reflecting(0.0, 0.1));
        metal = glb.material(Surface::diffuse("metal", WHITE).reflecting(1.0, 0.3));
    }
    glb.object("floor", &shapes::room_side(min, max, Side::Bottom), floor);
    glb.object("ceiling", &ceiling, white);
    glb.object("back wall", &shapes::room_side(min, max, Side::Back), white);
    glb.object("left wall", &shapes::room_side(min, max, Side::Left), red);
    glb.object("right wall", &shapes::room_side(min, max, Side::Right), green);
    glb.object("ceiling panel", &shapes::room_side(panel_min, panel_max, Side::Top), panel);

    let short = shapes::standing_box(Vec3::ZERO, Vec3::new(1.65, 1.65, 1.65), 0.0);
    let short = glb.mesh("short box", &[(&short, metal)]);
    if has_short_box {
        glb.place("short box", short, Vec3::new(0.93, 0.0, -1.69), -0.29);
    }
    let tall = shapes::standing_box(Vec3::ZERO, Vec3::new(1.65, 3.3, 1.65), 0.0);
    let tall = glb.mesh("tall box", &[(&tall, white)]);
    glb.place("tall box", tall, Vec3::new(-0.94, 0.0, -3.51), 0.31);

    glb.camera("front", Vec3::new(0.0, 2.75, 7.85), Vec3::new(0.0, 2.75, 0.0), 0.70);
    glb.finish()
}

/// A hall of 20 × 10 × 10 m in the same manner, with boxes of several sizes and five lamps of which two are spots.
pub fn cornell_large() -> Vec<u8> {
    let mut glb = Glb::new("cornell_large");
    let white = glb.material(Surface::diffuse("white", WHITE));
    let red = glb.material(Surface::diffuse("red", RED));
    let green = glb.material(Surface::diffuse("green", GREEN));
    let blue = glb.material(Surface::diffuse("blue", [0.09, 0.19, 0.55]));
    let ochre = glb.material(Surface::diffuse("ochre", [0.62, 0.38, 0.10]));

    let (min, max) = (Vec3::new(-10.0, 0.0, -10.0), Vec3::new(10.0, 10.0, 0.0));
    for (name, side, material) in [
        ("floor", Side::Bottom, white),
        ("ceiling", Side::Top, white),
        ("back wall", Side::Back, white),
        ("left wall", Side::Left, red),
        ("right wall", Side::Right, green),
    ] {
        glb.object(name, &shapes::room_side(min, max, side), material);
    }
    for (name, x, z, size, yaw_rad, material) in [
        ("tall box", -5.2, -6.6, [2.8, 6.2, 2.8], 0.32, white),
        ("short box", -2.4, -2.9, [2.4, 2.4, 2.4], -0.28, white),
        ("blue slab", 1.0, -7.4, [4.2, 4.0, 1.2], 0.12, blue),
        ("ochre box", 3.4, -3.2, [2.0, 1.5, 2.0], 0.45, ochre),
        ("pillar", 6.6, -6.2, [1.8, 7.4, 1.8], -0.36, white),
        ("small box", -7.3, -2.2, [1.2, 1.2, 1.2], 0.2, white),
        ("stool", 7.6, -2.4, [1.4, 0.9, 1.4], -0.15, blue),
    ] {
        let mesh = glb.mesh(name, &[(&shapes::standing_box(Vec3::ZERO, Vec3::from(size), 0.0), material)]);
        glb.place(name, mesh, Vec3::new(x, 0.0, z), yaw_rad);
    }

    for (name, x, y, z, strength) in [
        ("left lamp", -7.4, 7.6, -4.2, [24.0, 20.0, 14.0]),
        ("middle lamp", 0.2, 8.4, -4.4, [28.0, 25.0, 21.0]),
        ("right lamp", 7.6, 5.0, -3.6, [14.0, 11.0, 7.0]),
    ] {
        glb.light(name, Lamp::Point, strength, Vec3::new(x, y, z), Vec3::ZERO);
    }
    let cone = Lamp::Spot { inner_rad: 0.30, outer_rad: 0.45 };
    let (eye, aim) = (Vec3::new(-1.0, 9.4, -1.2), Vec3::new(1.2, 3.0, -8.0));
    glb.light("slab spot", cone, [190.0, 180.0, 160.0], eye, aim);
    let (eye, aim) = (Vec3::new(3.5, 9.2, -1.0), Vec3::new(9.9, 2.4, -7.6));
    glb.light("green wall spot", cone, [170.0, 165.0, 150.0], eye, aim);

    glb.camera("front", Vec3::new(0.0, 5.0, 13.0), Vec3::new(0.0, 5.0, 0.0), 0.74);
    glb.finish()
}
