//! Furnishing of the atrium: cloths, fountain, trees, doors.

use core::f32::consts::PI;

use glam::Vec3;

use super::super::cloth;
use super::super::glb::{Glb, MeshId};
use super::super::lathe::{self, lathe};
use super::super::mesh::Mesh;
use super::super::shapes::{self, Side};
use super::Palette;
use super::plan::{self, *};

pub(super) fn build(glb: &mut Glb, palette: &Palette) {
    banners(glb, palette);
    curtains(glb, palette);
    fountain(glb, palette);
    trees(glb, palette);
    doors(glb, palette);
}

/// Bays with a banner over the balustrade, and the cloth of each.
const BANNERS: [(&str, usize); 8] = [
    ("north 2", 0),
    ("north 4", 1),
    ("north 6", 3),
    ("south 1", 2),
    ("south 3", 0),
    ("south 5", 1),
    ("west 2", 3),
    ("east 2", 2),
];

/// Lower bays with a pair of drawn curtains, and the cloth of each.
const CURTAINS: [(&str, usize); 8] = [
    ("north 1", 2),
    ("north 3", 3),
    ("north 5", 0),
    ("south 2", 1),
    ("south 4", 3),
    ("south 6", 0),
    ("west 1", 1),
    ("west 3", 0),
];

fn banners(glb: &mut Glb, palette: &Palette) {
    // (z, y) from the upper floor at the column axis: over the rail, clear of the string course, down.
    let path = [
        (-0.22, 0.72),
        (-0.16, 1.01),
        (0.18, 1.01),
        (0.30, 0.72),
        (0.45, 0.42),
        (0.62, 0.12),
        (0.66, -0.20),
        (0.65, -0.50),
        (0.64, -0.80),
        (0.63, -1.10),
        (0.62, -1.40),
        (0.62, -1.70),
        (0.62, -2.00),
        (0.62, -2.30),
    ];
    let banner = cloth::draped_banner(&path, 1.5, 4.0, 0.06);
    let meshes = cloth_meshes(glb, palette, "banner", &banner);
    for (name, cloth) in BANNERS {
        let bay = bay(name);
        glb.place(&format!("banner {name}"), meshes[cloth], bay.at(Vec3::Y * UPPER_FLOOR_M), bay.yaw_rad);
    }
}

fn curtains(glb: &mut Glb, palette: &Palette) {
    let (half_m, rod_m) = (1.2, LOWER_SPRING_M - 0.1);
    let curtain = cloth::gathered_curtain(1.12, rod_m - LOWER_FLOOR_M - 0.06, 3.0, 0.05);
    let meshes = cloth_meshes(glb, palette, "curtain", &curtain);
    let rod = shapes::cuboid(
        Vec3::new(-half_m - 0.1, -0.02, -0.02),
        Vec3::new(half_m + 0.1, 0.02, 0.02),
        &[Side::Left, Side::Right],
    );
    let rod = glb.mesh("curtain rod", &[(&rod, palette.wood)]);
    for (name, cloth) in CURTAINS {
        let bay = bay(name);
        let at = |x: f32, y: f32| bay.at(Vec3::new(x, y, 0.0));
        glb.place(&format!("curtain rod {name}"), rod, at(0.0, rod_m), bay.yaw_rad);
        let (left, right) = (at(-half_m, rod_m - 0.03), at(half_m, rod_m - 0.03));
        glb.place(&format!("left curtain {name}"), meshes[cloth], left, bay.yaw_rad);
        glb.place(&format!("right curtain {name}"), meshes[cloth], right, bay.yaw_rad + PI);
    }
}

/// The same shape in every cloth.
fn cloth_meshes(glb: &mut Glb, palette: &Palette, name: &str, shape: &Mesh) -> [MeshId; 4] {
    let colours = ["crimson", "blue", "green", "saffron"];
    std::array::from_fn(|i| glb.mesh(&format!("{} {name}", colours[i]), &[(shape, palette.cloths[i])]))
}

fn bay(name: &str) -> Spot {
    plan::bays().into_iter().find(|bay| bay.name == name).expect("a bay of the plan")
}

fn fountain(glb: &mut Glb, palette: &Palette) {
    let wall = [(1.42, 0.0), (1.42, 0.10)];
    let ledge = [(1.42, 0.10), (1.32, 0.12)];
    let outside = [(1.32, 0.12), (1.27, 0.30), (1.32, 0.46)];
    let rim = lathe::torus_run(1.32, 0.10, 0.46, 0.58, 5);
    let top = [(1.32, 0.58), (1.14, 0.58)];
    let inside = [(1.14, 0.58), (1.14, 0.38)];
    let mut stone = lathe(&[&wall, &ledge, &outside, &rim, &top, &inside], 32);
    let stem = [(0.30, 0.38), (0.26, 0.52), (0.13, 0.66), (0.11, 0.95), (0.16, 1.06)];
    let bowl = [(0.16, 1.06), (0.34, 1.10), (0.56, 1.22), (0.62, 1.32)];
    let lip = [(0.62, 1.32), (0.60, 1.34), (0.56, 1.31)];
    let bowl_inside = [(0.56, 1.31), (0.53, 1.26)];
    let finial = [(0.10, 1.24), (0.08, 1.36), (0.13, 1.46), (0.11, 1.56), (0.03, 1.64), (0.0, 1.70)];
    stone.append(&lathe(&[&stem, &bowl, &lip, &bowl_inside, &finial], 24));
    let mut water = lathe(&[&[(1.15, 0.46), (0.0, 0.46)]], 32);
    water.append(&lathe(&[&[(0.55, 1.28), (0.0, 1.28)]], 24));
    let mesh = glb.mesh("fountain", &[(&stone, palette.stone), (&water, palette.water)]);
    glb.place("fountain", mesh, Vec3::ZERO, 0.0);
}

fn trees(glb: &mut Glb, palette: &Palette) {
    let outside = [(0.20, 0.0), (0.22, 0.06), (0.27, 0.34), (0.30, 0.46)];
    let rim = lathe::torus_run(0.30, 0.04, 0.46, 0.54, 4);
    let inside = [(0.30, 0.54), (0.27, 0.54), (0.26, 0.44)];
    let pot = lathe(&[&outside, &rim, &inside], 20);
    let mut trunk = lathe(&[&[(0.27, 0.48), (0.0, 0.48)]], 20);
    trunk.append(&lathe(&[&[(0.045, 0.47), (0.035, 1.0), (0.03, 1.45)]], 8));
    let crown = lathe::crown(0.48, 0.09, 18, 11).translated(Vec3::Y * 1.72);
    let parts = [(&pot, palette.terracotta), (&trunk, palette.wood), (&crown, palette.leaves)];
    let tree = glb.mesh("tree", &parts);
    for (name, x, z) in [
        ("tree north-west", -4.5, -3.3),
        ("tree north-east", 4.5, -3.3),
        ("tree south-west", -4.5, 3.3),
        ("tree south-east", 4.5, 3.3),
    ] {
        glb.place(name, tree, Vec3::new(x, 0.0, z), 0.7 * x);
    }
}

/// Panelled doors in stone surrounds, on the outer walls of both storeys.
fn doors(glb: &mut Glb, palette: &Palette) {
    let block = |low: [f32; 3], high: [f32; 3], omitted: &[Side]| {
        shapes::cuboid(Vec3::from(low), Vec3::from(high), omitted)
    };
    let on_floor = [Side::Back, Side::Bottom];
    let mut surround = block([-0.92, 0.0, 0.0], [-0.70, 2.52, 0.10], &on_floor);
    surround.append(&block([0.70, 0.0, 0.0], [0.92, 2.52, 0.10], &on_floor));
    surround.append(&block([-0.98, 2.50, 0.0], [0.98, 2.74, 0.14], &[Side::Back]));
    let mut leaf =
        block([-0.70, 0.0, 0.0], [0.70, 2.50, 0.04], &[Side::Back, Side::Bottom, Side::Left, Side::Right]);
    for x in [-0.58, 0.06] {
        for (bottom, top) in [(0.18, 0.95), (1.1, 2.3)] {
            leaf.append(&block([x, bottom, 0.03], [x + 0.52, top, 0.07], &[Side::Back]));
        }
    }
    let door = glb.mesh("door", &[(&surround, palette.stone), (&leaf, palette.wood)]);
    for name in ["north 2", "north 5", "south 2", "south 5", "west 2", "east 2"] {
        let bay = bay(name);
        for (storey, floor_m) in [("door", LOWER_FLOOR_M), ("upper door", UPPER_FLOOR_M)] {
            glb.place(
                &format!("{storey} {name}"),
                door,
                bay.at(Vec3::new(0.0, floor_m, -BAY_M)),
                bay.yaw_rad,
            );
        }
    }
}
