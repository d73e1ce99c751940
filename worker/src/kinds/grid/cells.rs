//! Probes of cells: where no probe at the corners of a cell sees some of its free space, as in a closet between two points of the lattice,
//! one probe more stands in it.

use std::collections::BTreeSet;

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::grid::{Probe, ProbeKey};
use rayon::prelude::*;

use super::Survey;
use super::standing::is_free;
use crate::geometry::Geometry;
use crate::task::{Cancelled, Progress};

/// Steps, from the middle of a cell, at which its space is looked at.
const STEPS: [i8; 4] = [-3, -1, 1, 3];
/// Nearest that a surface may be to a place that is looked at, over the lattice's step.
const CLEARANCE: f32 = 0.04;

/// Keys and moves of the probes of cells, ascending.
pub fn in_cells(
    geometry: &Geometry,
    survey: &Survey,
    bounds_m: [Vec3; 2],
    progress: &Progress,
) -> Result<Vec<(u64, [i8; 3])>, Cancelled> {
    let probes: Vec<(IVec3, Vec3)> = (0..survey.probes.len())
        .map(|index| survey.probe(index))
        .map(|probe| (probe.key.point(), probe.position_m(survey.spacing_m)))
        .collect();
    let cells: BTreeSet<ProbeKey> =
        probes.iter().flat_map(|(point, _)| corners(*point - 1)).filter_map(ProbeKey::of_cell).collect();
    let cells: Vec<ProbeKey> = cells.into_iter().collect();
    let found: Vec<Option<(u64, [i8; 3])>> = cells
        .par_iter()
        .map(|&cell| {
            progress.check()?;
            let around = || {
                let is_corner = |point: &IVec3| corners(cell.point()).any(|corner| corner == *point);
                // Keys of points ascend by z: those of a cell are in two runs.
                let from = probes.partition_point(|(point, _)| point.z < cell.point().z);
                let to = probes.partition_point(|(point, _)| point.z <= cell.point().z + 1);
                let near = probes[from..to].iter().filter(|(point, _)| is_corner(point));
                let near: Vec<Vec3> = near.map(|(_, place_m)| *place_m).collect();
                best(geometry, cell, survey.spacing_m, bounds_m, &near)
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
                    && is_free(geometry, at_m, CLEARANCE * spacing_m)
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
