//! Exposure and tone mapping: from radiance to the range of a screen.

use glam::{Vec3, Vec4};

/// Mean that automatic exposure brings the picture's log-average luminance to: middle grey.
const MIDDLE_GREY: f32 = 0.18;
/// Luminance below this share of the mean is left out of the log-average: black corners would drown it.
const DARKEST_SHARE: f32 = 1e-3;
/// One in so many pixels, the brightest, may burn out.
const BRIGHTEST_SHARE: usize = 20;
/// Exposed luminance above which the curves are nearly flat.
const WHITE: f32 = 1.0;

/// Curve from radiance into 0..=1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// Cut off at 1: for measurements.
    Linear,
    /// `c·(1 + Y/4²)/(1 + Y)` by luminance Y \[Reinhard2002\] eq. 4, white at 4: soft, keeps hues.
    Reinhard,
    /// A film-like curve with toe and shoulder, the fit of \[Narkowicz2015\] to ACES: more contrast.
    #[default]
    Filmic,
}

/// Factor on radiance before tone mapping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// Brings the log-average luminance to middle grey, then brighter by so many stops (powers of two).
    Auto {
        /// Stops; 0 leaves it, more is brighter.
        stops: f32,
    },
    /// A fixed factor.
    Fixed(f32),
}

impl Default for Exposure {
    fn default() -> Self {
        Self::Auto { stops: 0.0 }
    }
}

impl Exposure {
    /// The factor for a picture; alpha tells surfaces (1) from sky (0).
    pub fn factor(self, radiance: &[Vec4]) -> f32 {
        match self {
            Self::Auto { stops } => automatic_exposure(radiance) * stops.exp2(),
            Self::Fixed(factor) => factor,
        }
    }
}

/// `0.18 / exp(mean ln Y)` over surfaces that are lit at all; over the sky when no surface is; 1 for a black picture.
///
/// Where that would burn out the brightest twentieth (sun into a dark hall), the geometric mean of it and of the
/// factor that would not: some light burns out, some shade stays dark, as in a photograph.
pub fn automatic_exposure(radiance: &[Vec4]) -> f32 {
    let of = |wanted: fn(&Vec4) -> bool| -> Vec<f32> {
        let luminances =
            radiance.iter().filter(|value| wanted(value)).map(|value| luminance(value.truncate()));
        luminances.filter(|y| y.is_finite()).collect()
    };
    let mut luminances = of(|value| value.w > 0.5);
    if luminances.iter().all(|y| *y <= 0.0) {
        luminances = of(|_| true);
    }
    let Some(average) = log_average(&luminances) else { return 1.0 };
    let middle = MIDDLE_GREY / average;
    let rank = luminances.len() - 1 - luminances.len() / BRIGHTEST_SHARE;
    let bright = *luminances.select_nth_unstable_by(rank, f32::total_cmp).1;
    if bright * middle > WHITE { (middle * WHITE / bright).sqrt() } else { middle }
}

fn log_average(luminances: &[f32]) -> Option<f32> {
    let mean = luminances.iter().map(|y| f64::from(*y)).sum::<f64>() / luminances.len().max(1) as f64;
    let lit = luminances.iter().filter(|y| **y > DARKEST_SHARE * mean as f32);
    let (sum, count) = lit.fold((0.0, 0_u64), |(sum, count), y| (sum + f64::from(y.ln()), count + 1));
    (count > 0).then(|| (sum / count as f64).exp() as f32)
}

/// Luminance Y of a Rec.709 colour.
pub(crate) fn luminance(colour: Vec3) -> f32 {
    colour.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

impl Tone {
    /// Exposed radiance → linear screen colour in 0..=1.
    pub fn map(self, colour: Vec3) -> Vec3 {
        let mapped = match self {
            Self::Linear => colour,
            Self::Reinhard => {
                let y = luminance(colour);
                colour * ((1.0 + y / 16.0) / (1.0 + y))
            }
            Self::Filmic => (colour * (2.51 * colour + 0.03)) / (colour * (2.43 * colour + 0.59) + 0.14),
        };
        mapped.clamp(Vec3::ZERO, Vec3::ONE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_rise_from_black_and_stay_within_the_screen() {
        for tone in [Tone::Linear, Tone::Reinhard, Tone::Filmic] {
            let mut last = -1.0;
            for step in 0..200 {
                let value = tone.map(Vec3::splat(0.1 * step as f32)).x;
                assert!(value >= last && (0.0..=1.0).contains(&value), "{tone:?} {step}");
                last = value;
            }
            assert_eq!(tone.map(Vec3::ZERO), Vec3::ZERO);
            assert!(last > 0.99, "{tone:?}");
        }
    }

    #[test]
    fn automatic_exposure_brings_an_even_picture_to_middle_grey() {
        let picture = vec![Vec4::new(7.0, 7.0, 7.0, 1.0); 10];
        assert!((automatic_exposure(&picture) * 7.0 - 0.18).abs() < 1e-4);
        assert_eq!(automatic_exposure(&[Vec4::ZERO]), 1.0);
        assert_eq!(automatic_exposure(&[]), 1.0);
    }

    #[test]
    fn sunlit_part_of_a_dark_picture_holds_the_exposure_back() {
        let dark = Vec4::new(0.02, 0.02, 0.02, 1.0);
        let mut picture = vec![dark; 80];
        picture.extend([Vec4::new(10.0, 10.0, 10.0, 1.0); 20]);
        let held = automatic_exposure(&picture);
        assert!(held > 1.0 / 10.0 && held < automatic_exposure(&[dark]), "{held}");
    }

    #[test]
    fn sky_does_not_set_the_exposure_while_a_surface_is_seen() {
        let picture = [Vec4::new(1.0, 1.0, 1.0, 1.0), Vec4::new(1e6, 1e6, 1e6, 0.0)];
        assert!((automatic_exposure(&picture) - 0.18).abs() < 1e-4);
    }
}
