//! Meshes made in memory.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use crate::task::Progress;
use crate::unwrap::{Unwrap, UnwrapSettings, unwrap_generated};

/// A mesh with shading normals.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    pub positions_m: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    pub fn unwrap(&self, settings: &UnwrapSettings) -> Unwrap {
        unwrap_generated(&self.positions_m, &self.normals, &self.triangles, settings, &Progress::new())
            .unwrap()
    }

    /// Four corners, counter-clockwise, with a flat normal of their own.
    pub fn quad(&mut self, corners: [Vec3; 4]) -> &mut Self {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let base = self.positions_m.len() as u32;
        self.positions_m.extend(corners);
        self.normals.extend([normal; 4]);
        self.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        self
    }

    /// A grid over `at(u, v)`, u and v in 0..=1, with shading normals from its slope.
    pub fn surface(columns: u32, rows: u32, at: impl Fn(f32, f32) -> Vec3) -> Self {
        let mut mesh = Self::default();
        for j in 0..=rows {
            for i in 0..=columns {
                let (u, v) = (i as f32 / columns as f32, j as f32 / rows as f32);
                let slope = |du: f32, dv: f32| at(u + du, v + dv) - at(u - du, v - dv);
                mesh.positions_m.push(at(u, v));
                mesh.normals.push(slope(1e-3, 0.0).cross(slope(0.0, 1e-3)).normalize_or_zero());
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                let a = j * (columns + 1) + i;
                let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
                mesh.triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        mesh
    }

    pub fn moved(mut self, by: Vec3) -> Self {
        self.positions_m.iter_mut().for_each(|p| *p += by);
        self
    }

    pub fn area_m2(&self, triangle: usize) -> f32 {
        let [a, b, c] = self.triangles[triangle].map(|v| self.positions_m[v as usize]);
        0.5 * (b - a).cross(c - a).length()
    }
}

/// A rectangle in the plane z = 0, facing +z.
pub fn wall(low: (f32, f32), high: (f32, f32)) -> Mesh {
    let at = |x, y| Vec3::new(x, y, 0.0);
    let corners = [at(low.0, low.1), at(high.0, low.1), at(high.0, high.1), at(low.0, high.1)];
    let mut mesh = Mesh::default();
    mesh.quad(corners);
    mesh
}

/// An axis-aligned box facing outwards.
pub fn cuboid(size: Vec3) -> Mesh {
    let at = |x: u8, y: u8, z: u8| Vec3::new(x.into(), y.into(), z.into()) * size;
    let mut mesh = Mesh::default();
    mesh.quad([at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)])
        .quad([at(1, 0, 0), at(0, 0, 0), at(0, 1, 0), at(1, 1, 0)])
        .quad([at(1, 0, 1), at(1, 0, 0), at(1, 1, 0), at(1, 1, 1)])
        .quad([at(0, 0, 0), at(0, 0, 1), at(0, 1, 1), at(0, 1, 0)])
        .quad([at(0, 1, 1), at(1, 1, 1), at(1, 1, 0), at(0, 1, 0)])
        .quad([at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)]);
    mesh
}

/// The side of a cylinder around the y axis.
pub fn cylinder(segments: u32, radius_m: f32, height_m: f32) -> Mesh {
    Mesh::surface(segments, 4, |u, v| {
        let turn = -TAU * u.rem_euclid(1.0);
        Vec3::new(radius_m * turn.cos(), v * height_m, radius_m * turn.sin())
    })
}

/// A sphere of meridians and parallels; its poles are rows of degenerate triangles.
pub fn sphere(radius_m: f32) -> Mesh {
    Mesh::surface(48, 24, |u, v| {
        let (turn, rise) = (-TAU * u.rem_euclid(1.0), PI * (v - 0.5));
        radius_m * Vec3::new(turn.cos() * rise.cos(), rise.sin(), turn.sin() * rise.cos())
    })
}

/// A torus around the y axis.
pub fn torus(radius_m: f32, tube_m: f32) -> Mesh {
    Mesh::surface(64, 32, |u, v| {
        let (turn, rise) = (-TAU * u.rem_euclid(1.0), TAU * v.rem_euclid(1.0));
        let reach = radius_m + tube_m * rise.cos();
        Vec3::new(reach * turn.cos(), tube_m * rise.sin(), reach * turn.sin())
    })
}

/// A spiral ramp around the y axis that rises `pitch_m` a turn.
pub fn ramp(turns: u32, pitch_m: f32) -> Mesh {
    Mesh::surface(4, 24 * turns, |u, v| {
        let turn = TAU * turns as f32 * v;
        let radius_m = 1.0 + 2.0 * u;
        Vec3::new(radius_m * turn.sin(), pitch_m * turns as f32 * v, radius_m * turn.cos())
    })
}

/// Stacked flaps that all face up, joined at their rims by a zigzag of steep strips.
pub fn folded_cloth(flaps: u32) -> Mesh {
    Mesh::surface(4 * flaps, 3, |u, v| {
        let along = u * 4.0 * flaps as f32;
        let phase = along.rem_euclid(4.0);
        let x = if phase < 3.0 { phase } else { 9.0 - 2.0 * phase };
        Vec3::new(x, along * 0.3, -2.0 * v)
    })
}
