//! The cut of a cell through the tree of patches: coarse where a patch's mean stands well for what the cell's receivers
//! see of it, fine where they see its parts in other shares than those of its area.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use crate::prt::stage::PatchTree;

/// Share of the sum of squares of the matrix below which a loss is not worth a column.
const LOSS_MIN: f64 = 0.0;

/// How often the rays of a row met a leaf.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Meeting {
    /// Leaf patch.
    pub leaf: u32,
    /// Row.
    pub row: u32,
    /// Rays.
    pub count: u32,
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
    /// Per row: rays that met the patch in question; 0 in between.
    of_patch: Vec<f64>,
}

/// Patches that together hold every leaf met, about `columns_max` of them at most, ascending. `meetings` ascend by leaf
/// and row; rows are below `rows`.
pub fn cut(tree: &PatchTree, meetings: &[Meeting], rows: usize, columns_max: usize) -> Vec<u32> {
    let met = Met { tree, meetings };
    let mut cutter = Cutter { met, of_patch: vec![0.0; rows] };
    let least: f64 = meetings.iter().map(|meeting| f64::from(meeting.count).powi(2)).sum::<f64>() * LOSS_MIN;
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
    /// What is lost by taking a patch whole: `Σ_r Σ_l (c_rl − p_l c_r)²` over its leaves l, less what chance alone gives.
    /// c are rays met, p_l is the leaf's share of the patch's receivers, and `c_r (1 − Σ p_l²)` is the variance of c_r
    /// rays that fall by share.
    fn loss(&mut self, patch: u32) -> f64 {
        let Met { tree, .. } = self.met;
        let met = self.met.of(patch);
        let patch = &tree.patches[patch as usize];
        if patch.leaf_count == 1 {
            return 0.0;
        }
        let whole = tree.receivers_of(patch).len() as f64;
        let share = |leaf: u32| {
            f64::from(tree.leaf_starts[leaf as usize + 1] - tree.leaf_starts[leaf as usize]) / whole
        };
        for meeting in met {
            self.of_patch[meeting.row as usize] += f64::from(meeting.count);
        }
        let (mut own, mut cross, mut squares, mut total) = (0.0, 0.0, 0.0, 0.0);
        for meeting in met {
            let (count, of_patch) = (f64::from(meeting.count), self.of_patch[meeting.row as usize]);
            own += count * count;
            cross += share(meeting.leaf) * count * of_patch;
            // Summed over a row's meetings: c_r².
            squares += count * of_patch;
            total += count;
        }
        met.iter().for_each(|meeting| self.of_patch[meeting.row as usize] = 0.0);
        let shares: f64 =
            (patch.first_leaf..patch.first_leaf + patch.leaf_count).map(|leaf| share(leaf).powi(2)).sum();
        own - 2.0 * cross + shares * squares - total * (1.0 - shares)
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::prt::PatchKey;

    use super::*;
    use crate::prt::stage::Patch;

    /// A root of two parts, each of two leaves of one receiver.
    fn tree() -> PatchTree {
        let patch =
            |key, first_leaf, leaf_count, end| Patch { key: PatchKey(key), first_leaf, leaf_count, end };
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

    fn met(leaf: u32, row: u32, count: u32) -> Meeting {
        Meeting { leaf, row, count }
    }

    #[test]
    fn patch_seen_evenly_stays_whole() {
        let even: Vec<Meeting> = (0..4).map(|leaf| met(leaf, 0, 100)).collect();
        assert_eq!(cut(&tree(), &even, 1, 100), [0]);
    }

    #[test]
    fn patch_seen_in_part_is_split_and_unseen_parts_are_left_out() {
        let lower = [met(0, 0, 100), met(1, 0, 100), met(0, 1, 50), met(1, 1, 50)];
        let mut lower = lower.to_vec();
        lower.sort_by_key(|meeting| (meeting.leaf, meeting.row));
        assert_eq!(cut(&tree(), &lower, 2, 100), [1]);
        assert_eq!(cut(&tree(), &[met(3, 0, 10)], 1, 100), [6]);
    }

    #[test]
    fn columns_are_bounded() {
        let uneven = [met(0, 0, 400), met(1, 0, 10), met(2, 0, 10), met(3, 0, 400)];
        assert_eq!(cut(&tree(), &uneven, 1, 100), [2, 3, 5, 6]);
        assert_eq!(cut(&tree(), &uneven, 1, 1), [0]);
    }
}
