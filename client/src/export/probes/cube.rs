//! Ambient cubes: irradiance by six sides, E(n) = Σ nᵢ² · side(i, sign nᵢ), in a volume of Rx × 2 Ry × 3 Rz texels, as Bevy reads them.

use glam::Vec3;
use serde_json::{Map, Value, json};

use super::{Volume, harmonics};
use crate::bake::PROBE_COEFFICIENTS;
use crate::error::Result;
use crate::export::intensity_of;
use crate::export::ktx2::{self, Shape, opaque};

pub const FILE: &str = "probes-cube.ktx2";

/// Sides of a cube are those of least squares over all normals: what irradiance has of bands 0 and 2 is met but for its mixed products, and
/// `n_i` stands for `5/4 |n_i| n_i`.
const ODD: f32 = 1.25;

/// Sides of the cube of a probe: along x, against it, and so on.
fn sides(volume: &Volume<'_>, probe: u32, along: &[[f32; PROBE_COEFFICIENTS]]) -> [Vec3; 6] {
    let light: Vec<Vec3> = along.iter().map(|of| volume.irradiance(probe, of)).collect();
    std::array::from_fn(|side| {
        let [own, opposite] = [light[side], light[side ^ 1]];
        (0.5 * (own + opposite) + 0.5 * ODD * (own - opposite)).max(Vec3::ZERO)
    })
}

/// Adds the file.
pub fn write(
    volume: &Volume<'_>,
    files: &mut Vec<(String, Vec<u8>)>,
    extras: &mut Map<String, Value>,
) -> Result<()> {
    let along = harmonics(Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]));
    let probes = volume.probes();
    let cubes: Vec<[Vec3; 6]> = probes.map(|probe| sides(volume, probe, &along)).collect();
    let intensity = intensity_of(cubes.iter().flatten().copied())?;
    let [x, y, z] = volume.size();
    let mut texels = Vec::with_capacity(6 * x * y * z);
    // Sides along x, then y, then z lie behind each other; those against an axis below those along it.
    let sides = [[0, 1], [2, 3], [4, 5]];
    for axis in sides {
        for slice in 0..z {
            for side in axis {
                let row = |row| (0..x).map(move |column| [column, row, slice]);
                let of = |at| cubes[volume.probe_of[volume.index(at)] as usize][side] / intensity;
                texels.extend((0..y).flat_map(row).map(|at| opaque(of(at))));
            }
        }
    }
    let [width, height, depth] = [x, 2 * y, 3 * z].map(|along| along as u32);
    files.push((FILE.to_owned(), ktx2::rgba16f(Shape::volume([width, height, depth]), &texels)?));
    extras.insert("cube".to_owned(), json!({ "file": FILE, "intensity": intensity }));
    Ok(())
}
