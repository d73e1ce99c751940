//! Scenes of every scale, and of several at once.

use glam::Vec3;

use super::glb::{Glb, Lamp, MaterialId, Surface};
use super::mesh::Mesh;
use super::shapes::{self, Side};

const PLASTER: [f32; 3] = [0.8, 0.8, 0.78];

/// A file with the materials of these scenes.
fn begun(name: &str) -> (Glb, MaterialId, MaterialId) {
    let mut glb = Glb::new(name);
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER).double_sided());
    let red = glb.material(Surface::diffuse("red", [0.65, 0.2, 0.15]));
    (glb, plaster, red)
}

/// A room that is open in front, with a box in it, `side_m` long, wide and high.
fn furnished(glb: &mut Glb, (plaster, red): (MaterialId, MaterialId), side_m: f32) {
    let half = Vec3::new(0.5 * side_m, 0.0, 0.5 * side_m);
    let walls = shapes::room(-half, half + Vec3::Y * side_m, &[Side::Front]);
    glb.object("room", &walls, plaster);
    let half = 0.125 * side_m * Vec3::new(1.0, 0.0, 1.0);
    glb.object("box", &shapes::cuboid(-half, half + Vec3::Y * (0.25 * side_m), &[Side::Bottom]), red);
}

/// A room that is open in front, with a box in it, of any size.
pub fn room(side_m: f32) -> Vec<u8> {
    let (mut glb, plaster, red) = begun("room");
    furnished(&mut glb, (plaster, red), side_m);
    glb.finish()
}

/// A room of 4 m on a plain that reaches `half_m` to each side, of two triangles.
pub fn room_on_a_plain(half_m: f32) -> Vec<u8> {
    let (mut glb, plaster, red) = begun("room_on_a_plain");
    furnished(&mut glb, (plaster, red), 4.0);
    let corner = Vec3::new(-half_m, -0.01, half_m);
    let mut plain = Mesh::default();
    plain.rectangle(corner, Vec3::X * (2.0 * half_m), -Vec3::Z * (2.0 * half_m));
    glb.object("plain", &plain, red);
    glb.finish()
}

/// A room of 4 m, and one triangle of a square metre far off.
pub fn room_and_a_far_triangle(away_m: f32) -> Vec<u8> {
    let (mut glb, plaster, red) = begun("room_and_a_far_triangle");
    furnished(&mut glb, (plaster, red), 4.0);
    let mut far = Mesh::default();
    far.rectangle(Vec3::X * away_m, Vec3::Y, Vec3::Z);
    far.triangles.truncate(1);
    glb.object("far", &far, plaster);
    glb.finish()
}

/// A triangle under a sun, and nothing else.
pub fn lone_triangle() -> Vec<u8> {
    let (mut glb, plaster, _) = begun("lone_triangle");
    let mut triangle = Mesh::default();
    triangle.rectangle(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, -Vec3::Z);
    triangle.triangles.truncate(1);
    glb.object("triangle", &triangle, plaster);
    glb.light("sun", Lamp::Sun, [3.0; 3], Vec3::Y, Vec3::ZERO);
    glb.camera("above", Vec3::new(0.2, 1.5, 0.6), Vec3::new(0.2, 0.0, 0.2), 0.9);
    glb.finish()
}

/// Boxes of a metre on a grid, instances of one mesh, or all of them in one place.
pub fn boxes(count: u32, in_one_place: bool) -> Vec<u8> {
    let (mut glb, _, red) = begun("boxes");
    let mesh = glb.mesh("box", &[(&shapes::cuboid(Vec3::ZERO, Vec3::ONE, &[]), red)]);
    let side = (count as f32).sqrt().ceil() as u32;
    for index in 0..count {
        let cell = if in_one_place { [0, 0] } else { [index % side, index / side] };
        let [x, z] = cell.map(|cell| 2.0 * cell as f32);
        glb.place(&format!("box {index}"), mesh, Vec3::new(x, 0.0, z), 0.0);
    }
    glb.finish()
}
