//! Light and opacity of a sample, seen along a direction.

use std::f32::consts::{PI, SQRT_2};

use glam::Vec3;

use super::corner::{Corner, lobe, towards};
use super::{Kind, Manner, Model};

/// Least length of a mean vector.
const LENGTH_MIN: f32 = 1e-3;

/// Light that a sample sends back along a direction, times its opacity, and the opacity.
pub fn shaded(sample: &Corner, direction: Vec3, half_angle_rad: f32, kind: Kind) -> (Vec3, f32) {
    let portion = direction.abs();
    let opacity = portion.dot(sample.opacity);
    let along = || -> Vec3 {
        let of = |axis: usize| sample.values[towards(axis, direction[axis] < 0.0)] * portion[axis];
        (0..3).map(of).sum()
    };
    let total = portion.element_sum();
    match (kind.model, kind.manner) {
        (Model::Axes, Manner::Written) => (along(), opacity),
        (Model::Axes, Manner::Mended) => (along() / total, opacity / total),
        (Model::Lobes, Manner::Written) => (lobes_written(sample, direction, half_angle_rad), opacity),
        (Model::Lobes, Manner::Mended) => {
            (lobes_mended(sample, direction) * (opacity / total), opacity / total)
        }
    }
}

/// A Gaussian lobe: unit mean and σ, of a mean vector by eq. 2.10.
fn lobe_of(mean: Vec3) -> (Vec3, f32) {
    let length = mean.length().clamp(LENGTH_MIN, 1.0);
    (mean.normalize_or_zero(), ((1.0 - length) / length).sqrt())
}

/// Listing 5.5: `ρ·I` by the convolution of normal, reflected light and cone, at −ω. Eq. 2.9 gives σ² as the root of the sum.
fn lobes_written(sample: &Corner, direction: Vec3, half_angle_rad: f32) -> Vec3 {
    let (normal, normal_sigma) = lobe_of(sample.unweighted(lobe::NORMAL));
    let (light, light_sigma) = lobe_of(sample.unweighted(lobe::LIGHT_DIRECTION));
    let reflected = light - 2.0 * light.dot(normal) * normal;
    let convolved = |a: f32, b: f32| (a * a + b * b).sqrt().sqrt();
    let sigma = convolved(convolved(normal_sigma, light_sigma), half_angle_rad.cos()).max(LENGTH_MIN);
    let mean = (normal + reflected - direction).normalize_or_zero();
    let apart = mean.dot(-direction).clamp(-1.0, 1.0).acos();
    let density = (-0.5 * (apart / sigma).powi(2)).exp() / (sigma * (2.0 * PI).sqrt());
    sample.unweighted(lobe::ALBEDO) * sample.values[lobe::INCOMING] * density
}

/// Lambert's reflection by lobes: `ρ/π·I·cosθ` by the share of normals that face the eye.
fn lobes_mended(sample: &Corner, direction: Vec3) -> Vec3 {
    let (normal, sigma) = lobe_of(sample.unweighted(lobe::NORMAL));
    let (light, _) = lobe_of(sample.unweighted(lobe::LIGHT_DIRECTION));
    let cosine = -normal.dot(direction);
    let facing = 0.5 * (1.0 + libm::erff(cosine / (sigma.max(LENGTH_MIN) * SQRT_2)));
    let irradiance = sample.unweighted(lobe::INCOMING) * normal.dot(light).max(0.0);
    sample.unweighted(lobe::ALBEDO) / PI * irradiance * facing
}
