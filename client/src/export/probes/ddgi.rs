//! Octahedral maps of irradiance and of distances with borders, in arrays by height, as shaders of dynamic diffuse global illumination
//! (Majercik et al., JCGT 10(2), 2021) read them.

use glam::{Vec2, Vec3};
use half::f16;
use lightkiln_proto::lobes::{self, FARTHEST, Lobe};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::{Volume, harmonics};
use crate::bake::NO_PROBE;
use crate::error::Result;
use crate::export::intensity_of;
use crate::export::ktx2::{self, Shape, opaque};

pub const IRRADIANCE_FILE: &str = "probes-irradiance.ktx2";
pub const DISTANCE_FILE: &str = "probes-distance.ktx2";
pub const PROBES_FILE: &str = "probes-state.ktx2";

/// Texels along a tile's side, of which one at either end is border.
pub const IRRADIANCE_SIDE: usize = 8;
pub const DISTANCE_SIDE: usize = 16;

/// Direction of a place on the square −1..1, the middle being +z.
pub fn direction_of(at: Vec2) -> Vec3 {
    let z = 1.0 - at.x.abs() - at.y.abs();
    let folded = Vec2::new((1.0 - at.y.abs()).copysign(at.x), (1.0 - at.x.abs()).copysign(at.y));
    let on = if z >= 0.0 { at } else { folded };
    on.extend(z).normalize()
}

/// Texel of a tile without its border whose number a texel of the tile holds: of the border, the one that lies on the other side of the octahedron's edge.
pub fn inside_of(side: usize, [x, y]: [usize; 2]) -> [usize; 2] {
    let last = side - 3;
    let [mut x, mut y] = [x, y].map(|at| at as isize - 1);
    let is_out = |at: isize| at < 0 || at > last as isize;
    if is_out(x) {
        (x, y) = (x.clamp(0, last as isize), last as isize - y);
    }
    if is_out(y) {
        (x, y) = (last as isize - x, y.clamp(0, last as isize));
    }
    [x, y].map(|at| at as usize)
}

/// Directions of the texels of a tile without its border, row after row.
fn directions(side: usize) -> Vec<Vec3> {
    let inside = side - 2;
    let middle = |at: usize| (2 * at + 1) as f32 / inside as f32 - 1.0;
    let of = |at: usize| direction_of(Vec2::new(middle(at % inside), middle(at / inside)));
    (0..inside * inside).map(of).collect()
}

/// An array of tiles, a layer for each height: x to the right, z down.
fn array(volume: &Volume<'_>, side: usize, texel: impl Fn(usize, [usize; 2]) -> [f16; 4]) -> Result<Vec<u8>> {
    let [x, y, z] = volume.size();
    let mut texels = Vec::with_capacity(x * y * z * side * side);
    for layer in 0..y {
        for row in 0..z * side {
            for column in 0..x * side {
                let point = volume.index([column / side, layer, row / side]);
                texels.push(texel(point, [column % side, row % side]));
            }
        }
    }
    let [width, height, layers] = [x * side, z * side, y].map(|along| along as u32);
    ktx2::rgba16f(Shape::array([width, height], layers), &texels)
}

/// Adds the files.
pub fn write(
    volume: &Volume<'_>,
    files: &mut Vec<(String, Vec<u8>)>,
    extras: &mut Map<String, Value>,
) -> Result<()> {
    let probes = volume.probes();
    let along = harmonics(directions(IRRADIANCE_SIDE));
    let of_probe = |probe| along.iter().map(move |of| volume.irradiance(probe, of).max(Vec3::ZERO));
    let light: Vec<Vec3> = probes.clone().flat_map(of_probe).collect();
    let intensity = intensity_of(light.iter().copied())?;
    let number = |side: usize, point: usize, at: [usize; 2]| {
        let (inside, [x, y]) = (side - 2, inside_of(side, at));
        volume.probe_of[point] as usize * inside * inside + y * inside + x
    };
    let irradiance = array(volume, IRRADIANCE_SIDE, |point, at| {
        opaque(light[number(IRRADIANCE_SIDE, point, at)] / intensity)
    })?;
    files.push((IRRADIANCE_FILE.to_owned(), irradiance));
    let lobes: Vec<Lobe> = directions(DISTANCE_SIDE).into_iter().map(Lobe::around).collect();
    let moments: Vec<[f32; 2]> =
        probes.into_par_iter().map(|probe| moments(volume, probe, &lobes)).flatten_iter().collect();
    let distance = array(volume, DISTANCE_SIDE, |point, at| {
        let [mean, square] = moments[number(DISTANCE_SIDE, point, at)];
        opaque(Vec3::new(mean, square, 0.0))
    })?;
    files.push((DISTANCE_FILE.to_owned(), distance));
    let state = array(volume, 1, |point, _| {
        let own = volume.lattice.probe_at[point];
        if own == NO_PROBE {
            return [f16::ZERO; 4];
        }
        let at = volume.space.positions_m()[own as usize].truncate() / volume.lattice.spacing_m;
        opaque(at - volume.lattice.point(point).as_vec3())
    })?;
    files.push((PROBES_FILE.to_owned(), state));
    let of = json!({
        "irradiance": { "file": IRRADIANCE_FILE, "intensity": intensity },
        "distance": { "file": DISTANCE_FILE },
        "state": { "file": PROBES_FILE },
    });
    extras.insert("ddgi".to_owned(), of);
    Ok(())
}

/// Mean distance and mean of its square, in steps of the lattice, by texel.
fn moments(volume: &Volume<'_>, probe: u32, lobes: &[Lobe]) -> Vec<[f32; 2]> {
    let far = |direction: &Vec3| {
        (volume.space.distance_m(probe, *direction) / volume.lattice.spacing_m).min(FARTHEST)
    };
    let distances: Vec<f32> = lobes::directions().iter().map(far).collect();
    lobes.iter().map(|lobe| lobe.moments(|ray| distances[ray])).collect()
}
