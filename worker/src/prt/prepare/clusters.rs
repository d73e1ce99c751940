//! World-aligned cells of receivers: an edit in one place leaves the cells of all others as they were.

use glam::Vec3;
use lightkiln_proto::prt::Settings;

use crate::prt::stage::{ClusterCell, Stage};

/// Deepest split by place.
const DEPTH_MAX: u32 = 60;

/// Splits space in halves at world-aligned planes until a cell holds at most `cluster_receivers` receivers.
///
/// Cells start as cubes of a power of two around the origin and are halved along x, y, z in turn.
pub fn cells(stage: &Stage, settings: &Settings) -> Vec<ClusterCell> {
    let reach_m =
        stage.receivers.iter().fold(1.0_f32, |reach, r| reach.max(r.position_m.abs().max_element()));
    let mut half_m = 1.0;
    while half_m <= reach_m {
        half_m *= 2.0;
    }
    let all = (0..stage.receivers.len() as u32).collect();
    let root = ClusterCell { bounds_m: [Vec3::splat(-half_m), Vec3::splat(half_m)], receivers: all };
    let mut cells = Vec::new();
    split_into(stage, root, 0, settings.cluster_receivers as usize, &mut cells);
    cells
}

/// Adds `cell`, or its halves if it holds too many.
fn split_into(stage: &Stage, cell: ClusterCell, depth: u32, most: usize, cells: &mut Vec<ClusterCell>) {
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
    for half in halves(&cell, |receiver| stage.receivers[receiver as usize].position_m) {
        split_into(stage, half, depth + 1, most, cells);
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
