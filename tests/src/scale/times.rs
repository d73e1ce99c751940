//! Task times, drawn from those of a real bake.
//!
//! Measured: `open_hall` at draft, one worker of one thread, by `kiln logs BAKE --json`: 142 tasks of `prt.transport` with a mean of 0.251 s, 142 of
//! `prt.colour` with 0.060 s. They are all but nine of its tasks, and each cluster has one of both.

use std::time::Duration;

/// Shares of tasks at which times are known.
const SHARES: [f64; 13] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0];

/// Tasks of one kind.
struct Measured {
    mean_secs: f64,
    /// Time at each share, over the mean.
    quantiles: [f64; 13],
}

const TRANSPORT: Measured = Measured {
    mean_secs: 0.251,
    quantiles: [0.18, 0.46, 0.60, 0.71, 0.80, 0.90, 1.04, 1.17, 1.47, 1.69, 1.83, 2.07, 2.39],
};
const COLOUR: Measured = Measured {
    mean_secs: 0.060,
    quantiles: [0.30, 0.42, 0.50, 0.60, 0.69, 0.80, 0.87, 1.02, 1.19, 2.09, 2.58, 3.18, 4.19],
};

impl Measured {
    /// Time in seconds that this share of the tasks is within, linear between the known ones.
    fn at(&self, share: f64) -> f64 {
        let above = SHARES.iter().position(|known| share < *known).unwrap_or(SHARES.len() - 1);
        let [from, to] = [SHARES[above - 1], SHARES[above]];
        let [low, high] = [self.quantiles[above - 1], self.quantiles[above]];
        self.mean_secs * (low + (high - low) * (share - from) / (to - from))
    }

    /// Mean of [`at`](Self::at) over all shares.
    fn mean(&self) -> f64 {
        let part = |index: usize| {
            let width = SHARES[index + 1] - SHARES[index];
            width * (self.quantiles[index] + self.quantiles[index + 1]) / 2.0
        };
        self.mean_secs * (0..SHARES.len() - 1).map(part).sum::<f64>()
    }
}

/// Mean of the measured times, with as many tasks of either kind.
pub fn measured_mean() -> Duration {
    Duration::from_secs_f64((TRANSPORT.mean() + COLOUR.mean()) / 2.0)
}

/// Time of task `index` of a bake, with the spread of the measured ones and this mean. Equal arguments give equal times.
pub fn task_time(bake: u64, index: u64, mean: Duration) -> Duration {
    let measured = if index.is_multiple_of(2) { TRANSPORT } else { COLOUR };
    let secs = measured.at(draw(bake, index));
    mean.mul_f64(secs / measured_mean().as_secs_f64())
}

/// A number in 0..1 that belongs to an identity: SplitMix64's finaliser over both parts.
pub fn draw(seed: u64, index: u64) -> f64 {
    let mut bits =
        seed.wrapping_mul(0xd134_2543_de82_ef95) ^ index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for factor in [0xbf58_476d_1ce4_e5b9, 0x94d0_49bb_1331_11eb] {
        bits = (bits ^ (bits >> 30)).wrapping_mul(factor);
    }
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_times_have_the_mean_that_was_asked_for_and_the_measured_spread() {
        let mean = Duration::from_secs(4);
        let mut secs: Vec<f64> = (0..20_000).map(|index| task_time(7, index, mean).as_secs_f64()).collect();
        let found = secs.iter().sum::<f64>() / secs.len() as f64;
        assert!((found - 4.0).abs() < 0.04, "{found}");
        secs.sort_by(f64::total_cmp);
        // The longest is a long one of transport, over four times the mean of both.
        let longest = secs[secs.len() - 1];
        let wanted = 4.0 * TRANSPORT.at(1.0 - 1e-12) / measured_mean().as_secs_f64();
        assert!((longest / wanted - 1.0).abs() < 0.02, "{longest}, not {wanted}");
        assert!(secs[0] > 0.0);
    }

    #[test]
    fn times_belong_to_their_task() {
        let mean = Duration::from_secs(1);
        assert_eq!(task_time(1, 5, mean), task_time(1, 5, mean));
        assert_ne!(task_time(1, 5, mean), task_time(2, 5, mean));
        assert_ne!(task_time(1, 5, mean), task_time(1, 7, mean));
    }
}
