//! A sky from a panorama: one mean radiance for each part of the sky, and the picture itself behind the scene.

use std::sync::{Arc, OnceLock};

use glam::{Vec3, Vec4};

use super::panorama_image::{FINE, PanoramaImage, RADIANCE_MAX};
use crate::harmonics::{ShBasis, relight_direction};

/// A panorama as a sky: turned about the vertical, and scaled.
///
/// The middle of its picture lies in direction −z, what is right of it towards +x, its upper edge straight up; turned by
/// `turn_deg` about y, from −z towards −x.
#[derive(Debug)]
pub struct Panorama {
    image: Arc<PanoramaImage>,
    turn_deg: f32,
    strength: f32,
    /// Mean radiance by part, for the number of parts that was asked for first.
    means: OnceLock<Vec<Vec3>>,
    /// Coefficients, likewise.
    coefficients: OnceLock<Vec<Vec3>>,
}

impl PartialEq for Panorama {
    fn eq(&self, other: &Self) -> bool {
        let same = Arc::ptr_eq(&self.image, &other.image) || self.image == other.image;
        self.turn_deg == other.turn_deg && self.strength == other.strength && same
    }
}

impl Panorama {
    /// A panorama turned by degrees and scaled by a strength.
    ///
    /// Errors where one of them is none, and where pixels are bright beyond all measure by it.
    pub fn new(image: Arc<PanoramaImage>, turn_deg: f32, strength: f32) -> Result<Self, String> {
        if !(turn_deg.is_finite() && strength.is_finite() && strength >= 0.0) {
            return Err(format!(
                "turn={turn_deg} strength={strength} is not finite, or the strength is negative"
            ));
        }
        let brightest = image.brightest();
        if strength * brightest > RADIANCE_MAX {
            return Err(format!(
                "strength={strength} makes its brightest pixel, of {brightest}, brighter than {RADIANCE_MAX:e}: give a lower one"
            ));
        }
        let (means, coefficients) = (OnceLock::new(), OnceLock::new());
        Ok(Self { image, turn_deg, strength, means, coefficients })
    }

    /// The same picture with another turn and strength; errors as [`Panorama::new`].
    pub fn changed(&self, turn_deg: f32, strength: f32) -> Result<Self, String> {
        let new = Self::new(Arc::clone(&self.image), turn_deg, strength)?;
        // Means are those before the strength, which alone costs nothing.
        if turn_deg == self.turn_deg {
            return Ok(Self { means: self.means.clone(), coefficients: self.coefficients.clone(), ..new });
        }
        Ok(new)
    }

    /// The picture.
    pub fn image(&self) -> &Arc<PanoramaImage> {
        &self.image
    }

    /// Turn in degrees.
    pub fn turn_deg(&self) -> f32 {
        self.turn_deg
    }

    /// Factor on the picture's radiance.
    pub fn strength(&self) -> f32 {
        self.strength
    }

    /// It sends no light.
    pub fn is_dark(&self) -> bool {
        self.strength * self.image.brightest() == 0.0
    }

    /// Cosine and sine of the turn.
    pub fn turn(&self) -> [f32; 2] {
        let (sine, cosine) = libm::sincos(f64::from(self.turn_deg).to_radians());
        [cosine as f32, sine as f32]
    }

    /// Unit direction of a place in the picture, its sides being 1.
    pub fn direction(&self, [u, v]: [f64; 2]) -> Vec3 {
        let (sine, cosine) =
            libm::sincos((u - 0.5) * std::f64::consts::TAU - f64::from(self.turn_deg).to_radians());
        let (level, up) = libm::sincos(v * std::f64::consts::PI);
        Vec3::new((level * sine) as f32, up as f32, (-level * cosine) as f32)
    }

    /// Place in the picture of a unit direction, its sides being 1.
    pub fn place(&self, direction: Vec3) -> [f32; 2] {
        let [cosine, sine] = self.turn();
        // Turned back: the picture's own x and z.
        let x = cosine * direction.x - sine * direction.z;
        let z = sine * direction.x + cosine * direction.z;
        let u = 0.5 + libm::atan2f(x, -z) / std::f32::consts::TAU;
        let v = libm::acosf(direction.y.clamp(-1.0, 1.0)) / std::f32::consts::PI;
        [u, v]
    }

    /// Column and row of the pixel in a unit direction.
    pub fn pixel_of(&self, direction: Vec3) -> [u32; 2] {
        let [u, v] = self.place(direction);
        let [width, height] = self.image.size();
        let at = |share: f32, count: u32| ((share * count as f32) as u32).min(count - 1);
        [at(u, width), at(v, height)]
    }

    /// Radiance of the pixel in a unit direction, W·m⁻²·sr⁻¹: the light that the panorama sends.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let [x, y] = self.pixel_of(direction);
        self.strength * self.image.pixel(x, y)
    }

    /// Radiance in a unit direction as pictures show it: between the pixels' middles, bilinear. Twin of `panorama.wgsl`.
    pub fn shown(&self, direction: Vec3) -> Vec3 {
        let [u, v] = self.place(direction);
        let [width, height] = self.image.size();
        let (x, y) = (u * width as f32 - 0.5, v * height as f32 - 0.5);
        let (left, upper) = (x.floor(), y.floor());
        let column = |step: i64| (left as i64 + step).rem_euclid(i64::from(width)) as u32;
        let row = |step: i64| (upper as i64 + step).clamp(0, i64::from(height) - 1) as u32;
        let across = |row: u32| {
            let [a, b] = [0, 1].map(|step| self.image.pixel(column(step), row));
            a.lerp(b, x - left)
        };
        self.strength * across(row(0)).lerp(across(row(1)), y - upper)
    }

    /// Solid angle of a pixel of a row in sr.
    pub fn solid_angle(&self, row: u32) -> f64 {
        let [width, height] = self.image.size();
        let up = |edge: u32| libm::cos(f64::from(edge) / f64::from(height) * std::f64::consts::PI);
        std::f64::consts::TAU / f64::from(width) * (up(row) - up(row + 1))
    }

    /// Mean radiance over each of so many parts of the sky, a power of two: over the directions that are nearest to
    /// [`relight_direction`]; each pixel of the reduced picture counts as its middle, by its solid angle.
    pub fn part_means(&self, parts: u32) -> Vec<Vec4> {
        let means = self.means.get_or_init(|| self.unscaled_means(parts));
        let scaled = |mean: &Vec3| (self.strength * *mean).extend(0.0);
        if means.len() == parts as usize {
            return means.iter().map(scaled).collect();
        }
        self.unscaled_means(parts).iter().map(scaled).collect()
    }

    fn unscaled_means(&self, parts: u32) -> Vec<Vec3> {
        let nearest = NearestPart::new(parts);
        let mut sums = vec![[0.0_f64; 4]; parts as usize];
        self.each(|direction, radiance, solid_angle| {
            let sum = &mut sums[nearest.of(direction) as usize];
            for (sum, radiance) in sum.iter_mut().zip(radiance.to_array()) {
                *sum += f64::from(radiance) * solid_angle;
            }
            sum[3] += solid_angle;
        });
        let mean = |[r, g, b, solid_angle]: &[f64; 4]| match *solid_angle > 0.0 {
            true => [r, g, b].map(|sum| (sum / solid_angle) as f32).into(),
            false => Vec3::ZERO,
        };
        sums.iter().map(mean).collect()
    }

    /// Coefficients `∫ L Y_j dω` of the bands 0 to `bands`; each pixel of the reduced picture counts as its middle.
    pub fn coefficients(&self, bands: u32) -> Vec<Vec4> {
        let count = ((bands + 1) * (bands + 1)) as usize;
        let found = self.coefficients.get_or_init(|| self.unscaled_coefficients(bands));
        let scaled = |one: &Vec3| (self.strength * *one).extend(0.0);
        if found.len() == count {
            return found.iter().map(scaled).collect();
        }
        self.unscaled_coefficients(bands).iter().map(scaled).collect()
    }

    fn unscaled_coefficients(&self, bands: u32) -> Vec<Vec3> {
        let basis = ShBasis::new(bands as usize);
        let mut y = vec![0.0; basis.coefficients()];
        let mut sums = vec![[0.0_f64; 3]; basis.coefficients()];
        self.each(|direction, radiance, solid_angle| {
            basis.evaluate(direction, &mut y);
            for (sum, y) in sums.iter_mut().zip(&y) {
                for (sum, radiance) in sum.iter_mut().zip(radiance.to_array()) {
                    *sum += f64::from(radiance) * f64::from(*y) * solid_angle;
                }
            }
        });
        sums.iter().map(|sum| sum.map(|channel| channel as f32).into()).collect()
    }

    /// Calls `take` with direction, radiance before the strength, and solid angle of each pixel of the reduced picture, in
    /// order; pixels of coarse panoramas come in several pieces alike.
    fn each(&self, mut take: impl FnMut(Vec3, Vec3, f64)) {
        let light = self.image.light();
        // Both sides at least as fine as needed, whatever the picture's shape.
        let [across, down] = [FINE[0].div_ceil(light.width), FINE[1].div_ceil(light.height)];
        let (columns, rows) = (light.width * across, light.height * down);
        let around: Vec<Vec3> = (0..columns)
            .map(|column| self.direction([(f64::from(column) + 0.5) / f64::from(columns), 0.5]))
            .collect();
        for row in 0..rows {
            let half_turn = |place: f64| place / f64::from(rows) * std::f64::consts::PI;
            let up = |edge: u32| libm::cos(half_turn(f64::from(edge)));
            let solid_angle = std::f64::consts::TAU / f64::from(columns) * (up(row) - up(row + 1));
            let (level, height) = libm::sincos(half_turn(f64::from(row) + 0.5));
            for (column, level_direction) in (0..columns).zip(&around) {
                let direction = level as f32 * level_direction.with_y(0.0) + height as f32 * Vec3::Y;
                take(direction, light.pixel(column / across, row / down), solid_angle);
            }
        }
    }
}

/// Finds the part of the sky that is nearest to a direction; of equally near ones the first.
struct NearestPart {
    /// Direction and number of each part, the greatest z first.
    parts: Vec<(Vec3, u32)>,
    /// Distance in z within which the nearest lies.
    reach: f32,
}

impl NearestPart {
    fn new(count: u32) -> Self {
        let mut parts: Vec<(Vec3, u32)> =
            (0..count).map(|part| (relight_direction(part, count), part)).collect();
        parts.sort_by(|a, b| b.0.z.total_cmp(&a.0.z));
        // Parts are spread evenly: none is farther from a direction than the side of a square of twice its area.
        let reach = (8.0 * std::f32::consts::PI / count as f32).sqrt();
        Self { parts, reach }
    }

    fn of(&self, direction: Vec3) -> u32 {
        let start = self.parts.partition_point(|(part, _)| part.z > direction.z + self.reach);
        let mut best = (f32::NEG_INFINITY, 0);
        for (part, number) in &self.parts[start..] {
            if part.z < direction.z - self.reach {
                break;
            }
            let cosine = direction.dot(*part);
            if cosine > best.0 || (cosine == best.0 && *number < best.1) {
                best = (cosine, *number);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, of: impl Fn(u32, u32) -> [f32; 3]) -> Arc<PanoramaImage> {
        let pixels = (0..width * height).map(|at| of(at % width, at / width)).collect();
        Arc::new(PanoramaImage::new("test".into(), width, height, pixels).unwrap())
    }

    fn noise(x: u32, y: u32) -> [f32; 3] {
        let hash = (x * 7919 + y * 104_729 + 17).wrapping_mul(2_654_435_761);
        [0, 8, 16].map(|shift| (hash >> shift & 255) as f32 / 64.0)
    }

    /// Solid angles of the parts, by pixels of the same panorama.
    fn shares(panorama: &Panorama, parts: u32) -> Vec<f64> {
        let nearest = NearestPart::new(parts);
        let mut shares = vec![0.0; parts as usize];
        panorama.each(|direction, _, solid_angle| shares[nearest.of(direction) as usize] += solid_angle);
        shares
    }

    #[test]
    fn nearest_part_is_that_of_all() {
        for count in [1, 2, 4, 16, 64, 256, 2048] {
            let nearest = NearestPart::new(count);
            for ray in 0..4096 {
                let direction = relight_direction(ray, 4096);
                let by_all = (0..count)
                    .map(|part| (part, direction.dot(relight_direction(part, count))))
                    .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
                    .unwrap();
                assert_eq!(nearest.of(direction), by_all.0, "{direction} of {count}");
            }
        }
    }

    #[test]
    fn means_of_the_parts_add_up_to_all_flux_of_the_panorama() {
        for (width, height) in [(8, 4), (61, 37), (1024, 512)] {
            let panorama = Panorama::new(image(width, height, noise), 33.0, 2.5).unwrap();
            let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            let flux: f64 =
                pixels.map(|(x, y)| panorama.solid_angle(y) * 2.5 * f64::from(noise(x, y)[1])).sum();
            for parts in [16, 128] {
                let means = panorama.part_means(parts);
                let shares = shares(&panorama, parts);
                assert!((shares.iter().sum::<f64>() / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-9);
                let found: f64 =
                    means.iter().zip(&shares).map(|(mean, share)| f64::from(mean.y) * share).sum();
                assert!((found / flux - 1.0).abs() < 1e-6, "{width} {parts}: {found}, wanted {flux}");
                // The first coefficient is ∫ L / √4π.
                let first = f64::from(panorama.coefficients(3)[0].y) * (4.0 * std::f64::consts::PI).sqrt();
                assert!((first / flux - 1.0).abs() < 1e-5, "{first}, wanted {flux}");
            }
        }
    }

    #[test]
    fn directions_and_places_are_each_others_inverse() {
        let panorama = Panorama::new(image(64, 32, noise), 77.0, 1.0).unwrap();
        for y in 0..32 {
            for x in 0..64 {
                let place = [(f64::from(x) + 0.5) / 64.0, (f64::from(y) + 0.5) / 32.0];
                let direction = panorama.direction(place);
                assert!((direction.length() - 1.0).abs() < 1e-6);
                assert_eq!(panorama.pixel_of(direction), [x, y]);
                let [shown, sent] = [panorama.shown(direction), panorama.radiance(direction)];
                assert!((shown - sent).length() < 1e-3, "{shown} {sent}");
            }
        }
        let ahead = Panorama::new(image(64, 32, noise), 0.0, 1.0).unwrap();
        assert!((ahead.direction([0.5, 0.5]) - Vec3::NEG_Z).length() < 1e-6);
        assert!((ahead.direction([0.75, 0.5]) - Vec3::X).length() < 1e-6);
        assert!((ahead.direction([0.3, 0.0]) - Vec3::Y).length() < 1e-6);
    }

    #[test]
    fn turning_moves_the_light_about_the_vertical() {
        // One bright spot, in the middle of the picture.
        let spot = image(256, 128, |x, y| {
            if (126..130).contains(&x) && (62..66).contains(&y) { [9.0; 3] } else { [0.0; 3] }
        });
        for (turn_deg, towards) in
            [(0.0, Vec3::NEG_Z), (90.0, Vec3::NEG_X), (-90.0, Vec3::X), (540.0, Vec3::Z)]
        {
            let panorama = Panorama::new(Arc::clone(&spot), turn_deg, 1.0).unwrap();
            assert!(panorama.shown(towards).x > 8.9, "{turn_deg}");
            let means = panorama.part_means(256);
            let brightest = (0..256).max_by(|a, b| means[*a].x.total_cmp(&means[*b].x)).unwrap();
            let off = relight_direction(brightest as u32, 256).dot(towards);
            assert!(off > 0.97, "{turn_deg}: {off}");
            // Band 1 points there as well: (y, z, x).
            let band = panorama.coefficients(1);
            let axis = Vec3::new(band[3].x, band[1].x, band[2].x).normalize();
            assert!(axis.dot(towards) > 0.999, "{turn_deg}: {axis}");
        }
    }

    #[test]
    fn even_panorama_is_an_even_sky() {
        let panorama = Panorama::new(image(20, 10, |_, _| [0.5, 1.0, 2.0]), 12.0, 3.0).unwrap();
        for mean in panorama.part_means(64) {
            assert!((mean.truncate() - Vec3::new(1.5, 3.0, 6.0)).length() < 1e-5, "{mean}");
        }
        let coefficients = panorama.coefficients(4);
        assert!(coefficients[1..].iter().all(|one| one.length() < 1e-3), "{coefficients:?}");
    }

    #[test]
    fn reduced_picture_has_the_means_of_all_pixels() {
        // Noise and a sun, in a picture whose sides are no multiples of the reduced one's.
        let (width, height) = (1500_u32, 750_u32);
        let of = |x: u32, y: u32| match (x, y) {
            (700..706, 200..206) => [30.0; 3],
            _ => noise(x, y),
        };
        let panorama = Panorama::new(image(width, height, of), 33.0, 1.0).unwrap();
        let (nearest, basis) = (NearestPart::new(64), ShBasis::new(3));
        let mut y_of = vec![0.0; basis.coefficients()];
        let (mut parts, mut coefficients) = (vec![[0.0_f64; 2]; 64], vec![0.0_f64; basis.coefficients()]);
        for y in 0..height {
            let solid_angle = panorama.solid_angle(y);
            for x in 0..width {
                let place = [(f64::from(x) + 0.5) / 1500.0, (f64::from(y) + 0.5) / 750.0];
                let direction = panorama.direction(place);
                let flux = f64::from(of(x, y)[0]) * solid_angle;
                let part = &mut parts[nearest.of(direction) as usize];
                *part = [part[0] + flux, part[1] + solid_angle];
                basis.evaluate(direction, &mut y_of);
                coefficients.iter_mut().zip(&y_of).for_each(|(sum, y)| *sum += flux * f64::from(*y));
            }
        }
        // Pixels on the border of two parts may go to the other one.
        for (found, [flux, solid_angle]) in panorama.part_means(64).iter().zip(parts) {
            let wanted = flux / solid_angle;
            assert!((f64::from(found.x) / wanted - 1.0).abs() < 0.01, "{}, wanted {wanted}", found.x);
        }
        for (found, wanted) in panorama.coefficients(3).iter().zip(&coefficients) {
            let off = (f64::from(found.x) - wanted).abs();
            assert!(off < 2e-3 * coefficients[0], "{}, wanted {wanted}", found.x);
        }
    }

    #[test]
    fn turns_and_strengths_that_are_none_are_refused() {
        let one = image(1, 1, |_, _| [1.0; 3]);
        let new = |turn_deg, strength| Panorama::new(Arc::clone(&one), turn_deg, strength);
        assert!(new(f32::NAN, 1.0).is_err());
        assert!(new(0.0, -1.0).is_err());
        assert!(!new(0.0, 1.0).unwrap().is_dark());
        assert!(new(0.0, 0.0).unwrap().is_dark());
        // Sums of it would have no finite number.
        assert!(new(0.0, f32::MAX).unwrap_err().contains("lower"));
        assert!(new(0.0, 1e29).unwrap().coefficients(2).iter().all(|one| one.is_finite()));
    }
}
