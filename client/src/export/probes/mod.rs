//! Light at probes in free space, for engines that light moving objects by volumes of their own: `EXPORT.md` says what each file holds.

mod bsp;
mod cube;
mod ddgi;
mod godot;
#[cfg(test)]
mod tests;
mod unity;

pub use ddgi::{
    IRRADIANCE_SIDE as TILE_SIDE, direction_of as direction_in_tile, inside_of as texel_behind_border,
};

use std::collections::VecDeque;

use glam::{IVec3, Vec3, Vec4};
use lightkiln_proto::harmonics::ShBasis;
use serde_json::{Map, Value, json};

use super::not_finite;
use crate::bake::{FreeSpace, Lattice, NO_PROBE, PROBE_COEFFICIENTS};
use crate::error::{ClientError, Result};

/// Files of light at probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeFormat {
    /// Ambient cubes in a volume, as Bevy reads them.
    Cube,
    /// Places and harmonics, as Unity reads them.
    Unity,
    /// Octahedral maps of irradiance and of distances.
    Ddgi,
    /// Harmonics at the corners of tetrahedra, as Godot reads them.
    Godot,
}

impl ProbeFormat {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Cube, Self::Unity, Self::Ddgi, Self::Godot];

    /// Name on command lines.
    fn name(self) -> &'static str {
        match self {
            Self::Cube => "cube",
            Self::Unity => "unity",
            Self::Ddgi => "ddgi",
            Self::Godot => "godot",
        }
    }
}

/// Largest side of a volume, and most layers of an array, that all adapters read.
const VOLUME_MAX: i32 = 2048;
const LAYERS_MAX: i32 = 256;

/// Files, and what [`super::SCENE_FILE`] says of them.
#[derive(Debug, Default)]
pub struct ProbeFiles {
    /// Names and contents.
    pub files: Vec<(String, Vec<u8>)>,
    /// The lattice, and the factors on texels.
    pub extras: Value,
    /// Files that not every adapter reads.
    pub warnings: Vec<String>,
}

/// Whether a file of that name is one of these.
pub fn is_file(name: &str) -> bool {
    let of_ddgi = [ddgi::IRRADIANCE_FILE, ddgi::DISTANCE_FILE, ddgi::PROBES_FILE];
    of_ddgi.contains(&name) || [cube::FILE, unity::FILE, godot::FILE].contains(&name)
}

/// The files of probes under the light that they have, in these formats. Errs where light is no number.
pub fn files(space: &dyn FreeSpace, light: &[Vec4], formats: &[ProbeFormat]) -> Result<ProbeFiles> {
    let (found, wanted) = (light.len(), PROBE_COEFFICIENTS * space.positions_m().len());
    if found != wanted {
        let problem = format!("{found} coefficients, there are {wanted}");
        return Err(ClientError::inconsistent("light at probes", problem));
    }
    if !light.iter().all(|row| row.is_finite()) {
        return Err(not_finite());
    }
    let volume = Volume::new(space, light);
    let mut extras = Map::new();
    let mut found = ProbeFiles::default();
    if let Some(Lattice { spacing_m, low, size, .. }) = space.lattice() {
        extras.insert("lowM".to_owned(), json!((low.as_vec3() * spacing_m).to_array()));
        extras.insert("spacingM".to_owned(), json!(spacing_m));
        extras.insert("size".to_owned(), json!(size.to_array()));
        if (size * IVec3::new(1, 2, 3)).max_element() > VOLUME_MAX || size.y > LAYERS_MAX {
            found.warnings.push(format!("the volume of {size} probes is more than all adapters read"));
        }
    }
    for format in ProbeFormat::ALL.iter().filter(|format| formats.contains(format)) {
        match format {
            ProbeFormat::Unity => unity::write(&volume, &mut found.files, &mut extras),
            ProbeFormat::Godot => godot::write(&volume, &mut found.files, &mut extras),
            ProbeFormat::Cube | ProbeFormat::Ddgi if space.lattice().is_none() => {
                let name = format.name();
                found.warnings.push(format!(
                    "no probes are written as '{name}': that needs a lattice, these stand freely"
                ));
            }
            ProbeFormat::Cube => cube::write(&volume, &mut found.files, &mut extras)?,
            ProbeFormat::Ddgi => ddgi::write(&volume, &mut found.files, &mut extras)?,
        }
    }
    found.extras = Value::Object(extras);
    Ok(found)
}

/// Light at all points of a lattice.
struct Volume<'a> {
    space: &'a dyn FreeSpace,
    lattice: Lattice<'a>,
    light: &'a [Vec4],
    /// Probe of each point, x fastest: its own, or where it has none that of the nearest point with one.
    probe_of: Vec<u32>,
}

impl<'a> Volume<'a> {
    fn new(space: &'a dyn FreeSpace, light: &'a [Vec4]) -> Self {
        let nowhere =
            Lattice { spacing_m: space.spacing_m(), low: IVec3::ZERO, size: IVec3::ZERO, probe_at: &[] };
        let lattice = space.lattice().unwrap_or(nowhere);
        let [x, y, z] = lattice.size.to_array().map(|along| along as usize);
        let mut probe_of = lattice.probe_at.to_vec();
        let mut reached: VecDeque<usize> =
            (0..probe_of.len()).filter(|&at| probe_of[at] != NO_PROBE).collect();
        while let Some(at) = reached.pop_front() {
            let place = [at % x, at / x % y, at / (x * y)];
            for (axis, (step, count)) in [(1, x), (x, y), (x * y, z)].into_iter().enumerate() {
                let below = (place[axis] > 0).then(|| at - step);
                let above = (place[axis] + 1 < count).then(|| at + step);
                for next in below.into_iter().chain(above) {
                    if probe_of[next] == NO_PROBE {
                        probe_of[next] = probe_of[at];
                        reached.push_back(next);
                    }
                }
            }
        }
        Self { space, lattice, light, probe_of }
    }

    /// Points along x, y and z.
    fn size(&self) -> [usize; 3] {
        self.lattice.size.to_array().map(|along| along as usize)
    }

    /// Index of a point.
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        let [width, height, _] = self.size();
        (z * height + y) * width + x
    }

    /// Numbers of all probes.
    fn probes(&self) -> std::ops::Range<u32> {
        0..self.space.positions_m().len() as u32
    }

    /// Coefficients of a probe.
    fn coefficients(&self, probe: u32) -> &[Vec4] {
        &self.light[PROBE_COEFFICIENTS * probe as usize..][..PROBE_COEFFICIENTS]
    }

    /// Likewise, as an array.
    fn rows(&self, probe: u32) -> [Vec4; PROBE_COEFFICIENTS] {
        let own = self.coefficients(probe);
        std::array::from_fn(|j| own[j])
    }

    /// Irradiance at a probe in W·m⁻², which truncation may leave below 0.
    fn irradiance(&self, probe: u32, harmonics: &[f32; PROBE_COEFFICIENTS]) -> Vec3 {
        let own = self.coefficients(probe).iter().zip(harmonics);
        own.map(|(coefficient, harmonic)| coefficient.truncate() * *harmonic).sum()
    }
}

/// Harmonics of directions.
fn harmonics(directions: impl IntoIterator<Item = Vec3>) -> Vec<[f32; PROBE_COEFFICIENTS]> {
    let basis = ShBasis::new(2);
    let of = |direction| {
        let mut found = [0.0; PROBE_COEFFICIENTS];
        basis.evaluate(direction, &mut found);
        found
    };
    directions.into_iter().map(of).collect()
}
