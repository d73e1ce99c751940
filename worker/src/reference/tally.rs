//! Means with their standard errors, from batches of samples.

use glam::DVec3;

/// Luminance Y of a linear Rec.709 colour.
pub fn luminance(colour: DVec3) -> f64 {
    colour.dot(DVec3::new(0.2126, 0.7152, 0.0722))
}

/// A mean and how sure it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Linear Rec.709.
    pub mean: DVec3,
    /// Standard error of the mean, per channel.
    pub error: DVec3,
    /// Standard error of the mean's luminance; channels vary together, so it does not follow from theirs.
    pub luminance_error: f64,
}

impl Estimate {
    /// A value that is known exactly.
    pub fn exact(mean: DVec3) -> Self {
        Self { mean, ..Self::default() }
    }

    /// Luminance of the mean.
    pub fn luminance(&self) -> f64 {
        luminance(self.mean)
    }
}

/// Running mean and squared deviations of batch means (\[Welford1962\]): r, g, b, luminance.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    count: u32,
    mean: [f64; 4],
    squares: [f64; 4],
}

impl Tally {
    /// Adds a batch's mean.
    pub fn add(&mut self, batch: DVec3) {
        self.count += 1;
        let values = [batch.x, batch.y, batch.z, luminance(batch)];
        for (index, value) in values.into_iter().enumerate() {
            let before = value - self.mean[index];
            self.mean[index] += before / f64::from(self.count);
            self.squares[index] += before * (value - self.mean[index]);
        }
    }

    /// Batches added.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// The mean and its error: √(Σ(x − x̄)² / (n(n − 1))).
    pub fn estimate(&self) -> Estimate {
        self.estimate_beside([0.0; 4], 0.0)
    }

    /// The mean and its error, the variance of batches known beforehand as `prior`, from so many of them:
    /// √((Σ(x − x̄)² + m v) / (n(n − 1 + m))).
    pub fn estimate_beside(&self, prior: [f64; 4], prior_batches: f64) -> Estimate {
        let count = f64::from(self.count);
        let divisor = (count * (count - 1.0 + prior_batches)).max(1.0);
        let error: [f64; 4] = std::array::from_fn(|channel| {
            ((self.squares[channel] + prior_batches * prior[channel]) / divisor).sqrt()
        });
        Estimate {
            mean: DVec3::new(self.mean[0], self.mean[1], self.mean[2]),
            error: DVec3::new(error[0], error[1], error[2]),
            luminance_error: error[3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_of_the_mean_is_the_textbook_one() {
        let mut tally = Tally::default();
        for value in [1.0, 2.0, 3.0, 6.0] {
            tally.add(DVec3::splat(value));
        }
        let estimate = tally.estimate();
        // Mean 3, Σ(x − 3)² = 4 + 1 + 0 + 9 = 14, error √(14/12).
        assert!((estimate.mean.x - 3.0).abs() < 1e-12);
        assert!((estimate.error.y - (14.0_f64 / 12.0).sqrt()).abs() < 1e-12);
        assert!((estimate.luminance_error - estimate.error.x).abs() < 1e-9);
    }
}
