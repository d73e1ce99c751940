//! A cell's groups of receivers, halved until their factors suffice, and small ones joined.

use glam::Vec3;
use rayon::prelude::*;

use super::cells::{ClusterCell, halves};
use super::components::components;
use super::join::{Part, joined};
use super::svd::Factors;
use crate::task::{Cancelled, Progress};

/// Factors of some receivers, and the groups of columns that they are over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Factored {
    /// Factors, a row of U for each receiver.
    pub factors: Factors,
    /// Ascending indices of the groups of columns with anything in them.
    pub groups: Vec<u32>,
}

/// A kind's truncation of the rows of one cell.
pub trait Truncation: Sync {
    /// Factors of some receivers of the cell, and whether their error is within the bound that is set.
    fn factored(&self, receivers: &[u32]) -> (Factored, bool);

    /// Whether a receiver's row has anything in any column.
    fn has_columns(&self, receiver: u32) -> bool;

    /// Place of a receiver in metres.
    fn position_m(&self, receiver: u32) -> Vec3;

    /// A cell of so many receivers and that size is still halved.
    fn may_split(&self, receivers: usize, size_m: f32) -> bool;

    /// Highest rank of a cluster.
    fn rank_max(&self) -> usize;
}

/// Receivers of a cell with their factors, in a fixed order. Receivers that share no column, by `links` of `linking`
/// columns and the like, are factorised apart: then the error of one room's factors cannot shine into the next. Parts
/// that are small are joined, and receivers without columns go with any. Errors soon after `progress` is cancelled.
pub fn split<T: Truncation>(
    truncation: &T,
    cell: &ClusterCell,
    links: &[Vec<u32>],
    linking: usize,
    progress: &Progress,
) -> Result<Vec<Part>, Cancelled> {
    let parts: Vec<Vec<Part>> = components(links, linking)
        .into_par_iter()
        .map(|group| {
            let receivers = group.iter().map(|&index| cell.receivers[index]);
            let (seeing, dark) = receivers.partition(|&receiver| truncation.has_columns(receiver));
            let seeing = ClusterCell { bounds_m: cell.bounds_m, receivers: seeing };
            let mut parts = halved(truncation, seeing, progress)?;
            parts.push(Part { receivers: dark, factored: Factored::default() });
            Ok(parts)
        })
        .collect::<Result<_, Cancelled>>()?;
    Ok(joined(parts.into_iter().flatten().collect(), truncation.rank_max()))
}

/// The cell's receivers in one part, or in those of its halves where the rank does not suffice.
fn halved<T: Truncation>(
    truncation: &T,
    cell: ClusterCell,
    progress: &Progress,
) -> Result<Vec<Part>, Cancelled> {
    progress.check()?;
    if cell.receivers.is_empty() {
        return Ok(Vec::new());
    }
    let (factored, suffices) = truncation.factored(&cell.receivers);
    let size_m = cell.bounds_m[1] - cell.bounds_m[0];
    if suffices || !truncation.may_split(cell.receivers.len(), size_m.max_element()) {
        return Ok(vec![Part { receivers: cell.receivers, factored }]);
    }
    let [a, b] = halves(&cell, |receiver| truncation.position_m(receiver));
    let (parts, others) = rayon::join(|| halved(truncation, a, progress), || halved(truncation, b, progress));
    let mut parts = parts?;
    parts.extend(others?);
    Ok(parts)
}
