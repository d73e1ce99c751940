//! A hall open to the outside: sun through the open front and through a hole in the roof.

use glam::Vec3;

use super::glb::{Glb, Lamp, Surface};
use super::masonry;
use super::mesh::Mesh;
use super::shapes::{self, Side};

/// Inside height of the hall.
const HEIGHT_M: f32 = 6.0;

/// A hall of 24 × 14 × 6 m: three thick walls, an open front (+z) with a row of columns, two rows inside, and a roof
/// slab with an opening of 6 × 4 m. The ground goes on outside.
pub fn open_hall() -> Vec<u8> {
    let mut glb = Glb::new("open_hall");
    let plaster = glb.material(Surface::diffuse("plaster", [0.72, 0.68, 0.60]));
    let stone = glb.material(Surface::diffuse("stone", [0.62, 0.55, 0.45]));
    let floor = glb.material(Surface::diffuse("floor", [0.48, 0.40, 0.32]));
    let grass = glb.material(Surface::diffuse("grass", [0.12, 0.20, 0.06]));
    let red = glb.material(Surface::diffuse("red", [0.60, 0.10, 0.06]));
    let blue = glb.material(Surface::diffuse("blue", [0.08, 0.18, 0.50]));

    let (min, max) = (Vec3::new(-12.0, 0.0, -7.0), Vec3::new(12.0, 0.0, 7.0));
    let outside = Vec3::new(8.0, 0.0, 8.0);
    glb.object("ground", &shapes::floor_with_hole(min - outside, max + outside, min, max), grass);
    let mut paving = Mesh::default();
    paving.rectangle(Vec3::new(min.x, 0.0, max.z), Vec3::X * 24.0, Vec3::Z * -14.0);
    glb.object("floor", &paving, floor);

    // Walls reach 2 cm into the roof, so their tops need no face.
    let top = HEIGHT_M + 0.02;
    let ends = [Side::Bottom, Side::Top];
    for (name, low, high, material) in [
        ("back wall", Vec3::new(-12.0, 0.0, -7.0), Vec3::new(12.0, top, -6.5), plaster),
        ("left wall", Vec3::new(-12.0, 0.0, -6.51), Vec3::new(-11.5, top, 7.0), red),
        ("right wall", Vec3::new(11.5, 0.0, -6.51), Vec3::new(12.0, top, 7.0), blue),
    ] {
        glb.object(name, &shapes::cuboid(low, high, &ends), material);
    }
    let (low, high) = (Vec3::new(-12.6, HEIGHT_M, -7.6), Vec3::new(12.6, HEIGHT_M + 0.5, 7.6));
    let roof = shapes::frame(low, high, Vec3::new(-3.0, 0.0, -3.0), Vec3::new(3.0, 0.0, 1.0));
    glb.object("roof", &roof, plaster);

    let column = glb.mesh("column", &[(&masonry::column(top, 0.34, 24), stone)]);
    for (row, z) in [("back", -3.8), ("middle", 1.8), ("front", 6.4)] {
        for i in 0..6 {
            let x = 4.0 * i as f32 - 10.0;
            glb.place(&format!("{row} column {}", i + 1), column, Vec3::new(x, 0.0, z), 0.0);
        }
    }
    let bench =
        glb.mesh("bench", &[(&shapes::standing_box(Vec3::ZERO, Vec3::new(2.4, 0.45, 0.6), 0.0), stone)]);
    for (name, x, z, yaw_rad) in [("left bench", -8.0, -5.4, 0.0), ("right bench", 8.0, -5.4, 0.0)] {
        glb.place(name, bench, Vec3::new(x, 0.0, z), yaw_rad);
    }
    let block = shapes::standing_box(Vec3::new(0.0, 0.0, -1.0), Vec3::new(1.2, 1.1, 1.2), 0.4);
    glb.object("block", &block, plaster);

    glb.light("sun", Lamp::Sun, [9.0, 8.4, 7.4], Vec3::new(-5.0, 12.0, 9.0), Vec3::ZERO);
    glb.camera("inside", Vec3::new(9.8, 1.8, 4.6), Vec3::new(-6.0, 2.3, -4.0), 1.05);
    glb.camera("outside", Vec3::new(14.0, 5.0, 17.0), Vec3::new(0.0, 2.6, 0.0), 0.8);
    glb.finish()
}
