//! Shapes turned on a lathe: columns, balusters, basins, pots, tree crowns.

use core::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::mesh::Mesh;

/// A point of a profile: distance from the axis and height, in metres.
pub type ProfilePoint = (f32, f32);

/// Turns a profile about the y axis.
///
/// `runs` are read from the bottom up, outside to the right; each run is smooth, edges between runs are sharp.
/// Texture coordinates are metres along the widest ring and along the profile. Ends are left open.
pub fn lathe(runs: &[&[ProfilePoint]], sides: u32) -> Mesh {
    let widest_m = runs.iter().flat_map(|run| run.iter()).map(|point| point.0).fold(0.0, f32::max);
    let mut mesh = Mesh::default();
    let mut travelled_m = 0.0;
    for run in runs {
        let normals = run_normals(run);
        let lengths: Vec<f32> = run_lengths(run).into_iter().map(|length| travelled_m + length).collect();
        mesh.grid(sides, run.len() as u32 - 1, |i, j| {
            // The last column repeats the first one exactly.
            let angle = TAU * (i % sides) as f32 / sides as f32;
            let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
            let ((radius, height), normal) = (run[j as usize], normals[j as usize]);
            let position = Vec3::new(radius * sin, height, radius * cos);
            let normal = Vec3::new(normal.x * sin, normal.y, normal.x * cos);
            let along = i as f32 / sides as f32 * TAU * widest_m;
            (position, normal, Vec2::new(along, -lengths[j as usize]))
        });
        travelled_m = lengths.last().copied().unwrap_or(travelled_m);
    }
    mesh
}

/// Outward unit normals of a profile in its own plane, averaged over the segments that meet at a point.
pub(super) fn run_normals(run: &[ProfilePoint]) -> Vec<Vec2> {
    let facing = |a: ProfilePoint, b: ProfilePoint| Vec2::new(b.1 - a.1, a.0 - b.0).normalize();
    (0..run.len())
        .map(|i| {
            let before = i.checked_sub(1).map_or(Vec2::ZERO, |h| facing(run[h], run[i]));
            let after = run.get(i + 1).map_or(Vec2::ZERO, |&next| facing(run[i], next));
            (before + after).normalize()
        })
        .collect()
}

/// Length travelled along a profile up to each of its points.
pub(super) fn run_lengths(run: &[ProfilePoint]) -> Vec<f32> {
    let mut travelled_m = 0.0;
    let mut lengths = vec![0.0];
    for pair in run.windows(2) {
        travelled_m += Vec2::from(pair[0]).distance(Vec2::from(pair[1]));
        lengths.push(travelled_m);
    }
    lengths
}

/// A round moulding that bulges from `radius_m` by `bulge_m` between two heights, as a run.
pub fn torus_run(radius_m: f32, bulge_m: f32, bottom_m: f32, top_m: f32, steps: u32) -> Vec<ProfilePoint> {
    let (middle, half) = (0.5 * (bottom_m + top_m), 0.5 * (top_m - bottom_m));
    (0..=steps)
        .map(|step| {
            let angle = core::f32::consts::PI * (step as f32 / steps as f32 - 0.5);
            (radius_m + bulge_m * libm::cosf(angle), middle + half * libm::sinf(angle))
        })
        .collect()
}

/// A closed ball whose radius waves by `wave` of itself, like a clipped tree.
pub fn crown(radius_m: f32, wave: f32, sides: u32, rings: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let place = |i: f32, j: f32| {
        let around = TAU * i / sides as f32;
        let up = core::f32::consts::PI * (j / rings as f32 - 0.5);
        let ripple = libm::sinf(5.0 * around) * libm::sinf(7.0 * up) + libm::sinf(9.0 * up + 3.0 * around);
        let radius = radius_m * (1.0 + wave * libm::cosf(up) * ripple);
        let ring = radius * libm::cosf(up);
        Vec3::new(ring * libm::sinf(around), radius * libm::sinf(up), ring * libm::cosf(around))
    };
    mesh.grid(sides, rings, |i, j| {
        let (column, row) = ((i % sides) as f32, j as f32);
        let position = if j == 0 || j == rings { place(0.0, row) } else { place(column, row) };
        let inner = row.clamp(0.5, rings as f32 - 0.5);
        let across = place(column + 0.1, inner) - place(column - 0.1, inner);
        let upward = place(column, inner + 0.1) - place(column, inner - 0.1);
        (position, across.cross(upward).normalize(), Vec2::new(column, row))
    });
    mesh
}
