//! A flat that is edited: rooms whose furniture, colours and lamps change from bake to bake.

use glam::Vec3;

use super::glb::{Glb, Lamp, Surface};
use super::mesh::Mesh;
use super::shapes::{self, Side};
use super::texture;

/// How deep walls reach into what they meet, so that no light passes along their edges.
const REACH_M: f32 = 0.01;
/// Half the length of the flat, along x.
pub const FLAT_HALF_M: f32 = 5.0;
/// Distance of the walls between its rooms from its middle.
pub const FLAT_WALL_M: f32 = 1.5;

/// A box that stands in the flat.
#[derive(Clone, Debug, PartialEq)]
pub struct Thing {
    /// Its name, which is its identity.
    pub name: String,
    /// Middle of its bottom.
    pub at_m: Vec3,
    /// Size.
    pub size_m: Vec3,
    /// Turn about the y axis.
    pub yaw_rad: f32,
    /// Index of its colour.
    pub colour: usize,
}

/// All that can be changed.
#[derive(Clone, Debug, PartialEq)]
pub struct Flat {
    /// Furniture, in the order of the file.
    pub things: Vec<Thing>,
    /// Colours of things; the last is the walls'.
    pub colours: Vec<[f32; 3]>,
    /// Radiance of the lamps in the first room and in the last.
    pub lamps: [[f32; 3]; 2],
    /// Stripes of the floor.
    pub stripes: u32,
    /// Share of light that the pane in the first room stops.
    pub pane: f32,
    /// Place of the point light in the hall.
    pub light_m: Vec3,
}

impl Default for Flat {
    fn default() -> Self {
        let thing = |name: &str, at_m: [f32; 3], size_m: [f32; 3], colour| Thing {
            name: name.into(),
            at_m: at_m.into(),
            size_m: size_m.into(),
            yaw_rad: 0.3,
            colour,
        };
        Self {
            things: vec![
                thing("chair", [-3.2, 0.0, 0.4], [0.5, 0.9, 0.5], 0),
                thing("table", [-4.0, 0.0, -1.0], [0.8, 0.7, 1.2], 1),
                thing("chest", [3.6, 0.0, 1.1], [0.9, 0.8, 0.5], 1),
                thing("lamp stand", [3.0, 0.0, -1.0], [0.3, 1.4, 0.3], 0),
            ],
            colours: vec![[0.6, 0.2, 0.1], [0.4, 0.5, 0.2], [0.7, 0.69, 0.66]],
            lamps: [[9.0, 8.0, 6.0], [4.0, 5.0, 7.0]],
            stripes: 4,
            pane: 0.4,
            light_m: Vec3::new(-0.8, 1.8, 0.0),
        }
    }
}

/// A flat of three rooms in a row, 2.4 m high and 4 m wide: the walls between them have doorways, but a screen in the middle one
/// hides the first room from the last, whose far end is open to the sky.
pub fn flat(of: &Flat) -> Vec<u8> {
    let mut glb = Glb::new("flat");
    let wall = of.colours.len() - 1;
    let colours: Vec<_> = (0..)
        .zip(&of.colours)
        .map(|(index, colour)| {
            glb.material(Surface::diffuse(&format!("colour {index}"), *colour).double_sided())
        })
        .collect();
    let [first, last] = [("first lamp", of.lamps[0]), ("last lamp", of.lamps[1])]
        .map(|(name, radiance)| glb.material(Surface::diffuse(name, [0.5; 3]).emitting(radiance)));
    let stripes =
        glb.texture("stripes", &texture::striped_cloth(32, [200, 190, 170], [90, 60, 50], of.stripes, true));
    let floor = glb.material(Surface::diffuse("floor", [0.8; 3]).textured(stripes));
    let glass = glb.material(Surface::diffuse("glass", [0.9; 3]).blended(of.pane));

    let (min, max) = (Vec3::new(-FLAT_HALF_M, 0.0, -2.0), Vec3::new(FLAT_HALF_M, 2.4, 2.0));
    glb.object("shell", &shapes::room(min, max, &[Side::Right, Side::Bottom]), colours[wall]);
    let ground = shapes::room_side(min, max, Side::Bottom);
    glb.object("floor", &ground, floor);
    let slab = |x_m: f32, z_m: [f32; 2]| {
        let low = Vec3::new(x_m - 0.05, -REACH_M, z_m[0]);
        shapes::cuboid(low, Vec3::new(x_m + 0.05, 2.4 + REACH_M, z_m[1]), &[])
    };
    let beyond_m = 2.0 + REACH_M;
    for (name, x_m) in [("near wall", -FLAT_WALL_M), ("far wall", FLAT_WALL_M)] {
        glb.object(name, &slab(x_m, [-1.1, beyond_m]), colours[wall]);
    }
    glb.object("screen", &slab(0.0, [-beyond_m, 1.0]), colours[wall]);
    let plate = |x_m: f32| {
        let mut mesh = Mesh::default();
        mesh.rectangle(Vec3::new(x_m - 0.3, 2.3, -0.3), Vec3::X * 0.6, Vec3::Z * 0.6);
        mesh
    };
    glb.object("first lamp", &plate(-3.4), first);
    glb.object("last lamp", &plate(3.4), last);
    let mut pane = Mesh::default();
    pane.rectangle(Vec3::new(-2.4, 0.0, -1.0), Vec3::Z * 1.5, Vec3::Y * 1.8);
    glb.object("pane", &pane, glass);
    for thing in &of.things {
        let mesh = shapes::standing_box(thing.at_m, thing.size_m, thing.yaw_rad);
        glb.object(&thing.name, &mesh, colours[thing.colour]);
    }
    glb.light("lamp", Lamp::Point, [20.0; 3], of.light_m, Vec3::ZERO);
    glb.camera("view", Vec3::new(-4.6, 1.6, 1.6), Vec3::new(-2.0, 0.9, -1.0), 1.2);
    glb.finish()
}
