//! Whole-number codes for the factors U and ΣVᵀ, at the coarsest step that keeps the product within a stated error.
//!
//! With orthonormal columns in U, an error in U's column i weighs σ_i = ‖(ΣVᵀ)_i‖ and an error in ΣVᵀ's row i weighs
//! ‖U_i‖ = 1. Codes of one step Δ in those weighted units spend bits where they count: the steps are
//! `s_u[i] = 1.5 Δ/‖(ΣVᵀ)_i‖` and `s_v[i] = Δ/((1 + c_i) ‖U_i‖)`, so that strong ranks get many levels and weak ones few. c_i is 1
//! where U's column is alike in all rows and 0 where its sum is 0. Δ is found by search; the error is measured on the numbers
//! that a decoder will have.

use super::error::{ChunkError, all_finite, all_numbers};

/// Smallest relative error that can be asked for.
pub const RELATIVE_ERROR_MIN: f32 = 1.0e-4;
/// Largest relative error that can be asked for.
pub const RELATIVE_ERROR_MAX: f32 = 0.5;
/// Largest step: no code times it overflows.
pub(super) const STEP_MAX: f32 = 1.0e28;
/// A step is good enough when its error is at least this share of the error allowed.
const CLOSE_ENOUGH: f64 = 0.97;
/// Step of U over that of ΣVᵀ in weighted units: U's numbers are all large, most of ΣVᵀ's are worth no code.
const U_SHARE: f64 = 1.5;
/// Steps tried while the error is not close enough.
const TRIES: usize = 8;
/// Steps tried while the error is too large; each at most nine tenths of the one before.
const TRIES_MAX: usize = 400;

/// The factors as they are stored.
#[derive(Clone, Debug, Default)]
pub(super) struct Quantised {
    /// Codes of U, rank-major: `u[i·R + r]`.
    pub u: Vec<i32>,
    /// Codes of ΣVᵀ, rank-major: `vt[i·n + column]`.
    pub vt: Vec<i32>,
    /// Steps s_u, one per rank.
    pub u_step: Vec<f32>,
    /// Steps s_v, one per rank.
    pub vt_step: Vec<f32>,
    /// `‖U·ΣVᵀ − decoded‖/‖U·ΣVᵀ‖` (Frobenius), measured.
    pub relative_error: f64,
}

/// Quantises factors, both rank-major: `u` is k × R, `vt` is k × n.
pub(super) fn quantise(
    u: &[f32],
    vt: &[f32],
    rank: usize,
    relative_error: f32,
) -> Result<Quantised, ChunkError> {
    all_finite("encoder", "U", u)?;
    all_finite("encoder", "ΣVᵀ", vt)?;
    let target = f64::from(relative_error.clamp(RELATIVE_ERROR_MIN, RELATIVE_ERROR_MAX));
    let (rows, columns) = (u.len() / rank.max(1), vt.len() / rank.max(1));
    let norm = product_norm(&rank_rows(u, rows), &rank_rows(vt, columns));
    if norm == 0.0 {
        let zeros = vec![0.0; rank];
        let (u_step, vt_step) = (zeros.clone(), zeros);
        return Ok(Quantised {
            u: vec![0; u.len()],
            vt: vec![0; vt.len()],
            u_step,
            vt_step,
            relative_error: 0.0,
        });
    }
    let weights = |factor: &[f32], length: usize| -> Vec<f64> {
        factor.chunks_exact(length).map(|row| dot(row, row).sqrt()).collect()
    };
    let shape = Shape {
        u_norm: weights(u, rows),
        vt_norm: weights(vt, columns),
        finer: u.chunks_exact(rows).map(|column| 1.0 + common(column)).collect(),
        only: u.chunks_exact(rows).map(only_value).collect(),
    };
    let first_step = norm * target * (12.0 / (u.len() + vt.len()) as f64).sqrt();
    let at = |step: f64| {
        let mut codes = at_step(u, vt, &shape, step);
        codes.relative_error = product_error(u, vt, &codes, rank) / norm;
        codes
    };
    let codes = search(first_step, target, at).ok_or(ChunkError::BadNumber {
        section: "encoder",
        what: "quantisation error",
        index: 0,
        value: relative_error,
        wanted: "an error that some step meets",
    })?;
    for steps in [&codes.u_step, &codes.vt_step] {
        all_numbers("encoder", "step", steps, "0..=1e28", |step| (0.0..=STEP_MAX).contains(&step))?;
    }
    Ok(codes)
}

/// The largest step found whose error is within `target`.
fn search(first_step: f64, target: f64, at: impl Fn(f64) -> Quantised) -> Option<Quantised> {
    let (mut step, mut best, mut too_large) = (first_step, None, f64::INFINITY);
    for attempt in 0..TRIES_MAX {
        let codes = at(step);
        let error = codes.relative_error;
        if error <= target {
            best = Some(codes);
            if error >= CLOSE_ENOUGH * target {
                break;
            }
            let grown = step * (0.99 * target / error).min(8.0);
            step = if grown < too_large { grown } else { (step * too_large).sqrt() };
        } else {
            too_large = step;
            step *= (0.98 * target / error).clamp(0.1, 0.9);
        }
        if best.is_some() && attempt >= TRIES {
            break;
        }
    }
    best
}

/// What steps hang on, of each rank.
struct Shape {
    /// ‖U_i‖.
    u_norm: Vec<f64>,
    /// ‖(ΣVᵀ)_i‖.
    vt_norm: Vec<f64>,
    /// 1 + c_i: how much finer the steps of ΣVᵀ are.
    finer: Vec<f32>,
    /// The one value of U's column: it is exact, with one code.
    only: Vec<Option<f32>>,
}

/// Codes at step Δ.
fn at_step(u: &[f32], vt: &[f32], shape: &Shape, step: f64) -> Quantised {
    let steps = |weights: &[f64], step: f64| -> Vec<f32> {
        weights.iter().map(|&weight| if weight > 0.0 { (step / weight) as f32 } else { 0.0 }).collect()
    };
    let (mut u_step, mut vt_step) = (steps(&shape.vt_norm, U_SHARE * step), steps(&shape.u_norm, step));
    u_step.iter_mut().zip(&shape.only).for_each(|(step, only)| *step = only.unwrap_or(*step));
    vt_step.iter_mut().zip(&shape.finer).for_each(|(step, finer)| *step /= finer);
    let (u, vt) = (codes(u, &mut u_step), codes(vt, &mut vt_step));
    Quantised { u, vt, u_step, vt_step, relative_error: 0.0 }
}

/// How far a column of U is alike in all rows that it reaches: 1 where they have one value, 0 where their sum is 0. Errors of such
/// a rank are errors of the cluster's energy, and go on from bounce to bounce where others' cancel.
fn common(column: &[f32]) -> f32 {
    let (mut sum, mut squares, mut count) = (0.0_f64, 0.0_f64, 0_u32);
    for value in column.iter().map(|&value| f64::from(value)).filter(|&value| value != 0.0) {
        (sum, squares, count) = (sum + value, squares + value * value, count + 1);
    }
    if count == 0 { 0.0 } else { (sum * sum / (squares * f64::from(count))) as f32 }
}

/// The value, above 0, that all of a column's rows have but those where it is 0.
fn only_value(column: &[f32]) -> Option<f32> {
    let first = *column.iter().find(|value| **value != 0.0)?;
    (first > 0.0 && column.iter().all(|&value| value == 0.0 || value == first)).then_some(first)
}

/// Codes of rank-major numbers; a rank whose codes are all zero has step 0.
fn codes(factor: &[f32], steps: &mut [f32]) -> Vec<i32> {
    let length = factor.len() / steps.len();
    let mut codes = Vec::with_capacity(factor.len());
    for (row, step) in factor.chunks_exact(length.max(1)).zip(steps) {
        let first = codes.len();
        codes.extend(row.iter().map(|&value| code(value, *step)));
        if codes[first..].iter().all(|&code| code == 0) {
            *step = 0.0;
        }
    }
    codes
}

/// Nearest code.
fn code(value: f32, step: f32) -> i32 {
    if step == 0.0 { 0 } else { libm::round(f64::from(value) / f64::from(step)) as i32 }
}

/// The number that a decoder makes of a code.
pub(super) fn value(code: i32, step: f32) -> f32 {
    code as f32 * step
}

fn rank_rows(factor: &[f32], length: usize) -> Vec<Vec<f32>> {
    factor.chunks_exact(length.max(1)).map(<[f32]>::to_vec).collect()
}

/// ‖U·V‖ of rank-major factors: `√ Σ_ab (UᵀU)_ab (VVᵀ)_ab`, without forming the product.
fn product_norm(u: &[Vec<f32>], v: &[Vec<f32>]) -> f64 {
    let mut sum = 0.0;
    for a in 0..u.len() {
        for b in 0..=a {
            let twice = if a == b { 1.0 } else { 2.0 };
            sum += twice * dot(&u[a], &u[b]) * dot(&v[a], &v[b]);
        }
    }
    sum.max(0.0).sqrt()
}

/// ‖U·V − Û·V̂‖ as the norm of `[U − Û, Û] · [V; V − V̂]`.
fn product_error(u: &[f32], vt: &[f32], codes: &Quantised, rank: usize) -> f64 {
    let (rows, columns) = (u.len() / rank, vt.len() / rank);
    let decode = |codes: &[i32], steps: &[f32], length: usize| -> Vec<Vec<f32>> {
        let rows = codes.chunks_exact(length).zip(steps);
        rows.map(|(row, &step)| row.iter().map(|&code| value(code, step)).collect()).collect()
    };
    let minus = |a: &[Vec<f32>], b: &[Vec<f32>]| -> Vec<Vec<f32>> {
        a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect()
    };
    let (exact_u, exact_vt) = (rank_rows(u, rows), rank_rows(vt, columns));
    let (coded_u, coded_vt) =
        (decode(&codes.u, &codes.u_step, rows), decode(&codes.vt, &codes.vt_step, columns));
    let left = [minus(&exact_u, &coded_u), coded_u].concat();
    let right_error = minus(&exact_vt, &coded_vt);
    product_norm(&left, &[exact_vt, right_error].concat())
}

/// `Σ a·b` in f64, in eight lanes of fixed order.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut lanes = [0.0_f64; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest = a_chunks.remainder().iter().zip(b_chunks.remainder());
    let tail: f64 = rest.map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
    for (a, b) in a_chunks.zip(b_chunks) {
        for lane in 0..8 {
            lanes[lane] += f64::from(a[lane]) * f64::from(b[lane]);
        }
    }
    lanes.iter().sum::<f64>() + tail
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(count: usize, scale: f32) -> Vec<f32> {
        (0..count).map(|i| scale * libm::sinf(i as f32 * 0.7 + 0.1 * (i * i % 17) as f32)).collect()
    }

    fn product(u: &[f32], vt: &[f32], rank: usize) -> Vec<f64> {
        let (rows, columns) = (u.len() / rank, vt.len() / rank);
        let entry = |r: usize, c: usize| -> f64 {
            (0..rank).map(|i| f64::from(u[i * rows + r]) * f64::from(vt[i * columns + c])).sum()
        };
        (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))).map(|(r, c)| entry(r, c)).collect()
    }

    #[test]
    fn measured_error_is_the_error_of_the_product_and_within_the_target() {
        let (u, vt) = (wave(3 * 20, 0.3), wave(3 * 50, 2.0));
        for target in [0.1, 0.01, 0.001] {
            let codes = quantise(&u, &vt, 3, target).unwrap();
            let decode = |codes: &[i32], steps: &[f32]| -> Vec<f32> {
                let length = codes.len() / 3;
                codes.iter().enumerate().map(|(i, &code)| value(code, steps[i / length])).collect()
            };
            let exact = product(&u, &vt, 3);
            let coded = product(&decode(&codes.u, &codes.u_step), &decode(&codes.vt, &codes.vt_step), 3);
            let square = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>();
            let error = square(&mut exact.iter().zip(&coded).map(|(a, b)| a - b))
                / square(&mut exact.iter().copied());
            assert!((error.sqrt() - codes.relative_error).abs() < 1e-4 * f64::from(target), "{error}");
            assert!(codes.relative_error <= f64::from(target));
            assert!(codes.relative_error >= 0.8 * f64::from(target), "{}", codes.relative_error);
        }
    }

    #[test]
    fn what_all_rows_share_keeps_its_sum() {
        // Small numbers beside a few large ones in the rank that all rows share, and as much in another.
        let rows = 24;
        let even = 1.0 / libm::sqrtf(rows as f32);
        let alternating: Vec<f32> = (0..rows).map(|row| if row % 2 == 0 { even } else { -even }).collect();
        let u = [vec![even; rows], alternating].concat();
        let small = |column: usize| 0.02 * (column as f32 * 0.618).fract();
        let of_rank: Vec<f32> = (0..400).map(|column| if column < 8 { 1.0 } else { small(column) }).collect();
        let vt = [of_rank.clone(), of_rank.clone()].concat();
        let codes = quantise(&u, &vt, 2, 0.08).unwrap();
        assert!(codes.u[..rows].iter().all(|&code| code == 1) && codes.u_step[0] == even);
        let sum_of = |rank: usize| -> f32 {
            codes.vt[rank * 400..][..400].iter().map(|&code| value(code, codes.vt_step[rank])).sum()
        };
        let exact: f32 = of_rank.iter().sum();
        assert!((sum_of(0) / exact - 1.0).abs() < 0.1, "{} of {exact}", sum_of(0));
        assert!(sum_of(1) < 0.8 * exact, "the other rank's are worth no code: {} of {exact}", sum_of(1));
    }

    #[test]
    fn nothing_stays_exactly_nothing() {
        let codes = quantise(&[0.0; 8], &wave(10, 1.0), 2, 0.003).unwrap();
        assert!(codes.u.iter().chain(&codes.vt).all(|&code| code == 0));
        assert_eq!(codes.relative_error, 0.0);
        assert!(quantise(&[], &[], 0, 0.003).unwrap().u.is_empty());
        assert!(quantise(&[f32::NAN], &[1.0], 1, 0.003).is_err());
    }
}
