//! Objects that move through other scenes. Each stands on y = 0 about the origin, and is closed.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::glb::{Glb, Surface};
use super::mesh::Mesh;
use super::shapes;

/// Names of [`mover`].
pub const MOVERS: [&str; 4] = ["box", "ball", "table", "panel"];

/// An object of that name: a red box of 1.2 m, a blue ball of 1.2 m, a white table 1.5 m wide, a green panel like a door.
pub fn mover(name: &str) -> Option<Vec<u8>> {
    let (mesh, albedo) = match name {
        "box" => (cuboid(Vec3::new(0.0, 0.6, 0.0), Vec3::splat(1.2)), [0.7, 0.12, 0.08]),
        "ball" => (ball(0.6), [0.1, 0.15, 0.7]),
        "table" => (table(), [0.7, 0.7, 0.65]),
        "panel" => (cuboid(Vec3::new(0.0, 1.1, 0.0), Vec3::new(1.2, 2.2, 0.06)), [0.15, 0.6, 0.12]),
        _ => return None,
    };
    Some(alone(name, &mesh, Surface::diffuse(name, albedo)))
}

/// A file of one mesh of one material.
pub fn alone(name: &str, mesh: &Mesh, surface: Surface) -> Vec<u8> {
    let mut glb = Glb::new(name);
    let material = glb.material(surface);
    glb.object(name, mesh, material);
    glb.camera("front", Vec3::new(2.0, 2.5, 4.0), Vec3::new(0.0, 0.8, 0.0), 0.7);
    glb.finish()
}

/// A closed box about a middle.
pub fn cuboid(middle_m: Vec3, size_m: Vec3) -> Mesh {
    shapes::cuboid(middle_m - 0.5 * size_m, middle_m + 0.5 * size_m, &[])
}

/// A ball that lies on y = 0.
pub fn ball(radius_m: f32) -> Mesh {
    let (columns, rows) = (48_u32, 24_u32);
    let mut mesh = Mesh::default();
    mesh.grid(columns, rows, |column, row| {
        let (turn, rise) = (TAU * column as f32 / columns as f32, PI * row as f32 / rows as f32);
        let (sine, cosine) = libm::sincosf(rise);
        let (across, along) = libm::sincosf(turn);
        let normal = Vec3::new(sine * across, -cosine, sine * along);
        let uv = Vec2::new(column as f32 / columns as f32, row as f32 / rows as f32);
        (Vec3::Y * radius_m + normal * radius_m, normal, uv)
    });
    mesh
}

/// A board on four legs.
fn table() -> Mesh {
    let mut mesh = cuboid(Vec3::new(0.0, 0.72, 0.0), Vec3::new(1.5, 0.06, 0.9));
    for (x, z) in [(-0.69, -0.39), (0.69, -0.39), (-0.69, 0.39), (0.69, 0.39)] {
        mesh.append(&cuboid(Vec3::new(x, 0.345, z), Vec3::new(0.08, 0.69, 0.08)));
    }
    mesh
}
