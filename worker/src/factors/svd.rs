//! Truncated singular value decomposition of a cluster's transport matrix: `A ≈ U (ΣVᵀ)`.
//!
//! Randomised subspace iteration (\[Halko2011\] alg. 4.4), with every sum in a fixed order. Own code, because the
//! kernels of the linear-algebra crates choose their vector width and blocking by the processor they meet: two workers
//! of different make would give chunks of different digests.

use rayon::prelude::*;

/// A dense matrix, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Matrix {
    /// Rows m.
    pub rows: usize,
    /// Columns n.
    pub columns: usize,
    /// m·n values.
    pub values: Vec<f32>,
}

/// Factors of rank k.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Factors {
    /// k.
    pub rank: usize,
    /// U, row-major m × k, with orthonormal columns.
    pub u: Vec<f32>,
    /// ΣVᵀ, row-major k × n.
    pub vt: Vec<f32>,
    /// √(Σ_{i>k} s² / Σ s²); 0 for a matrix of zeros.
    pub truncation_error: f32,
    /// Upper bound of \[Sedlacek2019\] §3.2.4.2's criterion `1 − √(Σ_{i≤k} s / Σ s)`. The singular values beyond those
    /// computed are known by their squares' sum alone, which bounds their sum by Cauchy–Schwarz.
    pub s1_criterion_bound: f32,
}

impl Factors {
    /// UᵀA, row-major k × n: with it in place of ΣVᵀ, the product is A projected on U's columns.
    pub fn projected(&self, a: &Matrix) -> Vec<f32> {
        transposed(&transpose_times(a, &self.u, self.rank), self.rank)
    }

    /// A basis of the first k columns of U and the sum over all rows: the sum, in every row alike, is the first column, and the
    /// others are turned as little as that needs. It has k columns if the sum lies in their span, k + 1 else.
    pub fn with_sum(&self, k: usize, rows: usize) -> (usize, Vec<f32>) {
        let column = |c: usize| (0..rows).map(move |r| f64::from(self.u[r * self.rank + c]));
        let even = (rows as f64).sqrt().recip();
        // The sum's direction in the basis of the k columns and of what they lack of it.
        let mut along: Vec<f64> = (0..k).map(|c| even * column(c).sum::<f64>()).collect();
        let sign = if along.first().is_some_and(|&first| first < 0.0) { -1.0 } else { 1.0 };
        along.iter_mut().for_each(|share| *share *= sign);
        let mut rest = vec![sign * even; rows];
        for (c, share) in along.iter().enumerate() {
            rest.iter_mut().zip(column(c)).for_each(|(rest, u)| *rest -= share * u);
        }
        let squares: f64 = rest.iter().map(|value| value * value).sum();
        let is_new = squares > SUM_NEW_MIN;
        if is_new {
            rest.iter_mut().for_each(|value| *value /= squares.sqrt());
            along.push(squares.sqrt());
        }
        // The rotation by least that takes the first column to the sum.
        let turn: Vec<f64> = along.iter().map(|share| share / (1.0 + along[0])).collect();
        let mut u = Vec::with_capacity(rows * along.len());
        for (r, rest) in rest.into_iter().enumerate() {
            let old = self.u[r * self.rank..][..k].iter().map(|&u| f64::from(u));
            let old: Vec<f64> = old.chain(is_new.then_some(rest)).collect();
            let moved = old[0] + sign * even;
            u.push(even as f32);
            u.extend(old.iter().zip(&turn).skip(1).map(|(u, turn)| (u - turn * moved) as f32));
        }
        (along.len(), u)
    }
}

/// Share of the sum's direction that is worth a column of its own.
const SUM_NEW_MIN: f64 = 1e-8;
/// Columns sampled beyond the highest rank asked for.
const OVERSAMPLING: usize = 8;
/// Subspace iterations; singular values of transport fall fast, two suffice for the figures that we state.
const ITERATIONS: usize = 2;
/// Columns of `AᵀQ` that one thread sums at a time.
const COLUMN_BLOCK: usize = 256;
/// Rows of a tall matrix that one thread takes at a time.
const ROW_BLOCK: usize = 256;

/// Factors of the smallest rank k ≤ `rank_max` with `Σ_{i>k} s² ≤ error² Σ s²`; of `rank_max` where none suffices.
///
/// `seeds` holds one number per column, from the identity of its carrier of light.
pub fn factorise(a: &Matrix, rank_max: usize, error: f32, seeds: &[u64]) -> Factors {
    let energy: f64 = a.values.iter().map(|value| f64::from(*value) * f64::from(*value)).sum();
    if energy == 0.0 {
        return Factors::default();
    }
    let width = (rank_max + OVERSAMPLING).min(a.rows).min(a.columns);
    let q = range_of(a, width, seeds);
    // B = QᵀA, n × width as its transpose; BBᵀ = W S² Wᵀ; then U = QW and ΣVᵀ = WᵀB.
    let b = transpose_times(a, &q, width);
    let (squares, w) = symmetric_eigen(gram(&b, width), width);
    let mut rank = rank_max.min(width);
    let mut kept: f64 = squares[..rank].iter().sum();
    let left_out = |kept: f64| ((energy - kept).max(0.0) / energy).sqrt();
    while rank > 0 && left_out(kept - squares[rank - 1]) <= f64::from(error) {
        rank -= 1;
        kept -= squares[rank];
    }
    let sum = |squares: &[f64]| squares.iter().map(|square| square.sqrt()).sum::<f64>();
    let unknown_count = a.rows.min(a.columns) - width;
    let unknown_energy = (energy - squares.iter().sum::<f64>()).max(0.0);
    let total = sum(&squares) + (unknown_count as f64 * unknown_energy).sqrt();
    Factors {
        rank,
        s1_criterion_bound: (1.0 - (sum(&squares[..rank]) / total).sqrt()) as f32,
        u: times_small(&q, width, &w, rank),
        vt: transposed(&times_small(&b, width, &w, rank), rank),
        truncation_error: left_out(kept) as f32,
    }
}

/// An orthonormal basis, m × width, of nearly all of A's range.
fn range_of(a: &Matrix, width: usize, seeds: &[u64]) -> Vec<f32> {
    let mut right = vec![0.0; a.columns * width];
    for (row, seed) in right.chunks_exact_mut(width).zip(seeds) {
        let mut sequence = crate::rays::sampling::Sequence::new(*seed);
        // Uniform in −1..1: any distribution without a preferred direction serves.
        row.iter_mut().for_each(|value| *value = 2.0 * sequence.next_f32() - 1.0);
    }
    let mut left = times(a, &right, width);
    orthonormalise(&mut left, width);
    for _ in 0..ITERATIONS {
        // Not made orthonormal in between, on its long side: directions below σ₁·√ε are lost, far below any rank's error.
        right = transpose_times(a, &left, width);
        left = times(a, &right, width);
        orthonormalise(&mut left, width);
    }
    left
}

/// A X, m × width.
fn times(a: &Matrix, x: &[f32], width: usize) -> Vec<f32> {
    let mut product = vec![0.0; a.rows * width];
    product.par_chunks_exact_mut(width).zip(a.values.par_chunks_exact(a.columns)).for_each(|(out, row)| {
        for (value, x) in row.iter().zip(x.chunks_exact(width)) {
            if *value != 0.0 {
                out.iter_mut().zip(x).for_each(|(out, x)| *out += value * x);
            }
        }
    });
    product
}

/// Aᵀ X, n × width.
fn transpose_times(a: &Matrix, x: &[f32], width: usize) -> Vec<f32> {
    let mut product = vec![0.0; a.columns * width];
    product.par_chunks_mut(COLUMN_BLOCK * width).enumerate().for_each(|(block, out)| {
        let first = block * COLUMN_BLOCK;
        let count = out.len() / width;
        for (row, x) in a.values.chunks_exact(a.columns).zip(x.chunks_exact(width)) {
            for (value, out) in row[first..first + count].iter().zip(out.chunks_exact_mut(width)) {
                if *value != 0.0 {
                    out.iter_mut().zip(x).for_each(|(out, x)| *out += value * x);
                }
            }
        }
    });
    product
}

/// Makes the columns of a row-major matrix orthonormal: modified Gram–Schmidt, twice, sums in f64. Columns that
/// vanish become zero.
fn orthonormalise(x: &mut [f32], width: usize) {
    let rows = x.len() / width;
    let mut columns: Vec<Vec<f32>> =
        (0..width).map(|c| (0..rows).map(|r| x[r * width + c]).collect()).collect();
    for index in 0..width {
        let (done, rest) = columns.split_at_mut(index);
        let column = &mut rest[0];
        let before = dot(column, column).sqrt();
        for _ in 0..2 {
            for earlier in done.iter() {
                let share = dot(earlier, column) as f32;
                column.iter_mut().zip(earlier).for_each(|(value, earlier)| *value -= share * earlier);
            }
        }
        let length = dot(column, column).sqrt();
        let scale = if length > before * 1e-6 { (1.0 / length) as f32 } else { 0.0 };
        column.iter_mut().for_each(|value| *value *= scale);
    }
    for (index, column) in columns.iter().enumerate() {
        x.chunks_exact_mut(width).zip(column).for_each(|(row, value)| row[index] = *value);
    }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    // Four sums at once, always the same four: faster, and the order is still fixed.
    let mut sums = [0.0_f64; 4];
    for (a, b) in a.chunks(4).zip(b.chunks(4)) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += f64::from(*a) * f64::from(*b);
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

/// XᵀX of a row-major n × width matrix, in f64: blocks of rows apart, then their sum in order.
fn gram(x: &[f32], width: usize) -> Vec<f64> {
    let of_block = |block: &[f32]| {
        let mut gram = vec![0.0; width * width];
        for row in block.chunks_exact(width) {
            for (a, out) in row.iter().zip(gram.chunks_exact_mut(width)) {
                out.iter_mut().zip(row).for_each(|(out, b)| *out += f64::from(*a) * f64::from(*b));
            }
        }
        gram
    };
    let blocks: Vec<Vec<f64>> = x.par_chunks(ROW_BLOCK * width).map(of_block).collect();
    let mut sum = vec![0.0; width * width];
    blocks.iter().for_each(|block| sum.iter_mut().zip(block).for_each(|(sum, value)| *sum += value));
    sum
}

/// Eigenvalues, largest first, and eigenvectors as columns of a row-major matrix: cyclic Jacobi rotations.
fn symmetric_eigen(mut a: Vec<f64>, n: usize) -> (Vec<f64>, Vec<f64>) {
    let mut vectors = vec![0.0; n * n];
    (0..n).for_each(|i| vectors[i * n + i] = 1.0);
    let scale: f64 = (0..n).map(|i| a[i * n + i].abs()).sum::<f64>().max(f64::MIN_POSITIVE);
    for _ in 0..60 {
        let off: f64 =
            (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i * n + j].abs()).sum();
        if off <= scale * 1e-15 {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                rotate(&mut a, &mut vectors, n, p, q);
            }
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| a[j * n + j].total_cmp(&a[i * n + i]).then(i.cmp(&j)));
    let values = order.iter().map(|&i| a[i * n + i].max(0.0)).collect();
    let sorted = (0..n * n).map(|index| vectors[index / n * n + order[index % n]]).collect();
    (values, sorted)
}

/// One Jacobi rotation that makes `a[p][q]` zero.
fn rotate(a: &mut [f64], vectors: &mut [f64], n: usize, p: usize, q: usize) {
    let apq = a[p * n + q];
    if apq == 0.0 {
        return;
    }
    let theta = (a[q * n + q] - a[p * n + p]) / (2.0 * apq);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for k in 0..n {
        let (akp, akq) = (a[k * n + p], a[k * n + q]);
        a[k * n + p] = c * akp - s * akq;
        a[k * n + q] = s * akp + c * akq;
    }
    for k in 0..n {
        let (apk, aqk) = (a[p * n + k], a[q * n + k]);
        a[p * n + k] = c * apk - s * aqk;
        a[q * n + k] = s * apk + c * aqk;
        let (vkp, vkq) = (vectors[k * n + p], vectors[k * n + q]);
        vectors[k * n + p] = c * vkp - s * vkq;
        vectors[k * n + q] = s * vkp + c * vkq;
    }
}

/// X W[:, ..rank] for row-major X (rows × width) and W (width × width): rows × rank.
fn times_small(x: &[f32], width: usize, w: &[f64], rank: usize) -> Vec<f32> {
    if rank == 0 {
        return Vec::new();
    }
    let mut product = vec![0.0; x.len() / width * rank];
    let blocks = product.par_chunks_mut(ROW_BLOCK * rank).zip(x.par_chunks(ROW_BLOCK * width));
    blocks.for_each(|(out, x)| {
        let mut sums = vec![0.0; rank];
        for (out, row) in out.chunks_exact_mut(rank).zip(x.chunks_exact(width)) {
            sums.fill(0.0);
            for (value, w) in row.iter().zip(w.chunks_exact(width)) {
                sums.iter_mut().zip(w).for_each(|(sum, w)| *sum += f64::from(*value) * w);
            }
            out.iter_mut().zip(&sums).for_each(|(out, sum)| *out = *sum as f32);
        }
    });
    product
}

/// Row-major n × rank to rank × n.
fn transposed(x: &[f32], rank: usize) -> Vec<f32> {
    if rank == 0 {
        return Vec::new();
    }
    let rows = x.len() / rank;
    (0..x.len()).map(|index| x[index % rows * rank + index / rows]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::{Sequence, seed_of};

    /// A matrix with singular values 2⁻ⁱ and some noise.
    fn decaying(rows: usize, columns: usize) -> Matrix {
        let mut sequence = Sequence::new(11);
        let mut random = |count: usize| (0..count).map(|_| sequence.next_f32() - 0.5).collect::<Vec<_>>();
        let (mut left, mut right) = (random(rows * 12), random(columns * 12));
        orthonormalise(&mut left, 12);
        orthonormalise(&mut right, 12);
        let mut values = vec![0.0; rows * columns];
        for (r, row) in values.chunks_exact_mut(columns).enumerate() {
            for (c, value) in row.iter_mut().enumerate() {
                *value = (0..12).map(|i| left[r * 12 + i] * right[c * 12 + i] * 0.5_f32.powi(i as i32)).sum();
            }
        }
        Matrix { rows, columns, values }
    }

    fn seeds(columns: usize) -> Vec<u64> {
        (0..columns as u64).map(|column| seed_of(&[column])).collect()
    }

    fn reconstruction_error(a: &Matrix, factors: &Factors) -> f64 {
        let (mut error, mut energy) = (0.0, 0.0);
        for r in 0..a.rows {
            for c in 0..a.columns {
                let value: f32 = (0..factors.rank)
                    .map(|i| factors.u[r * factors.rank + i] * factors.vt[i * a.columns + c])
                    .sum();
                error += f64::from(value - a.values[r * a.columns + c]).powi(2);
                energy += f64::from(a.values[r * a.columns + c]).powi(2);
            }
        }
        (error / energy).sqrt()
    }

    #[test]
    fn smallest_rank_within_the_error_is_found_and_its_error_is_stated() {
        let a = decaying(200, 300);
        for wanted in [0.3, 0.05, 0.01] {
            let factors = factorise(&a, 32, wanted, &seeds(300));
            // Tail of a geometric series of squares with ratio ¼: error at rank k is 2⁻ᵏ.
            let expected: i32 = (1..=12).find(|k| 0.5_f32.powi(*k) <= wanted * 1.0001).unwrap();
            assert_eq!(factors.rank, expected as usize, "error {wanted}");
            let measured = reconstruction_error(&a, &factors);
            assert!((measured - f64::from(factors.truncation_error)).abs() < 1e-3, "{measured} {factors:?}");
            assert!(measured <= f64::from(wanted) * 1.001);
            let (kept, all) = (2.0 - 0.5_f32.powi(expected - 1), 2.0 - 0.5_f32.powi(11));
            let criterion = 1.0 - (kept / all).sqrt();
            assert!(factors.s1_criterion_bound >= criterion - 1e-4, "{factors:?} {criterion}");
            assert!(factors.s1_criterion_bound <= criterion + 0.01, "{factors:?} {criterion}");
        }
    }

    #[test]
    fn the_sum_over_rows_is_the_first_column_of_a_basis_of_the_same_span() {
        let a = decaying(30, 50);
        let factors = factorise(&a, 8, 0.0, &seeds(50));
        for k in [0, 1, 8] {
            let (rank, u) = factors.with_sum(k, 30);
            assert_eq!(rank, k + 1);
            let column = |u: &[f32], rank: usize, c: usize| -> Vec<f64> {
                u.iter().skip(c).step_by(rank).map(|&value| f64::from(value)).collect()
            };
            let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
            let basis: Vec<Vec<f64>> = (0..rank).map(|c| column(&u, rank, c)).collect();
            assert!(basis[0].iter().all(|&value| value == basis[0][0] && value > 0.0), "{:?}", basis[0]);
            for (i, a) in basis.iter().enumerate() {
                for (j, b) in basis.iter().enumerate() {
                    assert!((dot(a, b) - f64::from(u8::from(i == j))).abs() < 1e-5, "columns {i} and {j}");
                }
            }
            for c in 0..k {
                let old = column(&factors.u, factors.rank, c);
                let held: f64 = basis.iter().map(|column| dot(column, &old).powi(2)).sum();
                assert!((held - 1.0).abs() < 1e-5, "column {c} is in the span: {held}");
            }
        }
    }

    #[test]
    fn too_low_a_rank_says_how_far_it_is_off() {
        let factors = factorise(&decaying(100, 100), 2, 0.01, &seeds(100));
        assert_eq!(factors.rank, 2);
        assert!((factors.truncation_error - 0.25).abs() < 0.01, "{}", factors.truncation_error);
    }

    #[test]
    fn zeros_have_rank_zero_and_small_shapes_work() {
        let zero = Matrix { rows: 3, columns: 5, values: vec![0.0; 15] };
        assert_eq!(factorise(&zero, 32, 0.01, &seeds(5)), Factors::default());
        let single = Matrix { rows: 1, columns: 3, values: vec![3.0, 0.0, 4.0] };
        let factors = factorise(&single, 32, 0.01, &seeds(3));
        assert_eq!(factors.rank, 1);
        assert!(reconstruction_error(&single, &factors) < 1e-5);
    }

    #[test]
    fn result_is_the_same_on_one_and_on_four_threads() {
        let a = decaying(300, 700);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| factorise(&a, 16, 0.001, &seeds(700)))
        };
        assert_eq!(on(1), on(4));
    }
}
