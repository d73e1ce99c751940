//! The picture on a screen, on the processor.

use glam::{Vec3, Vec4};

use crate::picture::Tone;
use crate::scene::srgb_of_linear;

/// sRGB of the mean over samples of radiance.
pub fn shown(samples: &[Vec<Vec4>], exposure: f32, tone: Tone) -> Vec<Vec4> {
    let pixels = samples.first().map_or(0, Vec::len);
    let mapped = |radiance: Vec4| tone.map(radiance.truncate().max(Vec3::ZERO) * exposure);
    let pixel = |index: usize| {
        let sum: Vec3 = samples.iter().map(|sample| mapped(sample[index])).sum();
        let mean = sum / samples.len().max(1) as f32;
        Vec3::from(mean.to_array().map(srgb_of_linear)).extend(1.0)
    };
    (0..pixels).map(pixel).collect()
}
