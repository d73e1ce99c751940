//! Light at probes without ringing (\[Sloan2017\]): nine coefficients of concentrated light are below 0 along some directions, where light
//! never is.

use std::sync::LazyLock;

use glam::Vec4;

use super::content::PROBE_ROWS;
use crate::harmonics::{ShBasis, relight_direction};
use crate::relight::Parallel;

/// Directions along which light is looked at.
pub const LOOKS: usize = 64;

/// Harmonics of these directions.
static HARMONICS: LazyLock<Vec<[f32; PROBE_ROWS]>> = LazyLock::new(|| {
    let basis = ShBasis::new(2);
    let of = |look: usize| {
        let mut harmonics = [0.0; PROBE_ROWS];
        basis.evaluate(relight_direction(look as u32, LOOKS as u32), &mut harmonics);
        harmonics
    };
    (0..LOOKS).map(of).collect()
});

/// Harmonics of the directions along which light is looked at, [`PROBE_ROWS`] each.
pub fn looks() -> &'static [[f32; PROBE_ROWS]] {
    &HARMONICS
}

/// Scales bands 1 and 2 of the light at each probe, by colour, down to where it is below 0 along no direction that is looked at; the mean
/// over directions stays. Rows are [`PROBE_ROWS`] a probe.
pub fn deringed(parallel: &impl Parallel, rows: &[Vec4]) -> Vec<Vec4> {
    let of_probe = |probe: usize| -> [Vec4; PROBE_ROWS] {
        let own = &rows[PROBE_ROWS * probe..][..PROBE_ROWS];
        // The mean over directions, and the least of all else.
        let mean = own[0] * HARMONICS[0][0];
        let least = HARMONICS.iter().fold(Vec4::ZERO, |least, harmonics| {
            let sum: Vec4 = (1..PROBE_ROWS).map(|j| own[j] * harmonics[j]).sum();
            least.min(sum)
        });
        let of = |channel: usize| {
            let (mean, least) = (mean[channel], least[channel]);
            if least < -mean { mean.max(0.0) / (-least).max(1e-30) } else { 1.0 }
        };
        let share = Vec4::new(of(0), of(1), of(2), 1.0);
        std::array::from_fn(|j| if j == 0 { own[0] } else { own[j] * share })
    };
    parallel.map(rows.len() / PROBE_ROWS, of_probe).concat()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::relight::Serial;

    /// Irradiance by normal of light of 1 from one direction, cut after nine coefficients, and of `even` light from all.
    fn rows(from: Vec3, even: f32) -> Vec<Vec4> {
        let mut harmonics = [0.0; PROBE_ROWS];
        ShBasis::new(2).evaluate(from, &mut harmonics);
        let pi = std::f32::consts::PI;
        let band = |j: usize| [pi, 2.0 * pi / 3.0, pi / 4.0][crate::harmonics::band_of(j)];
        let mut rows: Vec<Vec4> = (0..PROBE_ROWS).map(|j| Vec4::splat(band(j) * harmonics[j])).collect();
        rows[0] += Vec4::splat(even);
        rows
    }

    fn least(rows: &[Vec4]) -> f32 {
        let along = |of: &[f32; PROBE_ROWS]| rows.iter().zip(of).map(|(row, y)| row.x * y).sum::<f32>();
        looks().iter().map(along).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn light_from_one_direction_is_nowhere_below_zero_and_keeps_its_mean() {
        for from in [Vec3::Y, Vec3::new(0.6, -0.8, 0.0), Vec3::new(-0.48, 0.6, 0.64)] {
            let ringing = rows(from, 0.0);
            assert!(least(&ringing) < -0.02, "{}: the test shows nothing", least(&ringing));
            let found = deringed(&Serial, &ringing);
            assert!(least(&found).abs() < 1e-6, "{}", least(&found));
            assert_eq!(found[0], ringing[0]);
            let share = found[6].x / ringing[6].x;
            assert!(share > 0.8 && share < 1.0, "{share}");
        }
    }

    #[test]
    fn light_without_ringing_stays_as_it_is_and_each_probe_and_colour_is_one_of_its_own() {
        let (even, ringing) = (rows(Vec3::Z, 1.0), rows(Vec3::Z, 0.0));
        assert_eq!(deringed(&Serial, &even), even);
        let mut both = [ringing.clone(), even.clone()].concat();
        both[..PROBE_ROWS].iter_mut().zip(&even).for_each(|(row, even)| row.y = even.y);
        let found = deringed(&Serial, &both);
        assert_eq!(found[PROBE_ROWS..], even);
        assert!(found[2].x < ringing[2].x && found[2].y == even[2].y);
        // A mean below 0, of noise alone, leaves no light.
        let dark = deringed(&Serial, &rows(Vec3::Z, -2.0));
        assert!(dark[1..].iter().all(|row| row.truncate() == Vec3::ZERO), "{dark:?}");
    }
}
