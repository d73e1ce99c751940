//! Scenes with glass whose right answer is known beforehand, or that the path tracer tells.

use glam::Vec3;

use super::glb::{Glb, Lamp, Surface};
use super::mesh::Mesh;
use super::shapes::{self, Side};

/// A cube of 4 m as [`super::furnace`], with panes in it that stop `alphas` of the light, all of one albedo and emission.
pub fn furnace_with_panes(albedo: f32, alphas: &[f32]) -> Vec<u8> {
    let mut glb = Glb::new("furnace_with_panes");
    let furnace = Surface::diffuse("furnace", [albedo; 3]).emitting([1.0; 3]);
    let wall = glb.material(furnace.clone());
    let (min, max) = (Vec3::new(-2.0, 0.0, -2.0), Vec3::new(2.0, 4.0, 2.0));
    glb.object("furnace", &shapes::room(min, max, &[]), wall);
    for (index, &alpha) in alphas.iter().enumerate() {
        let glass = glb.material(furnace.clone().blended(alpha));
        let mut pane = Mesh::default();
        pane.rectangle(Vec3::new(-1.2, 0.7, index as f32 - 1.1), Vec3::X * 2.4, Vec3::Y * 2.6);
        glb.object(&format!("pane {index}"), &pane, glass);
    }
    glb.finish()
}

/// A black box of 2 × 2 × 4 m whose end at −z shines; `glass`, if there is some, is a black pane across its middle.
pub fn lamp_behind_pane(glass: Option<Surface>) -> Vec<u8> {
    let mut glb = Glb::new("lamp_behind_pane");
    let black = glb.material(Surface::diffuse("black", [0.0; 3]));
    let lamp = glb.material(Surface::diffuse("lamp", [0.0; 3]).emitting([5.0; 3]));
    let (min, max) = (Vec3::new(-1.0, 0.0, -2.0), Vec3::new(1.0, 2.0, 2.0));
    glb.object("walls", &shapes::room(min, max, &[Side::Back]), black);
    glb.object("lamp", &shapes::room_side(min, max, Side::Back), lamp);
    if let Some(surface) = glass {
        let glass = glb.material(surface);
        let mut pane = Mesh::default();
        pane.rectangle(Vec3::new(-1.0, 0.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0);
        glb.object("pane", &pane, glass);
    }
    glb.finish()
}

/// Upper side of the roof of [`skylit_room`], and the corners of its opening, in metres.
const ROOF_TOP_M: f32 = 2.7;
const OPENING_M: [Vec3; 2] = [Vec3::new(-0.6, 0.0, -0.8), Vec3::new(0.6, 0.0, 0.8)];

/// A room of 3 × 2.5 × 4 m, shut but for a skylight of 1.2 × 1.6 m, on which lies a pane that stops `alpha` of the light; a
/// box stands on its floor. The sun is almost overhead.
pub fn skylit_room(alpha: f32) -> Vec<u8> {
    let mut glb = Glb::new("skylit_room");
    let plaster = glb.material(Surface::diffuse("plaster", [0.7, 0.69, 0.66]));
    let floor = glb.material(Surface::diffuse("floor", [0.6, 0.35, 0.2]));
    let glass = glb.material(Surface::diffuse("glass", [0.5, 0.6, 0.7]).blended(alpha));
    let (min, max) = (Vec3::new(-1.5, 0.0, -2.0), Vec3::new(1.5, 2.5, 2.0));
    glb.object("walls", &shapes::room(min, max, &[Side::Top, Side::Bottom]), plaster);
    glb.object("floor", &shapes::room_side(min, max, Side::Bottom), floor);
    // The roof reaches over the walls, whose upper edges lie in its lower side.
    let beyond = Vec3::new(0.2, 0.0, 0.2);
    let [hole_min, hole_max] = OPENING_M;
    let roof = shapes::frame(min.with_y(max.y) - beyond, max.with_y(ROOF_TOP_M) + beyond, hole_min, hole_max);
    glb.object("roof", &roof, plaster);
    // On the roof: in the opening it would leave strips of the reveal on either side, narrower than a texel.
    let rim = Vec3::new(0.1, 0.0, 0.1);
    let (low, high) = (hole_min - rim, hole_max + rim);
    let mut pane = Mesh::default();
    let corner = Vec3::new(low.x, ROOF_TOP_M + 0.002, high.z);
    pane.rectangle(corner, Vec3::X * (high.x - low.x), Vec3::Z * (low.z - high.z));
    glb.object("pane", &pane, glass);
    let block = shapes::standing_box(Vec3::new(0.8, 0.0, -1.1), Vec3::new(0.6, 0.9, 0.6), 0.4);
    glb.object("block", &block, plaster);
    glb.light("sun", Lamp::Sun, [20.0, 19.0, 17.0], Vec3::new(0.3, 1.0, 0.25), Vec3::ZERO);
    glb.camera("inside", Vec3::new(-1.2, 1.7, 1.8), Vec3::new(0.5, 0.9, -1.2), 1.2);
    glb.finish()
}

/// A gallery in daylight for pictures: four panes one behind the other before a striped wall, of shares from a clear pane to
/// an opaque one, on a floor in the sun.
pub fn panes() -> Vec<u8> {
    let mut glb = Glb::new("panes");
    let ground = glb.material(Surface::diffuse("ground", [0.55, 0.52, 0.48]));
    let light = glb.material(Surface::diffuse("light", [0.75; 3]));
    let dark = glb.material(Surface::diffuse("dark", [0.15, 0.2, 0.35]));
    let mut plain = Mesh::default();
    plain.rectangle(Vec3::new(-3.0, 0.0, 3.0), Vec3::X * 6.0, Vec3::Z * -6.0);
    glb.object("ground", &plain, ground);
    for stripe in 0..12_u8 {
        let mut mesh = Mesh::default();
        mesh.rectangle(Vec3::new(-3.0 + 0.5 * f32::from(stripe), 0.0, -2.0), Vec3::X * 0.5, Vec3::Y * 2.5);
        glb.object(&format!("stripe {stripe}"), &mesh, if stripe % 2 == 0 { light } else { dark });
    }
    for (index, (alpha, colour)) in
        [(0.1, [0.9, 0.9, 0.9]), (0.4, [0.8, 0.2, 0.1]), (0.7, [0.1, 0.5, 0.2]), (1.0, [0.9, 0.8, 0.3])]
            .into_iter()
            .enumerate()
    {
        let glass = glb.material(Surface::diffuse(&format!("glass {index}"), colour).blended(alpha));
        let mut pane = Mesh::default();
        let at = index as f32;
        pane.rectangle(Vec3::new(-2.2 + 0.9 * at, 0.0, 1.4 - 0.7 * at), Vec3::X * 1.5, Vec3::Y * 1.4);
        glb.object(&format!("pane {index}"), &pane, glass);
    }
    glb.light("sun", Lamp::Sun, [6.0, 5.6, 5.0], Vec3::new(2.0, 4.0, 3.0), Vec3::ZERO);
    glb.camera("before", Vec3::new(-1.5, 1.9, 4.2), Vec3::new(0.0, 0.6, -0.5), 0.8);
    glb.finish()
}
