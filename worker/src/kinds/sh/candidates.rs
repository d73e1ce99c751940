//! Places where a probe could stand: free cells next to surfaces, not inside geometry.

use std::collections::BTreeSet;

use glam::{IVec3, Vec3};
use lightkiln_proto::harmonics::relight_direction;
use rayon::prelude::*;

use crate::geometry::lattice::{cell_of, centre_of, key_of};
use crate::lightmap::{Surface, World};
use crate::task::Cancelled;
use crate::task::Progress;

/// Rays that look around a candidate.
const LOOK_RAYS: u32 = 64;
/// Nearest a surface may come, as a share of the candidate lattice's step.
const CLEARANCE_MIN: f32 = 0.2;
/// Share of rays that must meet a lit surface: a probe that sees none has nothing to tell.
const LIT_SHARE_MIN: f32 = 0.05;

/// A place for a probe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Identity of its cell.
    pub key: u64,
    /// Place in metres.
    pub position_m: Vec3,
    /// It has a step of free space around it.
    pub roomy: bool,
}

/// Cells of the lattice of `size_m` that hold receivers.
pub fn occupied_cells(world: &World, size_m: f32) -> BTreeSet<[i32; 3]> {
    world.lightmap.receivers.iter().map(|receiver| cell_of(receiver.position_m, size_m).to_array()).collect()
}

/// Candidates on the lattice of `spacing_m / 2`, in the order of their identity, and the rays cast.
///
/// `occupied` are the [`occupied_cells`] of the spacing.
pub fn candidates(
    world: &World,
    occupied: &BTreeSet<[i32; 3]>,
    spacing_m: f32,
    back_face_max: f32,
    progress: &Progress,
) -> Result<Vec<Candidate>, Cancelled> {
    let step_m = spacing_m * 0.5;
    let mut cells = BTreeSet::new();
    for &cell in occupied {
        progress.check()?;
        // All steps of the cell and of its neighbours by one step.
        let first = IVec3::from_array(cell) * 2 - 1;
        for dx in 0..4 {
            for dy in 0..4 {
                for dz in 0..4 {
                    cells.insert((first + IVec3::new(dx, dy, dz)).to_array());
                }
            }
        }
    }
    let cells: Vec<_> = cells.into_iter().map(IVec3::from_array).collect();
    let candidate = |&cell: &IVec3| {
        let found = || candidate_at(world, cell, step_m, back_face_max);
        progress.check().map(|()| progress.casting(found)).transpose()
    };
    let mut found: Vec<Candidate> =
        cells.par_iter().filter_map(candidate).collect::<Result<_, Cancelled>>()?;
    found.sort_by_key(|candidate| candidate.key);
    Ok(found)
}

/// The candidate of a cell, if a probe can stand at its centre.
pub fn candidate_at(world: &World, cell: IVec3, step_m: f32, back_face_max: f32) -> Option<Candidate> {
    let position_m = centre_of(cell, step_m);
    let (mut back, mut lit, mut nearest_m) = (0, 0, f32::INFINITY);
    for ray in 0..LOOK_RAYS {
        let direction = relight_direction(ray, LOOK_RAYS);
        let Some(hit) = world.geometry.tracer.closest(position_m, direction, f32::INFINITY) else { continue };
        nearest_m = nearest_m.min(hit.t);
        if world.geometry.is_back(&hit) {
            back += 1;
        } else if matches!(world.surface_at(&hit), Surface::Receiver(_)) {
            lit += 1;
        }
    }
    let share = |count: u32| count as f32 / LOOK_RAYS as f32;
    let stands =
        share(back) <= back_face_max && share(lit) >= LIT_SHARE_MIN && nearest_m >= step_m * CLEARANCE_MIN;
    stands.then(|| Candidate { key: key_of(cell, step_m), position_m, roomy: nearest_m >= step_m })
}
