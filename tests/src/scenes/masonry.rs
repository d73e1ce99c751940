//! Columns, balusters and their like. All stand on y = 0, where they are open.

use glam::Vec3;

use super::lathe::{lathe, torus_run};
use super::mesh::Mesh;
use super::shapes::{self, Side};

/// How far turned parts reach into the blocks above and below them.
const OVERLAP_M: f32 = 0.01;

/// A column after the Tuscan order: plinth, torus, shaft with entasis, necking, echinus, abacus. `height_m` includes
/// plinth and abacus; `radius_m` is the shaft's at its foot.
pub fn column(height_m: f32, radius_m: f32, sides: u32) -> Mesh {
    let unit = radius_m;
    let (plinth, abacus) = (0.45 * unit, 0.45 * unit);
    let abacus_bottom = height_m - abacus;
    let base = plinth - OVERLAP_M;
    let (shaft_foot, shaft_head) = (plinth + 0.75 * unit, abacus_bottom - 0.95 * unit);
    let shaft_length = shaft_head - shaft_foot;
    let torus = torus_run(1.22 * unit, 0.2 * unit, base, plinth + 0.45 * unit, 5);
    let apophyge =
        [(1.22 * unit, plinth + 0.45 * unit), (1.18 * unit, plinth + 0.55 * unit), (unit, shaft_foot)];
    let shaft: Vec<_> = (0..=4)
        .map(|step| {
            let up = step as f32 / 4.0;
            (unit * (1.0 - 0.16 * up * up), shaft_foot + up * shaft_length)
        })
        .collect();
    let ring = torus_run(0.84 * unit, 0.12 * unit, shaft_head, shaft_head + 0.18 * unit, 4);
    let neck = [(0.84 * unit, shaft_head + 0.18 * unit), (0.84 * unit, shaft_head + 0.5 * unit)];
    let echinus = [
        (0.9 * unit, shaft_head + 0.5 * unit),
        (0.98 * unit, shaft_head + 0.62 * unit),
        (1.16 * unit, shaft_head + 0.78 * unit),
        (1.26 * unit, abacus_bottom + OVERLAP_M),
    ];
    let step = [(0.84 * unit, shaft_head + 0.5 * unit), (0.9 * unit, shaft_head + 0.5 * unit)];
    let mut mesh = lathe(&[&torus, &apophyge, &shaft, &ring, &neck, &step, &echinus], sides);
    let foot = 1.48 * unit;
    mesh.append(&shapes::cuboid(
        Vec3::new(-foot, 0.0, -foot),
        Vec3::new(foot, plinth, foot),
        &[Side::Bottom],
    ));
    let head = 1.4 * unit;
    let (low, high) = (Vec3::new(-head, abacus_bottom, -head), Vec3::new(head, height_m, head));
    mesh.append(&shapes::cuboid(low, high, &[]));
    mesh
}

/// A square block with a base and a cap that stand out by `lip_m`.
pub fn pedestal(width_m: f32, depth_m: f32, height_m: f32, lip_m: f32) -> Mesh {
    let (base_m, cap_m) = (0.14, 0.1);
    let block = |inset: f32, bottom: f32, top: f32, omitted: &[Side]| {
        let (x, z) = (0.5 * width_m - inset, 0.5 * depth_m - inset);
        shapes::cuboid(Vec3::new(-x, bottom, -z), Vec3::new(x, top, z), omitted)
    };
    let mut mesh = block(0.0, 0.0, base_m, &[Side::Bottom]);
    let (low, high) = (base_m - OVERLAP_M, height_m - cap_m + OVERLAP_M);
    mesh.append(&block(lip_m, low, high, &[Side::Bottom, Side::Top]));
    mesh.append(&block(0.0, height_m - cap_m, height_m, &[]));
    mesh
}

/// A baluster of `height_m` between two rails: a vase on a foot.
pub fn baluster(height_m: f32, sides: u32) -> Mesh {
    let profile = [
        (0.062, -OVERLAP_M),
        (0.058, 0.08 * height_m),
        (0.040, 0.14 * height_m),
        (0.088, 0.36 * height_m),
        (0.070, 0.55 * height_m),
        (0.036, 0.80 * height_m),
        (0.060, 0.92 * height_m),
        (0.062, height_m + OVERLAP_M),
    ];
    lathe(&[&profile], sides)
}

/// A balustrade along x, centred, `length_m` long and `height_m` high, with balusters about every 30 cm.
pub fn balustrade(length_m: f32, height_m: f32) -> Mesh {
    let (foot_m, rail_m) = (0.1, 0.14);
    let half = 0.5 * length_m;
    let ends = [Side::Left, Side::Right];
    let (low, high) = (Vec3::new(-half, 0.0, -0.13), Vec3::new(half, foot_m, 0.13));
    let mut mesh = shapes::cuboid(low, high, &[ends[0], ends[1], Side::Bottom]);
    let (low, high) = (Vec3::new(-half, height_m - rail_m, -0.15), Vec3::new(half, height_m, 0.15));
    mesh.append(&shapes::cuboid(low, high, &ends));
    let count = (length_m / 0.34) as u32;
    let vase = baluster(height_m - foot_m - rail_m, 8);
    for i in 0..count {
        let x = length_m * ((i as f32 + 0.5) / count as f32 - 0.5);
        mesh.append(&vase.clone().translated(Vec3::new(x, foot_m, 0.0)));
    }
    mesh
}
