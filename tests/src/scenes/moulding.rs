//! Mouldings that run around the inside of a rectangular court.

use glam::{Vec2, Vec3};

use super::lathe::{ProfilePoint, run_lengths, run_normals};
use super::mesh::Mesh;

/// Sweeps a profile around the inside of a rectangle with mitred corners.
///
/// Profile points are (how far from the wall into the court, height), read from the bottom up; each run is smooth.
/// `half_x_m` and `half_z_m` are where the wall's faces are.
pub fn court_moulding(half_x_m: f32, half_z_m: f32, runs: &[&[ProfilePoint]]) -> Mesh {
    // Seen from inside, each side goes from left to right.
    let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)];
    let inwards = [-Vec3::Z, Vec3::X, Vec3::Z, -Vec3::X];
    let mut mesh = Mesh::default();
    for side in 0..4 {
        let ends = [corners[side], corners[(side + 1) % 4]];
        let length = if side % 2 == 0 { 2.0 * half_x_m } else { 2.0 * half_z_m };
        let mut travelled_m = 0.0;
        for run in runs {
            let normals = run_normals(run);
            let lengths = run_lengths(run);
            mesh.grid(1, run.len() as u32 - 1, |i, j| {
                let (sign_x, sign_z) = ends[i as usize];
                let (out, height) = run[j as usize];
                let normal = normals[j as usize];
                let position = Vec3::new(sign_x * (half_x_m - out), height, sign_z * (half_z_m - out));
                let facing = inwards[side] * normal.x + Vec3::Y * normal.y;
                (position, facing, Vec2::new(i as f32 * length, -travelled_m - lengths[j as usize]))
            });
            travelled_m += lengths.last().copied().unwrap_or_default();
        }
    }
    mesh
}

/// A classical cornice between two heights that stands out by `reach_m`: fillet, cyma, corona, top.
pub fn cornice(half_x_m: f32, half_z_m: f32, bottom_m: f32, top_m: f32, reach_m: f32) -> Mesh {
    let at = |out: f32, up: f32| (out * reach_m, bottom_m + up * (top_m - bottom_m));
    let foot = [at(-0.05, 0.0), at(0.18, 0.0)];
    let fillet = [at(0.18, 0.0), at(0.18, 0.16)];
    let soffit = [at(0.18, 0.16), at(0.26, 0.17)];
    let cyma = [at(0.26, 0.17), at(0.30, 0.27), at(0.42, 0.38), at(0.60, 0.47), at(0.70, 0.54)];
    let step = [at(0.70, 0.54), at(0.84, 0.55)];
    let corona = [at(0.84, 0.55), at(0.84, 0.84)];
    let lip = [at(0.84, 0.84), at(0.96, 0.90), at(1.0, 1.0)];
    let top = [at(1.0, 1.0), at(-0.05, 1.0)];
    court_moulding(half_x_m, half_z_m, &[&foot, &fillet, &soffit, &cyma, &step, &corona, &lip, &top])
}
