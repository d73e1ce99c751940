//! The sky: `L(ω) = horizon + (zenith − horizon)·max(ω_y, 0)`, and a panorama on top, sampled by luminance.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use lightkiln_proto::relight::Panorama;
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::panorama::SampledPanorama;
use super::tally::luminance;

/// A sky ready to be sampled.
#[derive(Clone, Debug, Default)]
pub(super) struct Sky {
    zenith: DVec3,
    horizon: DVec3,
    panorama: Option<SampledPanorama>,
}

/// A direction towards the sky.
#[derive(Clone, Copy, Debug)]
pub(super) struct SkySample {
    /// Unit direction.
    pub direction: Vec3,
    /// L in W·m⁻²·sr⁻¹.
    pub radiance: DVec3,
    /// Density per steradian.
    pub density: f64,
}

impl Sky {
    /// The sum of the skies among the lights, and of a panorama.
    pub fn of(lights: &[SceneLight], panorama: Option<&Arc<Panorama>>) -> Self {
        let mut sum = Self { panorama: panorama.and_then(SampledPanorama::new), ..Self::default() };
        for light in lights {
            if let LightKind::Sky { zenith, horizon } = &light.kind {
                let scaled =
                    |colour: &[f32; 3]| (Vec3::from(*colour) * Vec3::from(light.strength)).as_dvec3();
                sum.zenith += scaled(zenith);
                sum.horizon += scaled(horizon);
            }
        }
        sum
    }

    /// There is none.
    pub fn is_dark(&self) -> bool {
        self.panorama.is_none() && self.zenith.max_element() <= 0.0 && self.horizon.max_element() <= 0.0
    }

    /// L in W·m⁻²·sr⁻¹.
    pub fn radiance(&self, direction: Vec3) -> DVec3 {
        self.gradient(direction) + self.of_panorama(direction)
    }

    fn gradient(&self, direction: Vec3) -> DVec3 {
        self.horizon.lerp(self.zenith, f64::from(direction.y.clamp(0.0, 1.0)))
    }

    fn of_panorama(&self, direction: Vec3) -> DVec3 {
        self.panorama.as_ref().map_or(DVec3::ZERO, |panorama| panorama.radiance(direction))
    }

    /// Density per steradian of [`Sky::sample`]: luminance over its integral.
    pub fn density(&self, direction: Vec3) -> f64 {
        self.density_of(self.radiance(direction))
    }

    fn density_of(&self, radiance: DVec3) -> f64 {
        luminance(radiance) / self.integral()
    }

    fn integral(&self) -> f64 {
        self.gradient_integral() + self.panorama.as_ref().map_or(0.0, SampledPanorama::integral)
    }

    /// `2πY_h + π(Y_h + Y_z)`.
    fn gradient_integral(&self) -> f64 {
        let (zenith, horizon) = (luminance(self.zenith), luminance(self.horizon));
        PI * (3.0 * horizon + zenith)
    }

    /// A direction by luminance, from a point of the unit square.
    pub fn sample(&self, point: [f32; 2]) -> SkySample {
        let [u, v] = point.map(f64::from);
        // One of the two by its share of the flux; what is left of the number takes the direction.
        let share = self.gradient_integral() / self.integral();
        let (direction, of_panorama) = match &self.panorama {
            Some(panorama) if u >= share => {
                panorama.sample([((u - share) / (1.0 - share)).clamp(0.0, 1.0), v])
            }
            _ => {
                let direction = self.gradient_direction([(u / share).min(1.0), v]);
                (direction, self.of_panorama(direction))
            }
        };
        let radiance = self.gradient(direction) + of_panorama;
        SkySample { direction, radiance, density: self.density_of(radiance) }
    }

    fn gradient_direction(&self, [u, v]: [f64; 2]) -> Vec3 {
        let (zenith, horizon) = (luminance(self.zenith), luminance(self.horizon));
        // Below the horizon 2πY_h, above it ∫₀¹ 2π(Y_h + (Y_z − Y_h)y) dy.
        let below = 2.0 * PI * horizon / self.gradient_integral();
        let y = if u < below {
            u / below - 1.0
        } else {
            rising(horizon, zenith, ((u - below) / (1.0 - below)).clamp(0.0, 1.0))
        };
        let radius = (1.0 - y * y).max(0.0).sqrt();
        let (sine, cosine) = libm::sincos(v * std::f64::consts::TAU);
        Vec3::new((radius * cosine) as f32, y as f32, (radius * sine) as f32)
    }
}

/// y in 0..=1 with density in proportion to `a + (b − a)y`, by inversion.
fn rising(a: f64, b: f64, u: f64) -> f64 {
    // (b − a)y²/2 + ay = u(a + b)/2, solved without cancellation.
    let constant = u * (a + b);
    let root = (a * a + (b - a) * constant).max(0.0).sqrt();
    if a + root > 0.0 { (constant / (a + root)).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::R2;

    fn sky(zenith: f32, horizon: f32) -> Sky {
        let kind = LightKind::Sky { zenith: [zenith; 3], horizon: [horizon; 3] };
        Sky::of(&[SceneLight { name: "sky".into(), kind, strength: [2.0, 1.0, 1.0] }], None)
    }

    #[test]
    fn directions_follow_the_stated_density() {
        for sky in [sky(3.0, 1.0), sky(1.0, 4.0), sky(2.0, 0.0), sky(0.0, 1.0), sky(1.0, 1.0)] {
            let rays = 16_384;
            let uniform = (0..rays).map(|ray| lightkiln_proto::harmonics::relight_direction(ray, rays));
            let share = 4.0 * PI / f64::from(rays);
            let (mut total, mut mean_y) = (0.0, 0.0);
            for direction in uniform {
                total += sky.density(direction) * share;
                mean_y += f64::from(direction.y) * sky.density(direction) * share;
            }
            assert!((total - 1.0).abs() < 1e-3, "{total}");
            let points = R2::new(9);
            let sampled: f64 = (0..rays).map(|i| f64::from(sky.sample(points.point(i)).direction.y)).sum();
            assert!((sampled / f64::from(rays) - mean_y).abs() < 2e-3, "{sky:?}");
        }
    }
}
