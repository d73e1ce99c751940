//! The cut of a cell through the tree of patches: fine where they are large for their distance and much of the cell's
//! light comes from them, coarse elsewhere.
//!
//! With d the distance of a receiver from a patch of size s, what the receiver sees of the patch's parts differs from
//! their shares of its area by about `s / (s + d)` of what it sees of the patch; that share of irradiance, squared and
//! summed over receivers, is what is lost by taking the patch whole. It is a rule of distances and not of what rays met of
//! the parts, because few rays meet a part: their chance would drown what is looked for.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::Vec3;

use crate::prt::stage::PatchTree;

/// Share of the receivers' irradiance, in the mean of squares, below which a loss is not worth a column.
const LOSS_MIN: f64 = 1e-7;

/// How often the rays of a row met a leaf.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Meeting {
    /// Leaf patch.
    pub leaf: u32,
    /// Row.
    pub row: u32,
    /// Rays.
    pub count: u32,
    /// Rays of even number less those of odd number.
    pub excess: i32,
}

/// A patch and what is lost by taking it whole.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Open {
    loss: f64,
    patch: u32,
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        self.loss.total_cmp(&other.loss).then(other.patch.cmp(&self.patch))
    }
}

#[derive(Clone, Copy)]
struct Met<'a> {
    tree: &'a PatchTree,
    /// Ascending by leaf, then row.
    meetings: &'a [Meeting],
}

struct Cutter<'a> {
    met: Met<'a>,
    /// Where the receivers of the rows are, in metres.
    positions_m: &'a [Vec3],
    /// Per row: rays that met the patch in question; 0 in between.
    of_patch: Vec<f64>,
}

/// Patches that together hold every leaf met, about `columns_max` of them at most, ascending. `meetings` ascend by leaf
/// and row; rows are of receivers at `positions_m`.
pub fn cut(tree: &PatchTree, meetings: &[Meeting], positions_m: &[Vec3], columns_max: usize) -> Vec<u32> {
    let met = Met { tree, meetings };
    let rows = positions_m.len();
    let mut cutter = Cutter { met, positions_m, of_patch: vec![0.0; rows] };
    let total: f64 = meetings.iter().map(|meeting| f64::from(meeting.count)).sum();
    let least = LOSS_MIN * total * total / rows.max(1) as f64;
    let mut done = Vec::new();
    let mut open = BinaryHeap::new();
    for root in tree.roots().filter(|&root| !met.of(root).is_empty()) {
        open.push(Open { loss: cutter.loss(root), patch: root });
    }
    while let Some(best) = open.pop() {
        if best.loss <= least || done.len() + open.len() + 1 >= columns_max {
            done.push(best.patch);
            continue;
        }
        for part in tree.parts(best.patch).filter(|&part| !met.of(part).is_empty()) {
            open.push(Open { loss: cutter.loss(part), patch: part });
        }
    }
    done.sort_unstable();
    done
}

/// The leaves that were met, as patches, ascending.
pub fn leaves(tree: &PatchTree, meetings: &[Meeting]) -> Vec<u32> {
    let is_met = |leaf: u32| meetings.binary_search_by_key(&leaf, |meeting| meeting.leaf).is_ok();
    (0..tree.patches.len() as u32)
        .filter(|&patch| {
            let patch = &tree.patches[patch as usize];
            patch.leaf_count == 1 && is_met(patch.first_leaf)
        })
        .collect()
}

impl<'a> Met<'a> {
    /// Meetings of a patch's leaves.
    fn of(self, patch: u32) -> &'a [Meeting] {
        let patch = &self.tree.patches[patch as usize];
        let start = self.meetings.partition_point(|meeting| meeting.leaf < patch.first_leaf);
        let end = self.meetings.partition_point(|meeting| meeting.leaf < patch.first_leaf + patch.leaf_count);
        &self.meetings[start..end]
    }
}

impl Cutter<'_> {
    /// `Σ_r (w_r c_r)²`, with c_r the rays of row r that met the patch and w_r its size over size and distance: c_r² − c_r
    /// stands for the square of what c_r is expected to be, and the sum is no less than that of rows all alike.
    fn loss(&mut self, patch: u32) -> f64 {
        let Met { tree, .. } = self.met;
        let met = self.met.of(patch);
        let patch = &tree.patches[patch as usize];
        if patch.leaf_count == 1 {
            return 0.0;
        }
        let [low_m, high_m] = patch.bounds_m;
        let size_m = low_m.distance(high_m);
        for meeting in met {
            self.of_patch[meeting.row as usize] += f64::from(meeting.count);
        }
        let (mut squares, mut sum) = (0.0, 0.0);
        for meeting in met {
            let count = std::mem::take(&mut self.of_patch[meeting.row as usize]);
            let position_m = self.positions_m[meeting.row as usize];
            let distance_m = position_m.distance(position_m.clamp(low_m, high_m));
            let weight = f64::from(size_m / (size_m + distance_m).max(f32::MIN_POSITIVE));
            squares += weight * weight * (count * count - count).max(0.0);
            sum += weight * count;
        }
        squares.max(sum * sum / self.positions_m.len() as f64)
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::prt::PatchKey;

    use super::*;
    use crate::prt::stage::Patch;

    /// A root of two parts, each of two leaves of one receiver, 1 m apart along x.
    fn tree() -> PatchTree {
        let patch = |key, first_leaf: u32, leaf_count: u32, end| Patch {
            key: PatchKey(key),
            first_leaf,
            leaf_count,
            end,
            bounds_m: [first_leaf, first_leaf + leaf_count - 1].map(|leaf| Vec3::X * leaf as f32),
        };
        PatchTree {
            patches: vec![
                patch(0, 0, 4, 7),
                patch(1, 0, 2, 4),
                patch(2, 0, 1, 3),
                patch(3, 1, 1, 4),
                patch(4, 2, 2, 7),
                patch(5, 2, 1, 6),
                patch(6, 3, 1, 7),
            ],
            leaf_of_receiver: vec![0, 1, 2, 3],
            receivers: vec![0, 1, 2, 3],
            leaf_starts: vec![0, 1, 2, 3, 4],
            by_key: (0..7).collect(),
        }
    }

    fn evenly_met() -> Vec<Meeting> {
        (0..4).map(|leaf| Meeting { leaf, row: 0, count: 100, excess: 0 }).collect()
    }

    #[test]
    fn patch_far_off_stays_whole() {
        assert_eq!(cut(&tree(), &evenly_met(), &[Vec3::Y * 1e5], 100), [0]);
    }

    #[test]
    fn patch_nearby_is_split_and_where_columns_are_few_its_near_parts_first() {
        let above_first = [Vec3::new(-1.0, 0.1, 0.0)];
        assert_eq!(cut(&tree(), &evenly_met(), &above_first, 100), [2, 3, 5, 6]);
        assert_eq!(cut(&tree(), &evenly_met(), &above_first, 2), [1, 4]);
        assert_eq!(cut(&tree(), &evenly_met(), &above_first, 3), [2, 3, 4]);
        assert_eq!(cut(&tree(), &evenly_met(), &above_first, 1), [0]);
    }

    #[test]
    fn parts_that_no_ray_met_are_left_out() {
        let last = [Meeting { leaf: 3, row: 0, count: 10, excess: 0 }];
        assert_eq!(cut(&tree(), &last, &[Vec3::Y], 100), [6]);
    }
}
