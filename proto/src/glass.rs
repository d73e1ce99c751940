//! Glass: how much light a thin surface stops that lets a share of it straight through, and what becomes of the rest.

/// Weights of linear Rec.709 in luminance.
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Light on a point of glass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stopped {
    /// Share s that does not pass straight through, in 0..=1.
    pub share: f32,
    /// Diffuse albedo ρ that the stopped light meets.
    pub albedo: [f32; 3],
}

/// Light on a surface of which the share `there` is there and lets the transmission τ of the light through, tinted by the
/// base colour ρ₀.
///
/// `s = there · (1 − τ Y(ρ₀))`, `ρ = (1 − τ) ρ₀ / (1 − τ Y(ρ₀))`, with luminance Y: one number for all colours, as links
/// between texels carry. Then `1 − s` passes, `s ρ = there · (1 − τ) ρ₀` is reflected, and their sum is at most 1.
pub fn stopped(there: f32, colour: [f32; 3], transmission: f32) -> Stopped {
    let there = there.clamp(0.0, 1.0);
    if transmission <= 0.0 {
        return Stopped { share: there, albedo: colour };
    }
    let colour = colour.map(|channel| channel.clamp(0.0, 1.0));
    let tint = colour.iter().zip(LUMINANCE).map(|(channel, weight)| channel * weight).sum::<f32>().min(1.0);
    let left = 1.0 - transmission * tint;
    let scale = (1.0 - transmission) / left.max(f32::MIN_POSITIVE);
    Stopped { share: there * left, albedo: colour.map(|channel| channel * scale) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_that_passes_and_light_that_is_reflected_are_never_more_than_what_came() {
        let steps = || (0..=10_u8).map(|step| f32::from(step) / 10.0);
        for colour in [[1.0; 3], [0.0; 3], [1.0, 0.2, 0.0], [0.0, 0.0, 1.0], [0.3, 0.9, 0.5]] {
            for (there, transmission) in steps().flat_map(|there| steps().map(move |t| (there, t))) {
                let found = stopped(there, colour, transmission);
                assert!((0.0..=1.0).contains(&found.share), "{found:?}");
                for (albedo, base) in found.albedo.into_iter().zip(colour) {
                    let reflected = found.share * albedo;
                    assert!((reflected - there * (1.0 - transmission) * base).abs() < 1e-5, "{found:?}");
                    assert!((0.0..=1.0 + 1e-5).contains(&albedo), "{found:?}");
                    assert!(1.0 - found.share + reflected <= 1.0 + 1e-5, "{found:?}");
                }
            }
        }
    }

    #[test]
    fn clear_panes_stop_nothing_and_opaque_ones_all() {
        assert_eq!(stopped(0.0, [0.5; 3], 0.0).share, 0.0);
        assert_eq!(stopped(1.0, [0.5; 3], 0.0), Stopped { share: 1.0, albedo: [0.5; 3] });
        assert!(stopped(1.0, [1.0; 3], 1.0).share < 1e-6);
        assert_eq!(stopped(0.25, [0.5; 3], 0.0), Stopped { share: 0.25, albedo: [0.5; 3] });
        // Half of the light is tinted to a fifth, the other half meets the whole colour.
        let tinted = stopped(1.0, [0.2; 3], 0.5);
        assert!((tinted.share - 0.9).abs() < 1e-6 && (tinted.share * tinted.albedo[0] - 0.1).abs() < 1e-6);
    }
}
