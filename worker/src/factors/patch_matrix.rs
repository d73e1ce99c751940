//! Rows over patches while they are factorised: truncated by the columns that light is expected to need.

use lightkiln_proto::content::PatchKey;

use super::{Factors, Matrix, factorise};
use crate::rays::sampling::seed_of;

/// Least square of a singular value that counts, over that of its noise: those of noise alone are above the mean, as the
/// decomposition looks for the largest.
const NOISE_FACTOR: f64 = 2.0;
/// Least share of a matrix that is taken for signal, in squares: of single rays nobody knows.
const SIGNAL_MIN: f64 = 1e-3;

/// How much of a matrix is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruncationBounds {
    /// Highest rank.
    pub rank_max: usize,
    /// Relative error up to which ranks are dropped.
    pub error_max: f32,
}

/// Rows over patches, each with its importance-weighted columns; receivers' or any others.
pub struct PatchMatrix<'a> {
    /// Patches, then parts of the sky.
    keys: &'a [u64],
    /// α, one slice per row.
    alpha: Vec<&'a [f32]>,
    /// Importance-weighted rows, and the noise in them.
    importance: [Vec<Vec<f32>>; 2],
}

impl<'a> PatchMatrix<'a> {
    /// Of rows' α and importance, as [`crate::transport::PatchRow`] has them. The sky's columns count for no more than the
    /// others: where most of the hemisphere is sky, the rest is the whole light when it is dark.
    ///
    /// # Panics
    /// If a row has no importance.
    pub fn new(keys: &'a [u64], rows: impl Iterator<Item = (&'a [f32], &'a [Vec<f32>; 2])>) -> Self {
        let (alpha, given): (Vec<_>, Vec<_>) = rows.unzip();
        let first_sky = first_sky(keys) + 1;
        let mut importance =
            [0, 1].map(|which: usize| given.iter().map(|row| row[which].clone()).collect::<Vec<_>>());
        let of_patches: f64 = importance[0].iter().map(|row| squares(&row[..first_sky])).sum();
        let of_sky: f64 = importance[0].iter().map(|row| squares(&row[first_sky..])).sum();
        if of_patches > 0.0 && of_sky > of_patches {
            let scale = (of_patches / of_sky).sqrt() as f32;
            let all = importance.iter_mut().flatten();
            all.flat_map(|row| &mut row[first_sky..]).for_each(|value| *value *= scale);
        }
        Self { keys, alpha, importance }
    }

    /// Columns with anything in them, as indices of keys.
    pub fn used(&self, rows: &[usize]) -> Vec<u32> {
        let is_used = |&column: &u32| rows.iter().any(|&row| self.alpha[row][column as usize] != 0.0);
        (0..self.keys.len() as u32).filter(is_used).collect()
    }

    /// Patches that a row meets, as indices of keys; also those whose column is empty, as their parts have all.
    pub fn met_patches(&self, row: usize) -> Vec<u32> {
        let importance = &self.importance[0][row];
        (0..first_sky(self.keys) as u32).filter(|&column| importance[column as usize] != 0.0).collect()
    }

    /// Factors of some rows over the columns that they use, and whether their error is within the bound that is set.
    ///
    /// U of the importance-weighted matrix with a column for the sum, and ΣVᵀ = UᵀA, so that a cluster's energy is right
    /// under every light. The rank is the smallest whose dropped signal is within the error that is set.
    pub fn factored(&self, rows: &[usize], bounds: TruncationBounds) -> (Factors, bool) {
        // Factorise to the highest rank: which of it is signal is seen only afterwards.
        let [weighted, noise] = [0, 1].map(|which| self.weighted(rows, which));
        let mut factors = factorise(&weighted, bounds.rank_max, 0.0, &self.seeds());
        if factors.rank == 0 {
            return (factors, true);
        }
        // Drop ranks from the last on while their signal fits into the error: noise, which the two halves of the rays do
        // not share, is worth no rank.
        let (rank, error) = rank(&factors, &weighted, &noise, bounds);
        // One more column for the sum over rows keeps energy exact.
        (factors.rank, factors.u) = factors.with_sum(rank, rows.len());
        // Project A itself on U: then only columns are lost that no row tells apart.
        factors.vt = factors.projected(&self.alpha(rows));
        factors.truncation_error = error;
        let suffices = error <= bounds.error_max;
        (factors, suffices)
    }

    /// Importance-weighted rows, or the noise in them.
    fn weighted(&self, rows: &[usize], which: usize) -> Matrix {
        let values = rows.iter().flat_map(|&row| &self.importance[which][row]).copied().collect();
        Matrix { rows: rows.len(), columns: self.keys.len() + 2, values }
    }

    /// Rows of A, of the columns that they use.
    fn alpha(&self, rows: &[usize]) -> Matrix {
        let columns = self.used(rows);
        let of_row = |&row: &usize| columns.iter().map(move |&column| self.alpha[row][column as usize]);
        let values = rows.iter().flat_map(of_row).collect();
        Matrix { rows: rows.len(), columns: columns.len(), values }
    }

    /// One seed per importance-weighted column, from the identity of its patch or part of the sky.
    fn seeds(&self) -> Vec<u64> {
        let common = |which: u64| seed_of(&[which, 6]);
        let mut seeds: Vec<u64> = self.keys.iter().map(|&key| seed_of(&[key, 5])).collect();
        seeds.insert(first_sky(self.keys), common(0));
        seeds.push(common(1));
        seeds
    }
}

/// Index of the first key that stands for a part of the sky.
fn first_sky(keys: &[u64]) -> usize {
    keys.partition_point(|&key| PatchKey(key).sky().is_none())
}

fn squares(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value).powi(2)).sum()
}

/// The smallest rank whose dropped signal is within the error that is set, and that error.
fn rank(factors: &Factors, weighted: &Matrix, noise: &Matrix, bounds: TruncationBounds) -> (usize, f32) {
    let [values, noises] = [weighted, noise].map(|matrix| squares(&matrix.values));
    let total = (values - noises).max(SIGNAL_MIN * values);
    let columns = weighted.columns.max(1);
    let noise_of = factors.projected(noise);
    let of_ranks: Vec<[f64; 2]> = factors
        .vt
        .chunks_exact(columns)
        .zip(noise_of.chunks_exact(columns))
        .map(|(values, noise)| [squares(values), squares(noise)])
        .collect();
    // Beyond the ranks known, of values and noise alike: nothing is where the ranks span all rows, however noisy.
    let known: f64 = of_ranks.iter().map(|[values, noise]| values - noise).sum();
    let mut left_out = (values - noises - known).max(0.0);
    let allowed = f64::from(bounds.error_max).powi(2) * total;
    let mut rank = factors.rank;
    while rank > 0 {
        let [values, noise] = of_ranks[rank - 1];
        let signal = (values - NOISE_FACTOR * noise).max(0.0);
        if left_out + signal > allowed && rank < bounds.rank_max {
            break;
        }
        (left_out, rank) = (left_out + signal, rank - 1);
    }
    (rank, (left_out / total).sqrt().min(1.0) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truncation_error_of_rows_that_are_all_noise_is_no_more_than_they_hold() {
        // Two rows, each with one ray on a patch of its own: nothing is known to be signal.
        let keys = [PatchKey::of_cell(0, [0; 3], 0, 0).0, PatchKey::of_cell(0, [1, 0, 0], 0, 0).0];
        let alpha = [vec![1.0, 0.0], vec![0.0, 1.0]];
        let importance = [[1.0, 0.0, 0.4, 0.0], [0.0, 1.0, 0.4, 0.0]].map(|row| {
            let noise = row.map(|value: f32| -1.2 * value);
            [row.to_vec(), noise.to_vec()]
        });
        let rows = alpha.iter().map(Vec::as_slice).zip(&importance);
        let matrix = PatchMatrix::new(&keys, rows);
        let (factors, suffices) = matrix.factored(&[0, 1], TruncationBounds { rank_max: 8, error_max: 0.01 });
        assert!(suffices && factors.truncation_error <= 0.01, "{factors:?}");
        assert!(factors.rank > 0, "the sum over rows is kept");
    }
}
