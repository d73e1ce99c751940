//! A cell's groups of receivers, halved until their factors suffice.

use glam::Vec3;
use rayon::prelude::*;

use super::cells::{ClusterCell, halves};
use super::components::components;

/// A kind's truncation of the rows of one cell.
pub trait Truncation: Sync {
    /// Factors, and columns if the kind leaves some out.
    type Factored: Send;

    /// Factors of some receivers of the cell, and whether their error is within the bound that is set.
    fn factored(&self, receivers: &[u32]) -> (Self::Factored, bool);

    /// Place of a receiver in metres.
    fn position_m(&self, receiver: u32) -> Vec3;

    /// A cell of so many receivers and that size is still halved.
    fn may_split(&self, receivers: usize, size_m: f32) -> bool;
}

/// Receivers of a cell with their factors, in a fixed order. Receivers that share no column, by `links` of `linking`
/// columns and the like, are factorised apart: then the error of one room's factors cannot shine into the next.
pub fn split<T: Truncation>(
    truncation: &T,
    cell: &ClusterCell,
    links: &[Vec<u32>],
    linking: usize,
) -> Vec<(Vec<u32>, T::Factored)> {
    let parts: Vec<Vec<_>> = components(links, linking)
        .into_par_iter()
        .map(|group| {
            let receivers = group.iter().map(|&index| cell.receivers[index]).collect();
            halved(truncation, ClusterCell { bounds_m: cell.bounds_m, receivers })
        })
        .collect();
    parts.into_iter().flatten().collect()
}

/// The cell's receivers in one group, or in those of its halves where the rank does not suffice.
fn halved<T: Truncation>(truncation: &T, cell: ClusterCell) -> Vec<(Vec<u32>, T::Factored)> {
    if cell.receivers.is_empty() {
        return Vec::new();
    }
    let (factored, suffices) = truncation.factored(&cell.receivers);
    let size_m = cell.bounds_m[1] - cell.bounds_m[0];
    if suffices || !truncation.may_split(cell.receivers.len(), size_m.max_element()) {
        return vec![(cell.receivers, factored)];
    }
    let [a, b] = halves(&cell, |receiver| truncation.position_m(receiver));
    let (mut groups, others) = rayon::join(|| halved(truncation, a), || halved(truncation, b));
    groups.extend(others);
    groups
}
