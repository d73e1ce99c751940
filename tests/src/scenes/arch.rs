//! Round arches: the wall above them, their mouldings, ribs and groin vaults.
//!
//! An arch spans x, springs at y = 0 and faces ±z. Its legs go `drop_m` below the springing, into whatever carries it.

use core::f32::consts::PI;

use glam::{Vec2, Vec3};

use super::lathe::{ProfilePoint, run_lengths};
use super::mesh::Mesh;

/// One bay of an arcade.
#[derive(Clone, Copy, Debug)]
pub struct ArcadeBay {
    /// From column axis to column axis.
    pub width_m: f32,
    /// From the springing to the top of the wall.
    pub height_m: f32,
    /// Of the wall, along z.
    pub thickness_m: f32,
    /// Inner radius of the arch.
    pub radius_m: f32,
    /// Width of the moulded ring around the arch, on its +z side.
    pub ring_m: f32,
    /// Legs below the springing.
    pub drop_m: f32,
    /// Segments of the half circle.
    pub segments: u32,
}

/// A station along an arch: direction from its centre, and height of the centre.
#[derive(Clone, Copy)]
struct Station {
    outward: Vec2,
    raise_m: f32,
    travelled: f32,
}

impl Station {
    fn at(self, radius_m: f32, z_m: f32) -> Vec3 {
        let point = radius_m * self.outward;
        Vec3::new(point.x, point.y + self.raise_m, z_m)
    }
}

/// From the foot of the right leg over the crown to the foot of the left one.
fn stations(segments: u32, drop_m: f32) -> Vec<Station> {
    let mut list = vec![Station { outward: Vec2::X, raise_m: -drop_m, travelled: -drop_m }];
    for step in 0..=segments {
        let angle = PI * step as f32 / segments as f32;
        // Exact at both feet, where walls meet the arch.
        let outward = match step {
            0 => Vec2::X,
            _ if step == segments => -Vec2::X,
            _ => Vec2::new(libm::cosf(angle), libm::sinf(angle)),
        };
        list.push(Station { outward, raise_m: 0.0, travelled: angle });
    }
    list.push(Station { outward: -Vec2::X, raise_m: -drop_m, travelled: PI + drop_m });
    list
}

/// Sweeps sharp-edged profile points (radius, z) along an arch. Its front looks outwards where z
/// grows, the +z side where the radius shrinks, inwards where z falls.
fn sweep(profile: &[ProfilePoint], stations: &[Station]) -> Mesh {
    let mut mesh = Mesh::default();
    let lengths = run_lengths(profile);
    for (pair, lengths) in profile.windows(2).zip(lengths.windows(2)) {
        let along = Vec2::new(pair[1].0 - pair[0].0, pair[1].1 - pair[0].1).normalize();
        mesh.grid(stations.len() as u32 - 1, 1, |i, j| {
            let station = stations[i as usize];
            let (radius, z) = pair[j as usize];
            let normal = (along.y * station.outward).extend(-along.x);
            (station.at(radius, z), normal, Vec2::new(station.travelled * radius, lengths[j as usize]))
        });
    }
    mesh
}

/// A wall over an arch: both faces, the moulded ring on the +z side and the soffit. Its top and its ends are open; a
/// slab and the neighbouring bays close them.
pub fn arcade_bay(bay: ArcadeBay) -> Mesh {
    let stations = stations(bay.segments, bay.drop_m);
    let (front, back) = (0.5 * bay.thickness_m, -0.5 * bay.thickness_m);
    let (outer, inner) = (bay.radius_m + bay.ring_m, bay.radius_m);
    let middle = 0.5 * (outer + inner);
    let profile = [
        (outer, front),
        (outer, front + 0.07),
        (middle, front + 0.07),
        (middle, front + 0.04),
        (inner, front + 0.04),
        (inner, back),
    ];
    let mut mesh = sweep(&profile, &stations);
    mesh.append(&plate(bay, outer, front, &stations));
    mesh.append(&plate(bay, inner, front, &stations).turned_to_back(bay.thickness_m));
    mesh
}

/// The face of an arcade wall towards +z, with a hole of the given radius.
fn plate(bay: ArcadeBay, radius_m: f32, z_m: f32, stations: &[Station]) -> Mesh {
    let mut mesh = Mesh::default();
    let last = stations.len() - 1;
    mesh.grid(last as u32, 1, |i, j| {
        let edge = stations[last - i as usize].at(radius_m, z_m);
        let position = if j == 0 { edge } else { Vec3::new(edge.x, bay.height_m, z_m) };
        (position, Vec3::Z, Vec2::new(position.x, -position.y))
    });
    let half = 0.5 * bay.width_m;
    for left in [-half, radius_m] {
        for (bottom, top) in [(-bay.drop_m, 0.0), (0.0, bay.height_m)] {
            let corners = [
                (left, bottom),
                (left + half - radius_m, bottom),
                (left + half - radius_m, top),
                (left, top),
            ];
            mesh.face(corners.map(|(x, y)| Vec3::new(x, y, z_m)), corners.map(|(x, y)| Vec2::new(x, -y)));
        }
    }
    mesh
}

/// A band under a vault: `width_m` along z, from `radius_m` inwards by `depth_m`; open where the vault covers it.
pub fn rib(radius_m: f32, depth_m: f32, width_m: f32, drop_m: f32, segments: u32) -> Mesh {
    let (inner, half) = (radius_m - depth_m, 0.5 * width_m);
    sweep(&[(radius_m, half), (inner, half), (inner, -half), (radius_m, -half)], &stations(segments, drop_m))
}

/// The underside of a groin vault over a square bay of half width `half_m`: two crossing barrels that spring at y = 0.
pub fn groin_vault(half_m: f32, segments: u32) -> Mesh {
    let mut web = Mesh::default();
    web.grid(segments, 1, |i, j| {
        let (outward, flat) = match i {
            0 => (1.0, 0.0),
            _ if i == segments => (-1.0, 0.0),
            _ => {
                let angle = PI * i as f32 / segments as f32;
                (libm::cosf(angle), libm::sinf(angle))
            }
        };
        let z = half_m * outward;
        let x = if j == 0 { z.abs() } else { half_m };
        (
            Vec3::new(x, half_m * flat, z),
            Vec3::new(0.0, -flat, -outward),
            Vec2::new(x, angle_length(half_m, i, segments)),
        )
    });
    let mut vault = Mesh::default();
    for quarter in 0..4 {
        vault.append(&web.clone().turned(0.5 * PI * quarter as f32));
    }
    vault
}

fn angle_length(radius_m: f32, step: u32, segments: u32) -> f32 {
    radius_m * PI * step as f32 / segments as f32
}

impl Mesh {
    /// A face at z = +thickness/2 of a wall centred on z = 0, moved to the wall's other side.
    fn turned_to_back(mut self, thickness_m: f32) -> Self {
        for position in &mut self.positions_m {
            position.z -= thickness_m;
        }
        self.flipped()
    }
}
