//! Rows of an overview as factorised clusters.

use glam::Vec3;
use lightkiln_proto::chunk::column_deviation;
use lightkiln_proto::content::{ColumnKey, PatchKey};

use super::rows::CoarseRow;
use crate::factors::{ClusterCell, Factored, Part, PatchMatrix, Truncation, TruncationBounds, split};
use crate::lightmap::Numbering;
use crate::task::{Cancelled, Progress};

/// Least receivers of a cluster that is halved because its rank does not suffice.
const SPLIT_RECEIVERS_MIN: usize = 128;

/// Rows of one cell while they are factorised.
struct Cell<'a> {
    positions_m: &'a [Vec3],
    receivers: Numbering<u32>,
    /// Column keys: patches, then parts of the sky.
    keys: &'a [ColumnKey],
    matrix: PatchMatrix<'a>,
    bounds: TruncationBounds,
}

/// A part of a cell, and the keys of its columns.
pub struct CoarsePart {
    /// Receivers and factors.
    pub part: Part,
    /// Keys of the columns.
    pub keys: Vec<ColumnKey>,
}

/// The cell's receivers in parts.
pub fn parts(
    rows: &[CoarseRow],
    positions_m: &[Vec3],
    cell: &ClusterCell,
    bounds: TruncationBounds,
    progress: &Progress,
) -> Result<Vec<CoarsePart>, Cancelled> {
    let of_cell: Vec<&CoarseRow> = cell.receivers.iter().map(|&at| &rows[at as usize]).collect();
    let mut keys: Vec<u64> = of_cell.iter().flat_map(|row| &row.columns).map(|(key, _)| *key).collect();
    keys.sort_unstable();
    keys.dedup();
    let place = |key: u64| keys.partition_point(|&other| other < key);
    let first_sky = keys.partition_point(|&key| PatchKey(key).sky().is_none());
    let alpha: Vec<Vec<f32>> = of_cell
        .iter()
        .map(|row| {
            let mut alpha = vec![0.0; keys.len()];
            row.columns.iter().for_each(|(key, weight)| alpha[place(*key)] = *weight);
            alpha
        })
        .collect();
    let deviation: Vec<f32> = keys.iter().map(|&key| column_deviation(key)).collect();
    let importance: Vec<[Vec<f32>; 2]> = alpha
        .iter()
        .map(|alpha| {
            let weighted = alpha.iter().zip(&deviation).map(|(alpha, deviation)| alpha * deviation);
            let mut values: Vec<f32> = weighted.collect();
            values.insert(first_sky, 0.0);
            values.push(0.0);
            let noise = vec![0.0; values.len()];
            [values, noise]
        })
        .collect();
    let matrix = PatchMatrix::new(&keys, alpha.iter().map(Vec::as_slice).zip(&importance));
    let links: Vec<Vec<u32>> = (0..of_cell.len())
        .map(|row| matrix.used(&[row]).into_iter().filter(|&column| (column as usize) < first_sky).collect())
        .collect();
    let own = Cell {
        positions_m,
        receivers: Numbering::of(cell.receivers.iter().copied()),
        keys: &keys,
        matrix,
        bounds,
    };
    let parts = split(&own, cell, &links, first_sky, progress)?;
    let named = |part: Part| {
        let keys = part.factored.groups.iter().map(|&column| own.keys[column as usize]).collect();
        CoarsePart { part, keys }
    };
    Ok(parts.into_iter().map(named).collect())
}

impl Truncation for Cell<'_> {
    fn factored(&self, receivers: &[u32]) -> (Factored, bool) {
        let places: Vec<usize> = receivers.iter().map(|&at| self.receivers.place(at)).collect();
        let (factors, suffices) = self.matrix.factored(&places, self.bounds);
        (Factored { factors, groups: self.matrix.used(&places) }, suffices)
    }

    fn has_columns(&self, receiver: u32) -> bool {
        !self.matrix.used(&[self.receivers.place(receiver)]).is_empty()
    }

    fn position_m(&self, receiver: u32) -> Vec3 {
        self.positions_m[receiver as usize]
    }

    fn may_split(&self, receivers: usize, size_m: f32) -> bool {
        receivers > SPLIT_RECEIVERS_MIN && size_m > 0.0
    }

    fn rank_max(&self) -> usize {
        self.bounds.rank_max
    }
}
