//! World-aligned cells of receivers, or of other points: an edit in one place leaves the cells of all others as they were.

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::task::{Context, TaskError, artefact};

/// A world-aligned cell of receivers, or of other points, that are factorised together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClusterCell {
    /// Lower and upper corner in metres; the upper one is outside.
    pub bounds_m: [Vec3; 2],
    /// Ascending indices of receivers, or of the points.
    pub receivers: Vec<u32>,
}

/// Magic of the cells' artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKcl";
/// Name under which tasks see it.
pub const CELLS_ARTEFACT: &str = "cells";

/// Cells as an artefact.
pub fn encoded_cells(cells: &[ClusterCell]) -> Result<Vec<u8>, TaskError> {
    artefact::encode(ARTEFACT_MAGIC, &cells)
}

/// Cells among a task's inputs.
pub fn cells_of_task(context: &Context) -> Result<Arc<Vec<ClusterCell>>, TaskError> {
    context.shared(ARTEFACT_MAGIC, CELLS_ARTEFACT)
}

/// Cell of that index of those among a task's inputs.
pub fn cell_of_task(context: &Context, index: usize) -> Result<ClusterCell, TaskError> {
    let cells = cells_of_task(context)?;
    let absent = || TaskError::bad_input("the task names a cluster that the plan does not have");
    cells.get(index).cloned().ok_or_else(absent)
}

/// Names of cells, by their corners in metres: an edit elsewhere leaves them as they are. Of cells in one place the second is `…#2`.
pub fn cell_names(cells: &[ClusterCell]) -> Vec<String> {
    let corner = |corner: Vec3| format!("{},{},{}", corner.x, corner.y, corner.z);
    let mut names: Vec<String> = Vec::with_capacity(cells.len());
    let mut same = 1;
    for (index, cell) in cells.iter().enumerate() {
        let is_same = index > 0 && cells[index - 1].bounds_m == cell.bounds_m;
        same = if is_same { same + 1 } else { 1 };
        let name = cell.bounds_m.map(corner).join("..");
        names.push(if same > 1 { format!("{name}#{same}") } else { name });
    }
    names
}

/// Deepest split by place.
const DEPTH_MAX: u32 = 60;

/// Splits space in halves at world-aligned planes until a cell holds at most `most` of the points.
///
/// Cells start as cubes of a power of two around the origin and are halved along x, y, z in turn.
pub fn cells(positions_m: &[Vec3], most: u32) -> Vec<ClusterCell> {
    let reach_m = positions_m
        .iter()
        .fold(f32::MIN_POSITIVE, |reach, position_m| reach.max(position_m.abs().max_element()));
    let mut half_m = 1.0;
    while half_m <= reach_m {
        half_m *= 2.0;
    }
    // Scenes of micrometres too: halvings are counted.
    while half_m * 0.5 > reach_m {
        half_m *= 0.5;
    }
    let all = (0..positions_m.len() as u32).collect();
    let root = ClusterCell { bounds_m: [Vec3::splat(-half_m), Vec3::splat(half_m)], receivers: all };
    let mut cells = Vec::new();
    split_into(positions_m, root, 0, most as usize, &mut cells);
    cells
}

/// Adds `cell`, or its halves if it holds too many.
fn split_into(
    positions_m: &[Vec3],
    cell: ClusterCell,
    depth: u32,
    most: usize,
    cells: &mut Vec<ClusterCell>,
) {
    if cell.receivers.is_empty() {
        return;
    }
    if cell.receivers.len() <= most {
        cells.push(cell);
        return;
    }
    if depth == DEPTH_MAX {
        // All in one place, as with thousands of copies of one mesh: by their order.
        let parts = cell.receivers.chunks(most);
        cells.extend(parts.map(|part| ClusterCell { bounds_m: cell.bounds_m, receivers: part.to_vec() }));
        return;
    }
    for half in halves(&cell, |receiver| positions_m[receiver as usize]) {
        split_into(positions_m, half, depth + 1, most, cells);
    }
}

/// The two halves of a cell across its longest axis (x before y before z).
pub fn halves(cell: &ClusterCell, position_m: impl Fn(u32) -> Vec3) -> [ClusterCell; 2] {
    let [low, high] = cell.bounds_m;
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let middle = (low[axis] + high[axis]) * 0.5;
    let (mut low_end, mut high_start) = (high, low);
    low_end[axis] = middle;
    high_start[axis] = middle;
    let (lower, upper) = cell.receivers.iter().partition(|&&receiver| position_m(receiver)[axis] < middle);
    [
        ClusterCell { bounds_m: [low, low_end], receivers: lower },
        ClusterCell { bounds_m: [high_start, high], receivers: upper },
    ]
}
