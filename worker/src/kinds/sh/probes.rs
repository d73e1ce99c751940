//! Probe placement: spacing, and thinning to even density by a rule among neighbours.
//!
//! \[Sedlacek2019\] §3.2.2 removes the densest probe of the whole scene again and again; we differ: a candidate is kept
//! or not by its neighbours alone, in the order of its identity, so that one chair does not change every probe.

use std::collections::BTreeMap;

use lightkiln_proto::kinds::sh::{Probe, ProbeSettings};

use super::candidates::{Candidate, candidates, occupied_cells};
use crate::geometry::lattice::{cell_of, snapped_size_m};
use crate::lightmap::World;
use crate::task::{Cancelled, Progress, TaskError};

/// Density at a candidate above which it is left out: one kept neighbour at 0.8 of the spacing gives this much.
const DENSITY_MAX: f32 = 0.1;
/// Cells with surface per probe to aim at: cells beside one surface share their probes.
const CELLS_PER_PROBE: f32 = 1.5;
/// Most cells of the spacing that may hold surface; a finer spacing than that takes is a mistake in the settings.
const CELLS_MAX: usize = 1 << 20;

/// S1's spatial kernel: `w(t) = 2t³ − 3t² + 1` for t < 1, else 0.
pub fn kernel(t: f32) -> f32 {
    if t < 1.0 { (2.0 * t - 3.0) * t * t + 1.0 } else { 0.0 }
}

/// Probe spacing in metres: as set, or the smallest of {1, 1.5} × 2ⁿ at which no more cells of that size hold
/// surface than `probes_target` probes would fill.
pub fn spacing_m(world: &World, settings: &ProbeSettings) -> f32 {
    if settings.probe_spacing_m > 0.0 {
        return settings.probe_spacing_m;
    }
    let mut spacing_m =
        snapped_size_m(f64::from(world.lightmap.extent_m().max(world.lightmap.texel_m))) as f32;
    // Finer than a few texels, a probe sees no more than its neighbour.
    while spacing_m > 4.0 * world.lightmap.texel_m {
        let finer_m = snapped_size_m(f64::from(spacing_m) * 0.72) as f32;
        if occupied_cells(world, finer_m).len() as f32 > settings.probes_target as f32 * CELLS_PER_PROBE {
            break;
        }
        spacing_m = finer_m;
    }
    spacing_m
}

/// Probes at even density, without radius yet, ascending by key.
pub fn place(
    world: &World,
    settings: &ProbeSettings,
    spacing_m: f32,
    progress: &Progress,
) -> Result<Vec<Probe>, TaskError> {
    // By what there is to light, not by the scene's length: a single triangle may be far off.
    let cells = occupied_cells(world, spacing_m);
    if cells.len() > CELLS_MAX {
        return Err(TaskError::bad_input(format!(
            "probe_spacing_m = {spacing_m} is too fine: surfaces are in {} cells of that size, at most {CELLS_MAX} \
             may be; raise it",
            cells.len()
        )));
    }
    let found = candidates(world, &cells, spacing_m, settings.probe_back_face_max, progress)?;
    Ok(progress.casting(|| thin(world, &found, spacing_m, progress))?)
}

/// Keeps a candidate unless the kept ones around it that it sees are dense: `Σ w(‖p_i − p_j‖ / spacing)` over them.
/// Roomy candidates go first. Gives the kept, ascending by key.
fn thin(
    world: &World,
    found: &[Candidate],
    spacing_m: f32,
    progress: &Progress,
) -> Result<Vec<Probe>, Cancelled> {
    let mut cells: BTreeMap<[i32; 3], Vec<&Candidate>> = BTreeMap::new();
    let mut kept = Vec::new();
    let in_order = found.iter().filter(|c| c.roomy).chain(found.iter().filter(|c| !c.roomy));
    for candidate in in_order {
        progress.check()?;
        let cell = cell_of(candidate.position_m, spacing_m);
        let mut density = 0.0;
        for index in 0..27 {
            let near = [cell.x + index % 3 - 1, cell.y + index / 3 % 3 - 1, cell.z + index / 9 - 1];
            for other in cells.get(&near).into_iter().flatten() {
                let weight = kernel(candidate.position_m.distance(other.position_m) / spacing_m);
                if weight > 0.0 {
                    let hidden = world.geometry.tracer.is_occluded(candidate.position_m, other.position_m);
                    density += if hidden { 0.0 } else { weight };
                }
            }
        }
        if density <= DENSITY_MAX {
            cells.entry(cell.to_array()).or_default().push(candidate);
            kept.push(Probe {
                key: candidate.key,
                position_m: candidate.position_m.to_array(),
                radius_m: 0.0,
            });
        }
    }
    kept.sort_by_key(|probe| probe.key);
    Ok(kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernel_falls_from_one_to_zero() {
        assert_eq!(kernel(0.0), 1.0);
        assert!((kernel(0.5) - 0.5).abs() < 1e-6);
        assert_eq!(kernel(1.0), 0.0);
        assert_eq!(kernel(7.0), 0.0);
    }
}
