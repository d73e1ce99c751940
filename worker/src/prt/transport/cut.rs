//! The cut of a cell through the tree of patches: fine where they are large for their distance and much of the cell's
//! light comes from them, coarse elsewhere.
//!
//! With d the distance of a receiver from a patch of size s, what the receiver sees of the patch's parts differs from
//! their shares of its area by about `s / (s + d)` of what it sees of the patch. And where all the cell's rays together
//! met the parts in other shares than those of their areas, as something hides some of them, that much of the light is
//! taken from the wrong parts. Both are shares of irradiance; squared and summed over receivers they are what is lost by
//! taking the patch whole.
//!
//! Single receivers are not asked for the latter: few of their rays meet a part, and chance would drown what is looked for.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::Vec3;

use crate::prt::stage::{Patch, PatchTree};

/// Share of the receivers' irradiance, in the mean of squares, below which a loss is not worth a column.
const LOSS_MIN: f64 = 1e-7;

/// Columns that a cut may have for each root that it starts from, whatever is set.
const COLUMNS_PER_ROOT: usize = 2;
/// Most columns that come of that.
const COLUMNS_MOST: usize = 4096;

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
    /// Per patch: rays of the cell that meet other parts of it than their areas promise.
    misplaced: Vec<f64>,
    /// Per row: rays that met the patch in question; 0 in between.
    of_patch: Vec<f64>,
}

/// Patches that together hold every leaf met, about `columns_max` of them at most, ascending. `meetings` ascend by leaf
/// and row; rows are of receivers at `positions_m`.
pub fn cut(tree: &PatchTree, meetings: &[Meeting], positions_m: &[Vec3], columns_max: usize) -> Vec<u32> {
    let met = Met { tree, meetings };
    let rows = positions_m.len();
    let mut cutter = Cutter { met, positions_m, misplaced: misplaced(met), of_patch: vec![0.0; rows] };
    let total: f64 = meetings.iter().map(|meeting| f64::from(meeting.count)).sum();
    let least = LOSS_MIN * total * total / rows.max(1) as f64;
    let mut done = Vec::new();
    let mut open = BinaryHeap::new();
    for root in tree.roots().filter(|&root| !met.of(root).is_empty()) {
        open.push(Open { loss: cutter.loss(root), patch: root });
    }
    // Where much is seen that no larger patch holds, there is still room to open some of it.
    let columns_max = columns_max.max((COLUMNS_PER_ROOT * open.len()).min(COLUMNS_MOST));
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

/// Rays that meet other parts than their areas promise, per patch: between its own parts, `½ Σ |C_part − p_part C|` less
/// what chance alone gives, or what its parts' parts have together, if that is more.
fn misplaced(met: Met<'_>) -> Vec<f64> {
    let tree = met.tree;
    let mut rays_to = vec![0.0; tree.leaf_starts.len()];
    for meeting in met.meetings {
        rays_to[meeting.leaf as usize + 1] += f64::from(meeting.count);
    }
    for leaf in 1..rays_to.len() {
        rays_to[leaf] += rays_to[leaf - 1];
    }
    let rays = |patch: &Patch| {
        rays_to[(patch.first_leaf + patch.leaf_count) as usize] - rays_to[patch.first_leaf as usize]
    };
    let mut found = vec![0.0; tree.patches.len()];
    // Parts come after what they are part of.
    for index in (0..tree.patches.len()).rev() {
        let patch = &tree.patches[index];
        let all = rays(patch);
        if patch.leaf_count == 1 || all == 0.0 {
            continue;
        }
        let area = tree.receivers_of(patch).len() as f64;
        let (mut between, mut within) = (0.0, 0.0);
        for part in tree.parts(index as u32) {
            let part_patch = &tree.patches[part as usize];
            let promised = all * tree.receivers_of(part_patch).len() as f64 / area;
            // |x| of a normal x is √(2/π) of its deviation in the mean; that of a count is √count.
            let chance = (promised * std::f64::consts::FRAC_2_PI).sqrt();
            between += 0.5 * ((rays(part_patch) - promised).abs() - chance).max(0.0);
            within += found[part as usize];
        }
        found[index] = between.max(within);
    }
    found
}

impl Cutter<'_> {
    /// `Σ_r (w_r c_r)²`, with c_r the rays of row r that met the patch and w_r its size over size and distance: c_r² − c_r
    /// stands for the square of what c_r is expected to be, and the sum is no less than that of rows all alike; nor than
    /// that of the misplaced rays.
    fn loss(&mut self, patch: u32) -> f64 {
        let Met { tree, .. } = self.met;
        let met = self.met.of(patch);
        let misplaced = self.misplaced[patch as usize];
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
        squares.max((sum * sum).max(misplaced * misplaced) / self.positions_m.len() as f64)
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::prt::PatchKey;

    use super::*;

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
    fn patch_far_off_is_split_where_something_hides_parts_of_it() {
        let hidden: Vec<Meeting> =
            (0..2).map(|leaf| Meeting { leaf, row: 0, count: 200, excess: 0 }).collect();
        assert_eq!(cut(&tree(), &hidden, &[Vec3::Y * 1e5], 100), [1]);
        let striped: Vec<Meeting> =
            [0, 2].map(|leaf| Meeting { leaf, row: 0, count: 200, excess: 0 }).to_vec();
        assert_eq!(cut(&tree(), &striped, &[Vec3::Y * 1e5], 100), [2, 5]);
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
        // Twice the roots are always there.
        assert_eq!(cut(&tree(), &evenly_met(), &above_first, 1), [1, 4]);
    }

    #[test]
    fn parts_that_no_ray_met_are_left_out() {
        let last = [Meeting { leaf: 3, row: 0, count: 10, excess: 0 }];
        assert_eq!(cut(&tree(), &last, &[Vec3::Y], 100), [6]);
    }
}
