//! Probes of cells: where no probe at the corners of a cell sees some of its free space, as in a closet between two points of the lattice,
//! one probe more stands in it.

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::{Probe, ProbeKey};
use rayon::prelude::*;

use crate::geometry::Geometry;
use crate::kinds::field::{Survey, is_free, narrow_clearance_m};
use crate::task::{Cancelled, Progress};

/// Steps, from the middle of a cell, at which its space is looked at.
const STEPS: [i8; 4] = [-3, -1, 1, 3];
/// Keys and moves of the probes of the cells between the points of a lattice, ascending.
pub fn in_cells(
    geometry: &Geometry,
    survey: &Survey,
    (low, size): (IVec3, IVec3),
    bounds_m: [Vec3; 2],
    progress: &Progress,
) -> Result<Vec<(u64, [i8; 3])>, Cancelled> {
    let [x, y, z] = (size - 1).max(IVec3::ZERO).to_array();
    let cells = (0..z).flat_map(|z| (0..y).flat_map(move |y| (0..x).map(move |x| IVec3::new(x, y, z))));
    let cells: Vec<ProbeKey> = cells.filter_map(|cell| ProbeKey::of_cell(low + cell)).collect();
    let found: Vec<Option<(u64, [i8; 3])>> = cells
        .par_iter()
        .map(|&cell| {
            progress.check()?;
            let around = || {
                let number = |key: ProbeKey| survey.probes.binary_search_by_key(&key.0, |probe| probe.0).ok();
                let corners = corners(cell.point()).filter_map(ProbeKey::of).filter_map(number);
                let near: Vec<Vec3> =
                    corners.map(|number| survey.probe(number).position_m(survey.step_m)).collect();
                best(geometry, cell, survey.step_m, bounds_m, &near)
            };
            Ok(progress.casting(around).map(|moved| (cell.0, moved)))
        })
        .collect::<Result<_, Cancelled>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// The eight corners of a cell.
fn corners(point: IVec3) -> impl Iterator<Item = IVec3> {
    (0..8).map(move |corner| point + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2))
}

/// Of the places of a cell that no probe sees, the one that sees most of the others; of equal ones the first.
fn best(
    geometry: &Geometry,
    cell: ProbeKey,
    spacing_m: f32,
    [low_m, high_m]: [Vec3; 2],
    probes_m: &[Vec3],
) -> Option<[i8; 3]> {
    let sees = |from_m: Vec3, to_m: Vec3| !geometry.tracer.is_occluded(from_m, to_m);
    let mut unseen: Vec<([i8; 3], Vec3)> = Vec::new();
    for z in STEPS {
        for y in STEPS {
            for x in STEPS {
                let moved = [x, y, z];
                let at_m = Probe { key: cell, moved }.position_m(spacing_m);
                let is_within = at_m.cmpge(low_m).all() && at_m.cmple(high_m).all();
                if is_within
                    && !probes_m.iter().any(|&probe_m| sees(probe_m, at_m))
                    && is_free(geometry, at_m, narrow_clearance_m(spacing_m))
                {
                    unseen.push((moved, at_m));
                }
            }
        }
    }
    let count = |at_m: Vec3| unseen.iter().filter(|(_, other_m)| sees(at_m, *other_m)).count();
    let best =
        unseen.iter().zip(0..).max_by_key(|((_, at_m), index)| (count(*at_m), std::cmp::Reverse(*index)));
    best.map(|((moved, _), _): (&([i8; 3], Vec3), u32)| *moved)
}
