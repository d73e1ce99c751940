//! Error figures over places, with intervals: the noise of the reference cancels in squares, and is in every interval.

use glam::DVec3;
use serde::Serialize;

use crate::rays::sampling::Sequence;
use crate::reference::{IrradianceEstimate, luminance};

/// Draws of places with replacement that intervals are read from (\[Efron1979\]).
const RESAMPLES: usize = 500;
/// Seed of the draws: the same for all lights, so that those of all lights together are joint.
const SEED: u64 = 0x626f_6f74;
/// Errors, over the light of their own place, whose share of the area is told.
const LOCAL_ERRORS: [f64; 3] = [0.1, 0.25, 0.5];
/// Least light of a place, over the mean, that its error is held against.
const LOCAL_LIGHT_MIN: f64 = 0.01;
/// A light is measured if the mean of the reference is at least this share of itself in 97.5 % of the draws.
const MEAN_SHARE_MIN: f64 = 0.5;

/// One place's light by two ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Weight: the area that it stands for, in m².
    pub area_m2: f64,
    /// Irradiance to be judged, W·m⁻².
    pub found: DVec3,
    /// Irradiance that it is held against.
    pub reference: IrradianceEstimate,
}

/// Figures over places, weighted by area. Errors are relative to the mean of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Root mean square error of luminance. Squares are products of the errors against two independent halves of the
    /// reference, whose noise cancels in the mean; where they sum up to less than 0, the error is lost in the noise and
    /// this is minus the root of their absolute value.
    pub rel_rmse: f64,
    /// Energy found over energy of the reference.
    pub energy_ratio: f64,
    /// 95th percentile of the absolute error of luminance; holds the reference's noise.
    pub p95: f64,
    /// 99th percentile, likewise.
    pub p99: f64,
    /// 95 % intervals of these four.
    pub interval_95: Intervals,
    /// Shares of the area whose error is above 10, 25 and 50 % of the light at its own place; hold the reference's noise.
    pub area_above: [f64; 3],
    /// Root mean square error per channel over the channel's own mean: red, green, blue.
    pub channels: [f64; 3],
    /// Energy ratio per channel.
    pub channel_energy_ratios: [f64; 3],
    /// Root mean square of the reference's standard errors.
    pub reference_rel_error: f64,
    /// Mean luminance of the reference, W·m⁻².
    pub mean_irradiance: f64,
}

/// Lower and upper ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Intervals {
    /// Of [`Figures::rel_rmse`].
    pub rel_rmse: [f64; 2],
    /// Of [`Figures::energy_ratio`].
    pub energy_ratio: [f64; 2],
    /// Of [`Figures::p95`].
    pub p95: [f64; 2],
    /// Of [`Figures::p99`].
    pub p99: [f64; 2],
}

/// The figures that have intervals, of one draw of places.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Draw {
    square: f64,
    energy_ratio: f64,
    p95: f64,
    p99: f64,
    mean: f64,
}

impl Draw {
    /// Mean over lights: squares and percentiles as squares, energies as they are.
    fn over_lights<'a>(draws: impl Iterator<Item = &'a Self>) -> Self {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for draw in draws {
            sum.square += draw.square;
            sum.energy_ratio += draw.energy_ratio;
            sum.p95 += draw.p95 * draw.p95;
            sum.p99 += draw.p99 * draw.p99;
            count += 1.0;
        }
        Self {
            square: sum.square / count,
            energy_ratio: sum.energy_ratio / count,
            p95: (sum.p95 / count).sqrt(),
            p99: (sum.p99 / count).sqrt(),
            mean: 0.0,
        }
    }
}

impl Intervals {
    fn of(draws: &[Draw]) -> Self {
        let ends = |value: fn(&Draw) -> f64| {
            let mut values: Vec<f64> = draws.iter().map(value).collect();
            values.sort_by(f64::total_cmp);
            [0.025, 0.975].map(|share| at_share(&values, share))
        };
        Self {
            rel_rmse: ends(|draw| signed_root(draw.square)),
            energy_ratio: ends(|draw| draw.energy_ratio),
            p95: ends(|draw| draw.p95),
            p99: ends(|draw| draw.p99),
        }
    }
}

impl Figures {
    /// Sums up; all zero where the reference is dark everywhere. Beside the figures, those of draws of the places: as many
    /// for every set of pairs, the same places in each.
    pub fn of(pairs: &[Pair]) -> (Self, Vec<Draw>) {
        let terms = Terms::of(pairs);
        let everything: Vec<u32> = (0..pairs.len() as u32).collect();
        let whole = terms.draw(&everything);
        if whole.mean <= 0.0 {
            return (Self::default(), vec![Draw::default(); RESAMPLES]);
        }
        let draws: Vec<Draw> = drawn(pairs.len()).map(|places| terms.draw(&places)).collect();
        let channels = [0, 1, 2].map(|channel| Moments::of(pairs, |colour| colour[channel]));
        let all = Moments::of(pairs, luminance);
        let figures = Self {
            rel_rmse: signed_root(whole.square),
            energy_ratio: whole.energy_ratio,
            p95: whole.p95,
            p99: whole.p99,
            interval_95: Intervals::of(&draws),
            area_above: terms.area_above(whole.mean),
            channels: channels.map(|channel| signed_root(channel.rel_square())),
            channel_energy_ratios: channels.map(|channel| channel.energy_ratio()),
            reference_rel_error: all.noise.sqrt() / all.mean,
            mean_irradiance: all.mean,
        };
        (figures, draws)
    }

    /// [`Figures::rel_rmse`] alone.
    pub fn rel_rmse_of(pairs: &[Pair]) -> f64 {
        signed_root(Moments::of(pairs, luminance).rel_square())
    }

    /// Of several lights together: root mean square of errors, mean of ratios.
    pub fn over_lights(lights: &[(Self, &[Draw])]) -> Self {
        let count = lights.len().max(1) as f64;
        let mean = |of: &dyn Fn(&Self) -> f64| lights.iter().map(|(light, _)| of(light)).sum::<f64>() / count;
        let root = |of: &dyn Fn(&Self) -> f64| signed_root(mean(&|light| of(light) * of(light).abs()));
        let joint = |draw: usize| Draw::over_lights(lights.iter().map(|(_, draws)| &draws[draw]));
        let draws: Vec<Draw> =
            if lights.is_empty() { Vec::new() } else { (0..RESAMPLES).map(joint).collect() };
        Self {
            rel_rmse: root(&|light| light.rel_rmse),
            energy_ratio: mean(&|light| light.energy_ratio),
            p95: root(&|light| light.p95),
            p99: root(&|light| light.p99),
            interval_95: Intervals::of(&draws),
            area_above: [0, 1, 2].map(|share| mean(&|light| light.area_above[share])),
            channels: [0, 1, 2].map(|c| root(&|light| light.channels[c])),
            channel_energy_ratios: [0, 1, 2].map(|c| mean(&|light| light.channel_energy_ratios[c])),
            reference_rel_error: root(&|light| light.reference_rel_error),
            mean_irradiance: mean(&|light| light.mean_irradiance),
        }
    }

    /// The light reaches enough of the places for figures that say something.
    pub fn says_something(&self, draws: &[Draw]) -> bool {
        let mut means: Vec<f64> = draws.iter().map(|draw| draw.mean).collect();
        means.sort_by(f64::total_cmp);
        self.mean_irradiance > 0.0 && at_share(&means, 0.025) >= MEAN_SHARE_MIN * self.mean_irradiance
    }
}

/// A root mean square over the mean of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RelativeRoot {
    /// The root; minus that of the absolute value where the mean square is below 0.
    pub rel_rmse: f64,
    /// Its 95 % interval.
    pub interval_95: [f64; 2],
}

/// One place's share of a [`RelativeRoot`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SquareTerm {
    /// Weight.
    pub weight: f64,
    /// A square, W²·m⁻⁴, or a difference of squares.
    pub square: f64,
    /// Luminance of the reference, W·m⁻².
    pub reference: f64,
}

impl RelativeRoot {
    /// Sums up, and gives the relative squares of draws of the places; all zero where the reference is dark.
    pub(super) fn of(terms: &[SquareTerm]) -> (Self, Vec<f64>) {
        let rel_square = |places: &mut dyn Iterator<Item = usize>| {
            let (mut weight, mut square, mut reference) = (0.0, 0.0, 0.0);
            for place in places {
                let term = &terms[place];
                weight += term.weight;
                square += term.weight * term.square;
                reference += term.weight * term.reference;
            }
            if reference > 0.0 { square * weight / (reference * reference) } else { 0.0 }
        };
        let whole = rel_square(&mut (0..terms.len()));
        let draws: Vec<f64> = drawn(terms.len())
            .map(|places| rel_square(&mut places.into_iter().map(|place| place as usize)))
            .collect();
        (Self::with_draws(whole, &draws), draws)
    }

    /// Of several lights together: the root mean square, with signs.
    pub fn over_lights(lights: &[(Self, &[f64])]) -> Self {
        let count = lights.len().max(1) as f64;
        let square = |light: &Self| light.rel_rmse * light.rel_rmse.abs();
        let mean = lights.iter().map(|(light, _)| square(light)).sum::<f64>() / count;
        let joint = |draw: usize| lights.iter().map(|(_, draws)| draws[draw]).sum::<f64>() / count;
        let draws: Vec<f64> = (0..if lights.is_empty() { 0 } else { RESAMPLES }).map(joint).collect();
        Self::with_draws(mean, &draws)
    }

    fn with_draws(square: f64, draws: &[f64]) -> Self {
        let mut roots: Vec<f64> = draws.iter().map(|square| signed_root(*square)).collect();
        roots.sort_by(f64::total_cmp);
        let interval_95 = [0.025, 0.975].map(|share| at_share(&roots, share));
        Self { rel_rmse: signed_root(square), interval_95 }
    }
}

/// Draws of `count` places with replacement, the same at each call.
fn drawn(count: usize) -> impl Iterator<Item = Vec<u32>> {
    let mut random = Sequence::new(SEED);
    (0..RESAMPLES).map(move |_| {
        let place = |_| ((random.next_f32() * count as f32) as u32).min(count as u32 - 1);
        (0..count).map(place).collect()
    })
}

/// √x, with the sign of x.
pub(super) fn signed_root(square: f64) -> f64 {
    square.abs().sqrt().copysign(square)
}

/// The value below which that share of ascending values lies.
pub(super) fn at_share(values: &[f64], share: f64) -> f64 {
    let index = (share * values.len() as f64) as usize;
    values.get(index.min(values.len().saturating_sub(1))).copied().unwrap_or_default()
}

/// Luminances of one place.
#[derive(Clone, Copy, Debug)]
struct Term {
    weight: f64,
    found: f64,
    reference: f64,
    /// Product of the errors against both halves.
    square: f64,
    /// Place of the absolute error among those of all.
    rank: u32,
}

/// Luminances of all places.
struct Terms {
    terms: Vec<Term>,
    /// Absolute errors, ascending.
    errors: Vec<f64>,
}

impl Terms {
    fn of(pairs: &[Pair]) -> Self {
        let mut terms: Vec<Term> = pairs
            .iter()
            .map(|pair| {
                let halves = pair.reference.halves.map(luminance);
                let found = luminance(pair.found);
                Term {
                    weight: pair.area_m2,
                    found,
                    reference: pair.reference.indirect.luminance(),
                    square: (found - halves[0]) * (found - halves[1]),
                    rank: 0,
                }
            })
            .collect();
        let mut order: Vec<(f64, usize)> = terms
            .iter()
            .enumerate()
            .map(|(place, term)| ((term.found - term.reference).abs(), place))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.iter().enumerate().for_each(|(rank, (_, place))| terms[*place].rank = rank as u32);
        Self { terms, errors: order.into_iter().map(|(error, _)| error).collect() }
    }

    /// Figures of these places, each as often as it stands there.
    fn draw(&self, places: &[u32]) -> Draw {
        let mut weights = vec![0.0; self.terms.len()];
        let (mut weight, mut found, mut reference, mut square) = (0.0, 0.0, 0.0, 0.0);
        for &place in places {
            let term = &self.terms[place as usize];
            weights[term.rank as usize] += term.weight;
            weight += term.weight;
            found += term.weight * term.found;
            reference += term.weight * term.reference;
            square += term.weight * term.square;
        }
        if reference <= 0.0 {
            return Draw::default();
        }
        let mean = reference / weight;
        let percentile = |share| self.percentile(&weights, share * weight) / mean;
        Draw {
            square: square / weight / (mean * mean),
            energy_ratio: found / reference,
            p95: percentile(0.95),
            p99: percentile(0.99),
            mean,
        }
    }

    /// The smallest error that errors of so much weight do not exceed.
    fn percentile(&self, weights: &[f64], wanted: f64) -> f64 {
        let mut below = 0.0;
        for (weight, error) in weights.iter().zip(&self.errors) {
            below += weight;
            if below >= wanted && *weight > 0.0 {
                return *error;
            }
        }
        self.errors.last().copied().unwrap_or_default()
    }

    fn area_above(&self, mean: f64) -> [f64; 3] {
        let total: f64 = self.terms.iter().map(|term| term.weight).sum();
        LOCAL_ERRORS.map(|limit| {
            let above = |term: &&Term| {
                let local = term.reference.max(LOCAL_LIGHT_MIN * mean);
                (term.found - term.reference).abs() > limit * local
            };
            self.terms.iter().filter(above).fold(0.0, |sum, term| sum + term.weight) / total
        })
    }
}

/// Area-weighted means of one quantity of colours.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    found: f64,
    mean: f64,
    square: f64,
    noise: f64,
}

impl Moments {
    fn of(pairs: &[Pair], quantity: impl Fn(DVec3) -> f64) -> Self {
        let total: f64 = pairs.iter().map(|pair| pair.area_m2).sum();
        let mut moments = Self::default();
        for pair in pairs {
            let weight = pair.area_m2 / total;
            let found = quantity(pair.found);
            let halves = pair.reference.halves.map(&quantity);
            moments.found += weight * found;
            moments.mean += weight * quantity(pair.reference.indirect.mean);
            moments.square += weight * (found - halves[0]) * (found - halves[1]);
            moments.noise += weight * pair.reference.indirect.luminance_error.powi(2);
        }
        moments
    }

    fn rel_square(&self) -> f64 {
        if self.mean > 0.0 { self.square / (self.mean * self.mean) } else { 0.0 }
    }

    fn energy_ratio(&self) -> f64 {
        if self.mean > 0.0 { self.found / self.mean } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::Estimate;

    fn pair(area_m2: f64, found: f64, halves: [f64; 2], error: f64) -> Pair {
        let splat = DVec3::splat;
        let mean = splat(0.5 * (halves[0] + halves[1]));
        let indirect = Estimate { mean, error: splat(error), luminance_error: error };
        let direct = Estimate::default();
        let reference = IrradianceEstimate { direct, indirect, halves: halves.map(splat), paths: 0 };
        Pair { area_m2, found: splat(found), reference }
    }

    #[test]
    fn figures_weigh_by_area_and_are_relative_to_the_mean_of_the_reference() {
        // Means: reference (3·1 + 1·5)/4 = 2, found (3·1.2 + 5)/4 = 2.15; squared error 3/4·0.04 = 0.03.
        let (figures, _) = Figures::of(&[pair(3.0, 1.2, [1.0; 2], 0.0), pair(1.0, 5.0, [5.0; 2], 0.0)]);
        assert!((figures.mean_irradiance - 2.0).abs() < 1e-9);
        assert!((figures.rel_rmse - 0.03_f64.sqrt() / 2.0).abs() < 1e-9, "{figures:?}");
        assert!((figures.energy_ratio - 1.075).abs() < 1e-9);
        assert!((figures.p95 - 0.1).abs() < 1e-9 && (figures.channels[2] - figures.rel_rmse).abs() < 1e-9);
        assert_eq!(figures.area_above, [0.75, 0.0, 0.0]);
        assert_eq!(Figures::of(&[pair(1.0, 1.0, [0.0; 2], 0.0)]).0.rel_rmse, 0.0);
    }

    /// Places of a true error and a noise of the reference that is uniform in ±`noise` in each half.
    fn noisy(random: &mut Sequence, count: usize, error: f64, noise: f64) -> Vec<Pair> {
        let mut half = || 1.0 + noise * f64::from(2.0 * random.next_f32() - 1.0);
        (0..count).map(|_| pair(1.0, 1.0 + error, [half(), half()], noise / 6.0_f64.sqrt())).collect()
    }

    #[test]
    fn noise_of_the_reference_is_not_counted_as_error() {
        let (figures, _) = Figures::of(&noisy(&mut Sequence::new(4), 20_000, 0.1, 0.3));
        assert!((figures.rel_rmse - 0.1).abs() < 0.01, "{figures:?}");
        assert!((figures.reference_rel_error - 0.1225).abs() < 0.005);
    }

    #[test]
    fn an_error_below_the_noise_is_not_called_none() {
        let mut random = Sequence::new(5);
        let figures: Vec<Figures> =
            (0..40).map(|_| Figures::of(&noisy(&mut random, 100, 0.0, 0.3)).0).collect();
        // Signs of both kinds: a clamp at 0 would leave one.
        assert!(figures.iter().any(|f| f.rel_rmse < -0.01) && figures.iter().any(|f| f.rel_rmse > 0.01));
        let mean = figures.iter().map(|f| f.rel_rmse * f.rel_rmse.abs()).sum::<f64>() / 40.0;
        assert!(mean.abs() < 1e-3, "{mean}");
    }

    #[test]
    fn intervals_hold_the_truth_about_as_often_as_they_say() {
        let mut random = Sequence::new(6);
        let mut held = [0, 0];
        for _ in 0..200 {
            let pairs: Vec<Pair> = (0..150)
                .map(|_| {
                    // Light of mean 1, error uniform in ±0.2: root mean square 0.2/√3, energy 1.
                    let light = 2.0 * f64::from(random.next_f32());
                    let error = 0.2 * f64::from(2.0 * random.next_f32() - 1.0);
                    let mut half = || light + 0.1 * f64::from(2.0 * random.next_f32() - 1.0);
                    let halves = [half(), half()];
                    pair(1.0, light + error, halves, 0.04)
                })
                .collect();
            let Intervals { rel_rmse, energy_ratio, .. } = Figures::of(&pairs).0.interval_95;
            let holds = |[low, high]: [f64; 2], truth: f64| i32::from(low <= truth && truth <= high);
            held[0] += holds(rel_rmse, 0.2 / 3.0_f64.sqrt());
            held[1] += holds(energy_ratio, 1.0);
        }
        assert!(held.iter().all(|held| (178..=199).contains(held)), "{held:?} of 200");
    }

    #[test]
    fn lights_that_reach_one_place_in_a_hundred_say_nothing() {
        let mut pairs = noisy(&mut Sequence::new(7), 100, 0.1, 0.0);
        let (figures, draws) = Figures::of(&pairs);
        assert!(figures.says_something(&draws));
        pairs[1..].iter_mut().for_each(|dark| *dark = pair(1.0, 0.0, [0.0; 2], 0.0));
        let (figures, draws) = Figures::of(&pairs);
        assert!(!figures.says_something(&draws));
    }

    #[test]
    fn roots_of_differences_of_squares_keep_their_sign_and_their_interval_holds_them() {
        let term = |index: usize, square| SquareTerm {
            weight: 1.0,
            square: square + 0.02 * ((index % 5) as f64 - 2.0),
            reference: 2.0,
        };
        for square in [0.16, -0.16] {
            let terms: Vec<SquareTerm> = (0..200).map(|index| term(index, square)).collect();
            let (root, draws) = RelativeRoot::of(&terms);
            assert!((root.rel_rmse - 0.2 * square.signum()).abs() < 1e-9, "{root:?}");
            let [low, high] = root.interval_95;
            assert!(low < root.rel_rmse && root.rel_rmse < high && high - low < 0.02, "{root:?}");
            let both = RelativeRoot::over_lights(&[(root, &draws), (root, &draws)]);
            assert!((both.rel_rmse - root.rel_rmse).abs() < 1e-12 && both.interval_95 == root.interval_95);
        }
        assert_eq!(RelativeRoot::of(&[]).0, RelativeRoot::default());
    }

    #[test]
    fn draws_of_all_lights_are_of_the_same_places() {
        let pairs = noisy(&mut Sequence::new(8), 50, 0.1, 0.3);
        let (figures, draws) = Figures::of(&pairs);
        let both = Figures::over_lights(&[(figures, &draws), (figures, &draws)]);
        assert_eq!(both.interval_95, figures.interval_95);
        assert!((both.rel_rmse - figures.rel_rmse).abs() < 1e-12);
    }
}
