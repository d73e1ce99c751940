//! Real spherical harmonics and the shared set of relight rays; both are normative: baker and client call these.
//!
//! `Y_j`, j = l² + l + m, orthonormal on the sphere; m < 0 carries sin(|m|φ), m > 0 carries cos(mφ).
//! Only +, −, ×, ÷ and √ are used, so every machine gives the same bits.

use glam::Vec3;

/// Highest band supported.
pub const MAX_BANDS: usize = 10;
/// Coefficients at [`MAX_BANDS`].
pub const MAX_COEFFICIENTS: usize = (MAX_BANDS + 1) * (MAX_BANDS + 1);

/// Normalisation factors for every (l, m ≥ 0) up to a highest band.
#[derive(Clone, Debug)]
pub struct ShBasis {
    bands: usize,
    /// `norm[l·(l+1)/2 + m]`: √((2l+1)/4π · (l−m)!/(l+m)!), times √2 for m > 0.
    norm: Vec<f32>,
}

impl ShBasis {
    /// Basis with bands 0…`bands`; `bands` at most [`MAX_BANDS`].
    pub fn new(bands: usize) -> Self {
        assert!(bands <= MAX_BANDS, "at most {MAX_BANDS} bands, got {bands}");
        let mut norm = Vec::with_capacity((bands + 1) * (bands + 2) / 2);
        for l in 0..=bands {
            for m in 0..=l {
                let ratio = (l - m + 1..=l + m).fold(1.0_f64, |product, k| product / k as f64);
                let twice = if m == 0 { 1.0 } else { 2.0 };
                norm.push((twice * (2 * l + 1) as f64 / (4.0 * std::f64::consts::PI) * ratio).sqrt() as f32);
            }
        }
        Self { bands, norm }
    }

    /// Coefficients J.
    pub fn coefficients(&self) -> usize {
        (self.bands + 1) * (self.bands + 1)
    }

    /// Writes `Y_j(direction)` for all j into `out[0..J]`; `direction` is a unit vector.
    ///
    /// `Y_lm = N_lm · P̂_lm(z) · {Re, Im}(x + iy)^|m|`, with `P̂` the associated Legendre function without its
    /// sin^m factor, by upward recurrence in l.
    pub fn evaluate(&self, direction: Vec3, out: &mut [f32]) {
        let Vec3 { x, y, z } = direction;
        let (mut cosine, mut sine) = (1.0_f32, 0.0_f32);
        let mut p_mm = 1.0_f32;
        for m in 0..=self.bands {
            let (mut previous, mut current) = (0.0_f32, p_mm);
            for l in m..=self.bands {
                let value = self.norm[l * (l + 1) / 2 + m] * current;
                let centre = l * l + l;
                out[centre + m] = value * cosine;
                if m > 0 {
                    out[centre - m] = value * sine;
                }
                let next =
                    ((2 * l + 1) as f32 * z * current - (l + m) as f32 * previous) / (l + 1 - m) as f32;
                previous = current;
                current = next;
            }
            (cosine, sine) = (cosine * x - sine * y, cosine * y + sine * x);
            p_mm *= (2 * m + 1) as f32;
        }
    }

    /// Window of band l at a strength: `1/(1 + s·(l(l+1)/((D+1)(D+2)))²)`.
    pub fn window(&self, l: usize, strength: f32) -> f32 {
        let scale = ((self.bands + 1) * (self.bands + 2)) as f32;
        let share = (l * (l + 1)) as f32 / scale;
        1.0 / (1.0 + strength * share * share)
    }
}

/// Band of coefficient j: ⌊√j⌋.
pub fn band_of(coefficient: usize) -> usize {
    coefficient.isqrt()
}

/// Direction ω_k of relight ray `ray` of `rays` (a power of two): a spherical Fibonacci set, visited in
/// bit-reversed order so that any power-of-two prefix is itself spread evenly.
pub fn relight_direction(ray: u32, rays: u32) -> Vec3 {
    assert!(rays.is_power_of_two() && ray < rays, "ray {ray} of {rays}");
    let index = if rays == 1 { 0 } else { ray.reverse_bits() >> (32 - rays.trailing_zeros()) };
    let z = 1.0 - (2 * index + 1) as f64 / f64::from(rays);
    let radius = (1.0 - z * z).max(0.0).sqrt();
    // Golden-angle turns; the fraction is taken in f64 before the trigonometry.
    const TURN: f64 = 0.618_033_988_749_894_9;
    let turn = f64::from(index) * TURN;
    let angle = (turn - turn.floor()) * std::f64::consts::TAU;
    Vec3::new((radius * libm::cos(angle)) as f32, (radius * libm::sin(angle)) as f32, z as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn basis_is_orthonormal_over_the_relight_rays() {
        let basis = ShBasis::new(7);
        let (count, rays) = (basis.coefficients(), 16_384);
        let mut gram = vec![0.0_f64; count * count];
        let mut y = vec![0.0; count];
        for ray in 0..rays {
            basis.evaluate(relight_direction(ray, rays), &mut y);
            for i in 0..count {
                for j in 0..count {
                    gram[i * count + j] += f64::from(y[i] * y[j]) * 4.0 * f64::from(PI) / f64::from(rays);
                }
            }
        }
        for i in 0..count {
            for j in 0..count {
                let wanted = if i == j { 1.0 } else { 0.0 };
                assert!((gram[i * count + j] - wanted).abs() < 2e-3, "{i} {j}: {}", gram[i * count + j]);
            }
        }
    }

    #[test]
    fn first_bands_are_the_textbook_ones() {
        let mut y = [0.0; 9];
        let d = Vec3::new(0.48, 0.6, 0.64);
        ShBasis::new(2).evaluate(d, &mut y);
        let (c0, c1, c2) = (0.282_094_8, 0.488_602_5, 1.092_548_4);
        let wanted = [c0, c1 * d.y, c1 * d.z, c1 * d.x, c2 * d.x * d.y, c2 * d.y * d.z];
        for (got, wanted) in y.iter().zip(wanted) {
            assert!((got - wanted).abs() < 1e-5, "{got} {wanted}");
        }
        assert!((y[6] - 0.315_391_6 * (3.0 * d.z * d.z - 1.0)).abs() < 1e-5);
        assert!((y[8] - 0.546_274_2 * (d.x * d.x - d.y * d.y)).abs() < 1e-5);
    }

    #[test]
    fn relight_rays_are_unit_and_a_prefix_still_averages_to_nothing() {
        for prefix in [64, 256, 512] {
            let sum: Vec3 = (0..prefix).map(|ray| relight_direction(ray, 512)).sum();
            assert!((sum / prefix as f32).length() < 0.05, "{prefix}: {sum}");
        }
        assert!((0..512).all(|ray| (relight_direction(ray, 512).length() - 1.0).abs() < 1e-6));
    }
}
