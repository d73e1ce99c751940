//! Pictures: linear radiance, exposure, tone mapping, PNG.

mod tone;

use std::path::Path;

use glam::{Vec3, Vec4};
use image::codecs::png::PngEncoder;
use image::error::{ParameterError, ParameterErrorKind};
use image::{ExtendedColorType, ImageEncoder, ImageError};
use lightkiln_proto::relight::{LOD_LEVELS, LevelCount};
use rayon::prelude::*;

use crate::error::{ClientError, Result};
use crate::scene::srgb_of_linear;

pub(crate) use tone::luminance;
pub use tone::{Exposure, Tone, automatic_exposure};

/// A finished picture and how it came about.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Radiance in W·m⁻²·sr⁻¹, linear Rec.709, row after row.
    pub linear: Vec<[f32; 3]>,
    /// Exposed, tone mapped and sRGB encoded: red, green, blue, opaque; row after row.
    pub ldr: Vec<[u8; 4]>,
    /// Factor on radiance before tone mapping.
    pub exposure: f32,
    /// Adapter or processor that drew it, with the reason.
    pub drawn_by: String,
    /// It was drawn by the processor, slower.
    pub by_reference: bool,
    /// Bounces before it was drawn; 0 where there is no feedback.
    pub bounces: u32,
    /// Whether bounces had converged by then.
    pub converged: bool,
    /// Time of the adapter's passes so far, also of pictures before; `None` where it has no clock, and of the processor.
    pub pass_times: Option<Vec<PassTime>>,
    /// Work by level of detail, the finest first; `None` where there is all detail.
    pub lod: Option<[LevelCount; LOD_LEVELS]>,
}

/// Time of a pass so far.
#[derive(Clone, Debug, PartialEq)]
pub struct PassTime {
    /// Name of the pass.
    pub name: &'static str,
    /// Runs that were timed.
    pub runs: u64,
    /// Milliseconds of all of them.
    pub total_ms: f64,
    /// Milliseconds of the last one.
    pub last_ms: f64,
}

/// Sums samples per pixel: mean radiance, and mean of the tone-mapped samples, which keeps the edge of a lamp far above
/// white smooth on the screen.
#[derive(Debug)]
pub(crate) struct Film {
    size: [u32; 2],
    tone: Tone,
    exposure: f32,
    samples: u32,
    linear: Vec<Vec3>,
    shown: Vec<Vec3>,
}

impl Film {
    /// An empty film; the first sample sets an automatic exposure.
    pub fn new(size: [u32; 2], tone: Tone, exposure: Exposure, first: &[Vec4]) -> Self {
        let count = size[0] as usize * size[1] as usize;
        let exposure = exposure.factor(first);
        let blank = vec![Vec3::ZERO; count];
        Self { size, tone, exposure, samples: 0, linear: blank.clone(), shown: blank }
    }

    /// Adds one sample per pixel.
    pub fn add(&mut self, radiance: &[Vec4]) {
        self.samples += 1;
        let (tone, exposure) = (self.tone, self.exposure);
        let pixels = self.linear.par_iter_mut().zip(&mut self.shown).zip(radiance);
        pixels.for_each(|((linear, shown), radiance)| {
            let radiance = radiance.truncate().max(Vec3::ZERO);
            *linear += radiance;
            *shown += tone.map(radiance * exposure);
        });
    }

    /// The picture; the fields about how it came about are the caller's to fill.
    pub fn develop(self) -> Picture {
        let share = 1.0 / self.samples.max(1) as f32;
        let byte = |value: f32| (srgb_of_linear(value * share).clamp(0.0, 1.0) * 255.0).round() as u8;
        Picture {
            width: self.size[0],
            height: self.size[1],
            linear: self.linear.into_iter().map(|sum| (sum * share).into()).collect(),
            ldr: self.shown.into_iter().map(|sum| [byte(sum.x), byte(sum.y), byte(sum.z), 255]).collect(),
            exposure: self.exposure,
            drawn_by: String::new(),
            by_reference: false,
            bounces: 0,
            converged: false,
            pass_times: None,
            lod: None,
        }
    }
}

impl Picture {
    /// Writes the picture as PNG, through a temporary file beside it.
    pub fn write_png(&self, path: &Path) -> Result<()> {
        write_png(path, self.width, self.height, &self.ldr)
    }
}

/// Writes 8-bit pixels as PNG, through a temporary file beside it.
pub fn write_png(path: &Path, width: u32, height: u32, pixels: &[[u8; 4]]) -> Result<()> {
    let encoded = encode_png(width, height, pixels)
        .map_err(|source| ClientError::Picture { path: path.to_owned(), source })?;
    crate::fetch::write_atomically(path, &encoded)
}

/// 8-bit pixels as the bytes of a PNG; errors when they are not `width` × `height`.
pub fn encode_png(
    width: u32,
    height: u32,
    pixels: &[[u8; 4]],
) -> std::result::Result<Vec<u8>, Box<ImageError>> {
    if pixels.len() as u64 != u64::from(width) * u64::from(height) {
        let wrong = ParameterError::from_kind(ParameterErrorKind::DimensionMismatch);
        return Err(Box::new(ImageError::Parameter(wrong)));
    }
    let mut encoded = Vec::new();
    PngEncoder::new(&mut encoded)
        .write_image(bytemuck::cast_slice(pixels), width, height, ExtendedColorType::Rgba8)
        .map_err(Box::new)?;
    Ok(encoded)
}

/// Radiance as the screen shows it under a factor of exposure: opaque sRGB.
pub fn developed(radiance: &[[f32; 3]], exposure: f32, tone: Tone) -> Vec<[u8; 4]> {
    let byte = |value: f32| (srgb_of_linear(value).clamp(0.0, 1.0) * 255.0).round() as u8;
    let pixel = |radiance: &[f32; 3]| {
        let shown = tone.map(Vec3::from(*radiance).max(Vec3::ZERO) * exposure);
        [byte(shown.x), byte(shown.y), byte(shown.z), 255]
    };
    radiance.iter().map(pixel).collect()
}
