//! A closet with a door, and a room that can be mirrored.

use glam::Vec3;

use super::glb::{Glb, Surface};
use super::shapes;

const PLASTER: [f32; 3] = [0.7, 0.69, 0.66];
/// How deep walls and door reach into what they meet, so that no light passes along their edges.
const REACH_M: f32 = 0.01;

/// A closet of 1.2 × 2.4 × 1.6 m at −x beside a room of 2.8 × 2.4 × 3.2 m at +x. The wall at x = 0 is 8 cm thick; its
/// doorway, 0.8 m wide from floor to ceiling, holds a door of 4 cm that is turned open by `ajar_rad` into the room.
///
/// At 0 the door reaches into the wall on both sides and no light passes.
pub fn closet(ajar_rad: f32) -> Vec<u8> {
    let mut glb = Glb::new("closet");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let wood = glb.material(Surface::diffuse("wood", [0.5, 0.32, 0.18]));
    let height_m = 2.4;
    let (min, max) = (Vec3::new(-1.2, 0.0, -1.6), Vec3::new(2.8, height_m, 1.6));
    glb.object("shell", &shapes::room(min, max, &[]), plaster);
    let slab = |low: [f32; 2], high: [f32; 2]| {
        let low = Vec3::new(low[0], -REACH_M, low[1]);
        shapes::cuboid(low, Vec3::new(high[0], height_m + REACH_M, high[1]), &[])
    };
    let reach_m = 1.6 + REACH_M;
    glb.object("wall right", &slab([-0.04, -reach_m], [0.04, -0.4]), plaster);
    glb.object("wall left", &slab([-0.04, 0.4], [0.04, reach_m]), plaster);
    // Of the width of the room up to here, the closet has the middle.
    let beyond_m = -1.2 - REACH_M;
    glb.object("side right", &slab([beyond_m, -0.84], [-0.03, -0.8]), plaster);
    glb.object("side left", &slab([beyond_m, 0.8], [-0.03, 0.84]), plaster);
    let width_m = 0.8 + 2.0 * REACH_M;
    let door = slab([-0.02, 0.0], [0.02, width_m]).turned(ajar_rad);
    glb.object("door", &door.translated(Vec3::new(0.0, 0.0, -0.4 - REACH_M)), wood);
    glb.finish()
}

/// A room without any symmetry of its own, all of whose nodes are scaled by `signs` (±1 along each axis).
pub fn mirrored_room(signs: Vec3) -> Vec<u8> {
    let mut glb = Glb::new("mirrored_room");
    let plaster = glb.material(Surface::diffuse("plaster", PLASTER));
    let red = glb.material(Surface::diffuse("red", [0.65, 0.12, 0.1]));
    let green = glb.material(Surface::diffuse("green", [0.15, 0.5, 0.12]));
    let sheet = glb.material(Surface::diffuse("sheet", [0.3, 0.3, 0.7]).double_sided());
    let (min, max) = (Vec3::new(-2.0, 0.0, -1.5), Vec3::new(2.0, 2.5, 1.5));
    let sides = shapes::Side::ALL;
    for (side, name) in sides.into_iter().zip(["left", "right", "floor", "ceiling", "back", "front"]) {
        let material = if name == "left" { red } else { plaster };
        glb.object_scaled(name, &shapes::room_side(min, max, side), material, signs);
    }
    let block = shapes::standing_box(Vec3::new(0.9, 0.0, -0.5), Vec3::new(0.7, 1.1, 0.5), 0.4);
    glb.object_scaled("box", &block, green, signs);
    let screen = shapes::box_side(Vec3::new(-1.0, 0.5, -0.4), Vec3::new(-0.9, 1.6, 0.6), shapes::Side::Right);
    glb.object_scaled("screen", &screen, sheet, signs);
    glb.finish()
}
