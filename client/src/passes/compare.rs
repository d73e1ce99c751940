//! Compares arrays of the adapter with those of the reference, in linear f32.

use std::fmt;

use glam::Vec4;

/// Difference of two arrays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Values compared.
    pub count: usize,
    /// Mean absolute value of the reference; differences are relative to `scale`.
    pub mean: f32,
    /// Value to which differences are relative.
    pub scale: f32,
    /// Largest relative difference.
    pub largest: f32,
    /// Share of values that differ by more than the tolerance, or are no numbers.
    pub outliers: f32,
}

impl Difference {
    /// Compares rgb of `got` with `reference`, relative to the reference's largest value; arrays of unequal length
    /// differ everywhere.
    pub fn of(got: &[Vec4], reference: &[Vec4], tolerance: f32) -> Self {
        let largest = reference.iter().map(|value| value.truncate().abs().max_element()).fold(0.0, f32::max);
        Self::relative_to(largest, got, reference, tolerance)
    }

    /// Compares relative to the reference's mean instead.
    pub fn of_mean(got: &[Vec4], reference: &[Vec4], tolerance: f32) -> Self {
        let mean = mean(reference);
        Self::relative_to(mean, got, reference, tolerance)
    }

    fn relative_to(scale: f32, got: &[Vec4], reference: &[Vec4], tolerance: f32) -> Self {
        let scale = scale.max(f32::MIN_POSITIVE);
        let nowhere = got.len() != reference.len();
        let (mut largest, mut outliers) = (0.0_f32, 0_usize);
        for (got, reference) in got.iter().zip(reference) {
            let difference = (*got - *reference).truncate().abs().max_element() / scale;
            let is_number = got.truncate().is_finite();
            largest = largest.max(if is_number { difference } else { f32::INFINITY });
            outliers += usize::from(!is_number || difference > tolerance);
        }
        let share = outliers as f32 / reference.len().max(1) as f32;
        Self {
            count: reference.len(),
            mean: mean(reference),
            scale,
            largest: if nowhere { f32::INFINITY } else { largest },
            outliers: if nowhere { 1.0 } else { share },
        }
    }

    /// Whether something was compared, it was not all black, and at most `outliers` of it differ too much.
    pub fn agrees(&self, outliers: f32) -> bool {
        self.count > 0 && self.mean > 0.0 && self.outliers <= outliers
    }
}

fn mean(values: &[Vec4]) -> f32 {
    let sum: f64 = values.iter().map(|value| f64::from(value.truncate().abs().element_sum()) / 3.0).sum();
    (sum / values.len().max(1) as f64) as f32
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} values, mean {:.4e}, largest difference {:.3e} of {:.3e}, outliers {:.4} %",
            self.count,
            self.mean,
            self.largest,
            self.scale,
            100.0 * self.outliers
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comparator_fails_when_it_should() {
        let reference = vec![Vec4::ONE; 100];
        assert!(Difference::of(&reference, &reference, 1e-6).agrees(0.0));
        let mut off = reference.clone();
        off[7].y += 0.01;
        assert!(!Difference::of(&off, &reference, 1e-3).agrees(0.0));
        assert!(Difference::of(&off, &reference, 1e-3).agrees(0.01));
        off[7].y = f32::NAN;
        assert!(!Difference::of(&off, &reference, 1e-3).agrees(0.0));
        assert!(!Difference::of(&reference[1..], &reference, 1.0).agrees(0.5));
        assert!(!Difference::of(&[], &[], 1.0).agrees(1.0));
        let black = vec![Vec4::ZERO; 4];
        assert!(!Difference::of(&black, &black, 1.0).agrees(1.0));
        assert!(!Difference::of_mean(&black, &reference, 1e-2).agrees(0.5));
    }
}
