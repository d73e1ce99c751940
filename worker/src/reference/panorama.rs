//! Directions towards a panorama by its luminance: a pixel by its share of the flux, then a place in it by solid angle.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use lightkiln_proto::relight::Panorama;

use super::tally::luminance;

/// A panorama ready to be sampled.
#[derive(Clone, Debug)]
pub(super) struct SampledPanorama {
    panorama: Arc<Panorama>,
    /// Flux of the rows up to each, the last one's being that of all: ∫ Y dω in W·m⁻².
    rows: Vec<f64>,
    /// Luminance of the pixels up to each in its row, row after row.
    columns: Vec<f64>,
}

impl SampledPanorama {
    /// `None` for one that is dark.
    pub fn new(panorama: &Arc<Panorama>) -> Option<Self> {
        let [width, height] = panorama.image().size();
        let strength = f64::from(panorama.strength());
        let mut columns = Vec::with_capacity(panorama.image().pixels().len());
        let mut rows = Vec::with_capacity(height as usize);
        let mut flux = 0.0;
        for (row, pixels) in (0..height).zip(panorama.image().pixels().chunks_exact(width as usize)) {
            let mut sum = 0.0;
            for pixel in pixels {
                sum += strength * luminance(Vec3::from(*pixel).as_dvec3());
                columns.push(sum);
            }
            flux += sum * panorama.solid_angle(row);
            rows.push(flux);
        }
        (flux > 0.0).then(|| Self { panorama: Arc::clone(panorama), rows, columns })
    }

    /// ∫ Y dω.
    pub fn integral(&self) -> f64 {
        self.rows.last().copied().unwrap_or_default()
    }

    /// L in W·m⁻²·sr⁻¹.
    pub fn radiance(&self, direction: Vec3) -> DVec3 {
        self.panorama.radiance(direction).as_dvec3()
    }

    /// A direction of density Y / ∫ Y dω, from a point of the unit square, and L of the pixel that it was taken from.
    ///
    /// Rounded to 32 bits, the direction may lie in a pixel beside that one, and that may be black: L is not looked up again.
    pub fn sample(&self, [u, v]: [f64; 2]) -> (Vec3, DVec3) {
        let [width, height] = self.panorama.image().size().map(f64::from);
        let (row, down) = picked(&self.rows, u);
        let first = row * width as usize;
        let (column, right) = picked(&self.columns[first..first + width as usize], v);
        // Evenly by solid angle: evenly in the cosine from straight up.
        let cosine = |edge: f64| libm::cos(edge / height * std::f64::consts::PI);
        let [upper, lower] = [row as f64, row as f64 + 1.0].map(cosine);
        let polar = libm::acos((upper + (lower - upper) * down).clamp(-1.0, 1.0));
        let place = [(column as f64 + right) / width, polar / std::f64::consts::PI];
        let radiance = self.panorama.strength() * Vec3::from(self.panorama.image().pixels()[first + column]);
        (self.panorama.direction(place), radiance.as_dvec3())
    }
}

/// Index of the part that a share of a running sum falls into, and the place in it from 0 to 1.
fn picked(sums: &[f64], share: f64) -> (usize, f64) {
    let total = sums.last().copied().unwrap_or_default();
    let wanted = share * total;
    // Parts of nothing are passed over: the first sum above is that of one with something, as is the first that has all.
    let last = sums.partition_point(|sum| *sum < total);
    let index = sums.partition_point(|sum| *sum <= wanted).min(last);
    let below = if index == 0 { 0.0 } else { sums[index - 1] };
    let part = sums[index] - below;
    (index, if part > 0.0 { ((wanted - below) / part).clamp(0.0, 1.0) } else { 0.5 })
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::harmonics::relight_direction;
    use lightkiln_proto::relight::PanoramaImage;

    use super::*;
    use crate::rays::sampling::R2;

    #[test]
    fn directions_follow_the_luminance_of_the_pixels() {
        // Dim, with a black half and a bright pixel.
        let pixels = (0..16 * 8).map(|at| match (at % 16, at / 16) {
            (3, 2) => [500.0; 3],
            (x, _) if x >= 8 => [0.0; 3],
            (x, y) => [1.0 + x as f32, 0.5 + y as f32, 2.0],
        });
        let image = PanoramaImage::new("test".into(), 16, 8, pixels.collect()).unwrap();
        let panorama = Arc::new(Panorama::new(Arc::new(image), 25.0, 3.0).unwrap());
        let sampled = SampledPanorama::new(&panorama).unwrap();
        let mut wanted = [0.0; 4];
        let count = 1 << 17;
        for ray in 0..count {
            let direction = relight_direction(ray, count);
            let flux = luminance(sampled.radiance(direction)) * 4.0 * std::f64::consts::PI / f64::from(count);
            wanted[0] += flux;
            for (sum, axis) in wanted[1..].iter_mut().zip(direction.to_array()) {
                *sum += flux * f64::from(axis);
            }
        }
        assert!((wanted[0] / sampled.integral() - 1.0).abs() < 2e-3, "{} {}", wanted[0], sampled.integral());
        let points = R2::new(9);
        let mut mean = glam::DVec3::ZERO;
        for index in 0..1 << 14 {
            let (direction, _) = sampled.sample(points.point(index).map(f64::from));
            assert!((direction.length() - 1.0).abs() < 1e-5);
            mean += direction.as_dvec3() / f64::from(1 << 14);
        }
        let wanted = DVec3::new(wanted[1], wanted[2], wanted[3]) / wanted[0];
        assert!((mean - wanted).length() < 5e-3, "{mean}, wanted {wanted}");
    }

    #[test]
    fn samples_are_of_bright_pixels_alone() {
        // One row in the middle, and those at the poles, where directions in 32 bits tell rows apart worst.
        for bright in [0, 777, 1023] {
            let pixels = (0..2048 * 1024_u32).map(|at| if at / 2048 == bright { [7.0; 3] } else { [0.0; 3] });
            let image = PanoramaImage::new("test".into(), 2048, 1024, pixels.collect()).unwrap();
            let panorama = Arc::new(Panorama::new(Arc::new(image), 33.0, 2.0).unwrap());
            let sampled = SampledPanorama::new(&panorama).unwrap();
            let points = R2::new(9);
            let inside = (0..1 << 12).map(|index| points.point(index).map(f64::from));
            for point in inside.chain([[0.0; 2], [1.0; 2], [0.0, 1.0], [1.0, 0.0]]) {
                let (direction, radiance) = sampled.sample(point);
                assert_eq!(radiance, DVec3::splat(14.0), "{bright} {point:?}");
                assert!((direction.length() - 1.0).abs() < 1e-5, "{bright} {point:?}");
            }
        }
    }

    #[test]
    fn black_panorama_is_none() {
        let image = PanoramaImage::new("test".into(), 2, 1, vec![[0.0; 3]; 2]).unwrap();
        assert!(SampledPanorama::new(&Arc::new(Panorama::new(Arc::new(image), 0.0, 1.0).unwrap())).is_none());
    }
}
