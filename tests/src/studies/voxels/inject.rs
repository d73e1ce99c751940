//! Light as written: texels of one lamp's shadow map write voxels (§5.5).

use glam::Vec3;
use lightkiln_worker::geometry::Geometry;
use rayon::prelude::*;

use super::Model;
use super::corner::{lobe, towards};
use super::fill::Leaves;
use super::tree::Cube;

/// A lamp that shines equally in all directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lamp {
    /// Place in metres.
    pub position_m: Vec3,
    /// Radiant intensity in W·sr⁻¹.
    pub intensity: Vec3,
}

/// Texels of a shadow map, and their fates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// That wrote a voxel.
    pub written: usize,
    /// Whose voxel another one had written.
    pub dropped: usize,
    /// In voxels that hold nothing.
    pub lost: usize,
}

/// Points that a lamp sees, by the texels of six square maps about it; `None` where it sees none.
pub fn shadow_map(geometry: &Geometry, lamp: &Lamp, resolution: u32) -> Vec<Option<Vec3>> {
    let faces = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let of_row = |row: u32| {
        let forward = faces[(row / resolution) as usize];
        let right = forward.any_orthonormal_vector();
        let up = right.cross(forward);
        let middle = |at: u32| 2.0 * (at as f32 + 0.5) / resolution as f32 - 1.0;
        let y = middle(row % resolution);
        (0..resolution).map(move |x| {
            let direction = (forward + right * middle(x) + up * y).normalize();
            let hit = geometry.tracer.closest(lamp.position_m, direction, f32::INFINITY);
            hit.map(|hit| geometry.point_of(&hit))
        })
    };
    (0..6 * resolution).into_par_iter().flat_map_iter(of_row).collect()
}

/// Writes the voxels that a lamp's map sees. Of several texels in one voxel the first writes.
pub fn inject(
    leaves: &mut Leaves,
    cube: &Cube,
    model: Model,
    lamp: &Lamp,
    seen: &[Option<Vec3>],
) -> Injected {
    let mut is_lit = vec![false; leaves.cells.len()];
    let mut counts = Injected::default();
    for point_m in seen.iter().flatten() {
        let Some(number) = leaves.number(cube.voxel_of(*point_m)) else {
            counts.lost += 1;
            continue;
        };
        if std::mem::replace(&mut is_lit[number], true) {
            counts.dropped += 1;
            continue;
        }
        counts.written += 1;
        let away_m = lamp.position_m - *point_m;
        let incoming = lamp.intensity / away_m.length_squared();
        let direction = away_m.normalize_or_zero();
        let values = &mut leaves.rows[number].values;
        match model {
            Model::Axes => {
                for axis in 0..3 {
                    let reflected = incoming * leaves.albedo[number];
                    values[towards(axis, false)] = reflected * (-direction[axis]).max(0.0);
                    values[towards(axis, true)] = reflected * direction[axis].max(0.0);
                }
            }
            Model::Lobes => {
                values[lobe::LIGHT_DIRECTION] = direction;
                values[lobe::INCOMING] = incoming;
            }
        }
    }
    counts
}
