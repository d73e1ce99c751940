//! Structural similarity of two pictures [Wang2004]: means, variances and covariance under a Gaussian of 11 × 11 pixels.
//!
//! Of our own: the crates at hand take windows of 8 × 8 side by side and sums in place of variances.

/// Standard deviation of the window in pixels, and its reach.
const SIGMA: f64 = 1.5;
const REACH: isize = 5;
/// Constants of the formula, for brightness in 0..=255.
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Mean over pixels: 1 for equal pictures. Pictures are sRGB, row after row, `width` pixels each; windows end at the rim.
pub fn ssim(width: usize, a: &[[u8; 4]], b: &[[u8; 4]]) -> f64 {
    let [a, b] = [a, b].map(|pixels| pixels.iter().map(brightness).collect::<Vec<f64>>());
    let product = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(x, y)| x * y).collect() };
    let [mean_a, mean_b] = [&a, &b].map(|of| blurred(width, of));
    let [square_a, square_b, cross] =
        [product(&a, &a), product(&b, &b), product(&a, &b)].map(|of| blurred(width, &of));
    let at = |pixel: usize| {
        let (ma, mb) = (mean_a[pixel], mean_b[pixel]);
        let (va, vb) = (square_a[pixel] - ma * ma, square_b[pixel] - mb * mb);
        let covariance = cross[pixel] - ma * mb;
        (2.0 * ma * mb + C1) * (2.0 * covariance + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2))
    };
    (0..a.len()).map(at).sum::<f64>() / a.len().max(1) as f64
}

/// Luma of Rec. 709.
fn brightness([r, g, b, _]: &[u8; 4]) -> f64 {
    0.2126 * f64::from(*r) + 0.7152 * f64::from(*g) + 0.0722 * f64::from(*b)
}

fn blurred(width: usize, values: &[f64]) -> Vec<f64> {
    let height = values.len() / width.max(1);
    let across = along(values, |pixel| (pixel % width, width, 1));
    along(&across, |pixel| (pixel / width, height, width))
}

/// Weighted means along one axis; `axis` gives a pixel's place along it, the length, and the step from one to the next.
fn along(values: &[f64], axis: impl Fn(usize) -> (usize, usize, usize)) -> Vec<f64> {
    let weight = |offset: isize| libm::exp(-(offset * offset) as f64 / (2.0 * SIGMA * SIGMA));
    let at = |pixel: usize| {
        let (place, length, step) = axis(pixel);
        let (mut sum, mut total) = (0.0, 0.0);
        for offset in -REACH..=REACH {
            let Some(other) = place.checked_add_signed(offset).filter(|other| *other < length) else {
                continue;
            };
            sum += weight(offset) * values[pixel - place * step + other * step];
            total += weight(offset);
        }
        sum / total
    };
    (0..values.len()).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(of: impl Fn(usize, usize) -> u8) -> Vec<[u8; 4]> {
        (0..32 * 24).map(|pixel| [of(pixel % 32, pixel / 32); 4]).collect()
    }

    #[test]
    fn equal_pictures_are_alike_and_others_are_not() {
        let waves =
            picture(|x, y| (128.0 + 80.0 * ((x as f64) * 0.9).sin() * ((y as f64) * 0.7).cos()) as u8);
        assert!((ssim(32, &waves, &waves) - 1.0).abs() < 1e-12);
        let inverse: Vec<[u8; 4]> = waves.iter().map(|pixel| pixel.map(|channel| 255 - channel)).collect();
        assert!(ssim(32, &waves, &inverse) < 0.0, "contrasts are opposite");
        let flat = picture(|_, _| 128);
        assert!(ssim(32, &waves, &flat) < 0.2);
    }

    #[test]
    fn flat_pictures_differ_by_their_means_alone() {
        let [a, b] = [100.0, 120.0];
        let found = ssim(32, &picture(|_, _| 100), &picture(|_, _| 120));
        let wanted = (2.0 * a * b + C1) / (a * a + b * b + C1);
        assert!((found - wanted).abs() < 1e-9, "{found} {wanted}");
    }
}
