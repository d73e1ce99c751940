//! Error figures of a set of receivers, the reference's own noise subtracted.

use glam::DVec3;
use serde::Serialize;

use crate::reference::{Estimate, luminance};

/// One receiver's light by two ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Weight: the area that it stands for, in m².
    pub area_m2: f64,
    /// Irradiance to be judged, W·m⁻².
    pub found: DVec3,
    /// Irradiance that it is held against, and how sure that is.
    pub reference: Estimate,
}

/// Figures over receivers, weighted by area. Errors are relative to the mean of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Root mean square error of luminance, the reference's variance subtracted.
    pub rel_rmse: f64,
    /// Energy found over energy of the reference.
    pub energy_ratio: f64,
    /// 95th percentile of the absolute error of luminance; holds the reference's noise.
    pub p95: f64,
    /// 99th percentile, likewise.
    pub p99: f64,
    /// Root mean square error per channel over the channel's own mean: red, green, blue.
    pub channels: [f64; 3],
    /// Energy ratio per channel.
    pub channel_energy_ratios: [f64; 3],
    /// Root mean square of the reference's standard errors.
    pub reference_rel_error: f64,
    /// Mean luminance of the reference, W·m⁻².
    pub mean_irradiance: f64,
}

impl Figures {
    /// Sums up; all zero where the reference is dark everywhere.
    pub fn of(pairs: &[Pair]) -> Self {
        let all = Moments::of(pairs, |pair| {
            (luminance(pair.found), pair.reference.luminance(), pair.reference.luminance_error)
        });
        let channels = [0, 1, 2].map(|c| {
            Moments::of(pairs, |pair| (pair.found[c], pair.reference.mean[c], pair.reference.error[c]))
        });
        if all.mean <= 0.0 {
            return Self::default();
        }
        let mut errors: Vec<(f64, f64)> = pairs
            .iter()
            .map(|pair| ((luminance(pair.found) - pair.reference.luminance()).abs() / all.mean, pair.area_m2))
            .collect();
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            rel_rmse: all.rel_rmse(),
            energy_ratio: all.energy_ratio(),
            p95: quantile(&errors, 0.95),
            p99: quantile(&errors, 0.99),
            channels: channels.map(|channel| channel.rel_rmse()),
            channel_energy_ratios: channels.map(|channel| channel.energy_ratio()),
            reference_rel_error: all.noise.sqrt() / all.mean,
            mean_irradiance: all.mean,
        }
    }
}

/// Area-weighted means of one quantity.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    found: f64,
    mean: f64,
    squared_error: f64,
    noise: f64,
}

impl Moments {
    fn of(pairs: &[Pair], values: impl Fn(&Pair) -> (f64, f64, f64)) -> Self {
        let total: f64 = pairs.iter().map(|pair| pair.area_m2).sum();
        let mut moments = Self::default();
        for pair in pairs {
            let (found, reference, error) = values(pair);
            let weight = pair.area_m2 / total;
            moments.found += weight * found;
            moments.mean += weight * reference;
            moments.squared_error += weight * (found - reference).powi(2);
            moments.noise += weight * error * error;
        }
        moments
    }

    fn rel_rmse(&self) -> f64 {
        if self.mean > 0.0 { (self.squared_error - self.noise).max(0.0).sqrt() / self.mean } else { 0.0 }
    }

    fn energy_ratio(&self) -> f64 {
        if self.mean > 0.0 { self.found / self.mean } else { 0.0 }
    }
}

/// The smallest error that errors of at least `share` of the area do not exceed; `sorted` holds (error, area).
fn quantile(sorted: &[(f64, f64)], share: f64) -> f64 {
    let total: f64 = sorted.iter().map(|(_, area)| area).sum();
    let mut below = 0.0;
    for (error, area) in sorted {
        below += area;
        if below >= share * total {
            return *error;
        }
    }
    sorted.last().map_or(0.0, |(error, _)| *error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::Sequence;

    fn pair(area_m2: f64, found: f64, reference: f64, error: f64) -> Pair {
        let splat = DVec3::splat;
        let reference = Estimate { mean: splat(reference), error: splat(error), luminance_error: error };
        Pair { area_m2, found: splat(found), reference }
    }

    #[test]
    fn figures_weigh_by_area_and_are_relative_to_the_mean_of_the_reference() {
        // Means: reference (3·1 + 1·5)/4 = 2, found (3·1.2 + 5)/4 = 2.15; squared error 3/4·0.04 = 0.03.
        let figures = Figures::of(&[pair(3.0, 1.2, 1.0, 0.0), pair(1.0, 5.0, 5.0, 0.0)]);
        assert!((figures.mean_irradiance - 2.0).abs() < 1e-9);
        assert!((figures.rel_rmse - 0.03_f64.sqrt() / 2.0).abs() < 1e-9, "{figures:?}");
        assert!((figures.energy_ratio - 1.075).abs() < 1e-9);
        assert!((figures.p95 - 0.1).abs() < 1e-9 && (figures.channels[2] - figures.rel_rmse).abs() < 1e-9);
        assert_eq!(Figures::of(&[pair(1.0, 1.0, 0.0, 0.0)]).rel_rmse, 0.0);
    }

    #[test]
    fn noise_of_the_reference_is_not_counted_as_error() {
        let mut random = Sequence::new(4);
        let pairs: Vec<Pair> = (0..20_000)
            .map(|_| {
                // Uniform in ±0.3 has a standard deviation of 0.3/√3; the true error is 0.1 throughout.
                let noise = f64::from(2.0 * random.next_f32() - 1.0) * 0.3;
                pair(1.0, 1.1, 1.0 + noise, 0.3 / 3.0_f64.sqrt())
            })
            .collect();
        let figures = Figures::of(&pairs);
        assert!((figures.rel_rmse - 0.1).abs() < 0.01, "{figures:?}");
        assert!((figures.reference_rel_error - 0.1732).abs() < 0.005);
    }
}
