//! Cloths: wavy sheets of no thickness, meant for double-sided materials.

use core::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::mesh::Mesh;

/// A sheet over (u, v) in 0..=1; v runs down the cloth, the front is seen with u to the right.
fn sheet(columns: u32, rows: u32, place: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    mesh.grid(columns, rows, |i, j| {
        let (u, v) = (i as f32 / columns as f32, 1.0 - j as f32 / rows as f32);
        (place(u, v), Vec3::ZERO, Vec2::new(u, v))
    });
    mesh.smooth_normals();
    mesh
}

/// A banner laid over a rail and hanging down, along a path in the (z, y) plane; it spans x, centred. Pleats grow
/// towards the hem. Texture coordinates go once over the cloth.
pub fn draped_banner(path: &[(f32, f32)], width_m: f32, pleats: f32, depth_m: f32) -> Mesh {
    sheet(18, 20, |u, v| {
        let (on_path, outward) = along(path, v);
        let free = smooth_step(0.25, 1.0, v);
        let wave = libm::sinf(TAU * (pleats * u + 0.12 * libm::sinf(5.0 * v)));
        let narrow = 1.0 - 0.06 * free;
        let z_y = on_path + outward * (depth_m * (0.12 + free) * wave);
        Vec3::new(width_m * narrow * (u - 0.5), z_y.y, z_y.x)
    })
}

/// A curtain hung from y = 0 at x = 0…`width_m`, gathered towards x = 0 at half height and flaring to its hem.
pub fn gathered_curtain(width_m: f32, height_m: f32, pleats: f32, depth_m: f32) -> Mesh {
    sheet(24, 14, |u, v| {
        let above = 1.0 - smooth_step(0.0, 0.58, v);
        let below = smooth_step(0.58, 1.0, v);
        let width = width_m * (0.38 + 0.62 * above + 0.20 * below);
        let wave = libm::sinf(TAU * pleats * u + 0.8 * libm::sinf(4.0 * v));
        let hem = 0.03 * libm::sinf(TAU * pleats * u + 1.0);
        let sag = 0.05 * libm::sinf(0.5 * TAU * u * 2.0) * above;
        Vec3::new(u * width, -height_m * v + hem * v - sag, depth_m * (0.35 + 0.65 * v) * wave)
    })
}

/// The point at a share of a polyline's parameter, rounded by a quadratic blend, and the direction to its left.
fn along(path: &[(f32, f32)], share: f32) -> (Vec2, Vec2) {
    let segments = (path.len() - 2) as f32;
    let scaled = share.clamp(0.0, 1.0) * segments;
    let index = (scaled as usize).min(path.len() - 3);
    let t = scaled - index as f32 + (share - share.clamp(0.0, 1.0)) * segments;
    let [a, b, c] = [0, 1, 2].map(|k| Vec2::from(path[index + k]));
    // Uniform quadratic B-spline.
    let point = 0.5 * ((1.0 - t) * (1.0 - t) * a + (1.0 + 2.0 * t * (1.0 - t)) * b + t * t * c);
    let tangent = ((1.0 - t) * (b - a) + t * (c - b)).normalize();
    (point, Vec2::new(-tangent.y, tangent.x))
}

fn smooth_step(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
