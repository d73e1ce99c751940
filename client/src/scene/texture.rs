//! Textures: decoded with limits, with mip levels averaged in linear light, or over numbers where they hold such.

use std::io::Cursor;
use std::sync::LazyLock;

use glam::Vec4;
use image::{ImageReader, Limits};
use lightkiln_proto::manifest::Wrap;

/// Longest side of a texture in texels.
const MAX_SIDE: u32 = 16_384;
/// Most bytes that decoding one texture may take.
const MAX_DECODED_BYTES: u64 = 1 << 30;

/// Meaning of a texture's codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// sRGB colour and linear alpha.
    Colour,
    /// Linear numbers.
    Numbers,
}

/// A texture of 8 bits a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Meaning of its codes.
    pub encoding: Encoding,
    /// Mip levels, finest first, each half as large, down to 1 × 1.
    pub levels: Vec<Level>,
}

/// One mip level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Level {
    /// Width in texels.
    pub width: u32,
    /// Height in texels.
    pub height: u32,
    /// Row after row.
    pub texels: Vec<[u8; 4]>,
}

/// Linear value of an sRGB byte.
static LINEAR_OF_SRGB: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_of_srgb(byte as f32 / 255.0)));

fn linear_of_srgb(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// sRGB value of a linear one, both 0..=1.
pub(crate) fn srgb_of_linear(value: f32) -> f32 {
    if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

impl Texture {
    /// Decodes a PNG or JPEG.
    pub fn decode(bytes: &[u8]) -> image::ImageResult<Self> {
        let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
        let mut limits = Limits::default();
        limits.max_image_width = Some(MAX_SIDE);
        limits.max_image_height = Some(MAX_SIDE);
        limits.max_alloc = Some(MAX_DECODED_BYTES);
        reader.limits(limits);
        let picture = reader.decode()?.into_rgba8();
        let texels = picture.pixels().map(|pixel| pixel.0).collect();
        Ok(Self::new(picture.width(), picture.height(), texels))
    }

    /// A texture of colour from its finest level; an empty one becomes a white texel.
    pub fn new(width: u32, height: u32, texels: Vec<[u8; 4]>) -> Self {
        let whole = width > 0 && height > 0 && texels.len() == width as usize * height as usize;
        let finest = if whole {
            Level { width, height, texels }
        } else {
            Level { width: 1, height: 1, texels: vec![[255; 4]] }
        };
        Self::of_finest(finest, Encoding::Colour)
    }

    /// The same codes taken for linear numbers.
    pub fn of_numbers(mut self) -> Self {
        Self::of_finest(self.levels.swap_remove(0), Encoding::Numbers)
    }

    fn of_finest(finest: Level, encoding: Encoding) -> Self {
        let mut levels = vec![finest];
        while let Some(coarser) = levels.last().and_then(|level| level.halved(encoding)) {
            levels.push(coarser);
        }
        Self { encoding, levels }
    }

    /// Colour at coordinates `uv`, trilinear; `footprint` is the length in uv of a pixel's longer step on each axis.
    pub fn sample(&self, uv: [f32; 2], wrap: [Wrap; 2], lod: f32) -> Vec4 {
        let last = self.levels.len() - 1;
        let lod = lod.clamp(0.0, last as f32);
        let (level, fraction) = (lod as usize, lod.fract());
        let read = |level: usize| self.levels[level].bilinear(uv, wrap, self.encoding);
        let fine = read(level);
        if fraction == 0.0 {
            return fine;
        }
        fine.lerp(read((level + 1).min(last)), fraction)
    }

    /// Level of detail for steps of uv along a pixel's two axes: log₂ of the longer one in texels.
    pub fn lod(&self, step_x: [f32; 2], step_y: [f32; 2]) -> f32 {
        let (width, height) = (self.levels[0].width as f32, self.levels[0].height as f32);
        let texels = |step: [f32; 2]| (step[0] * width).hypot(step[1] * height);
        texels(step_x).max(texels(step_y)).max(1e-12).log2()
    }
}

impl Level {
    fn bilinear(&self, uv: [f32; 2], wrap: [Wrap; 2], encoding: Encoding) -> Vec4 {
        let x = uv[0] * self.width as f32 - 0.5;
        let y = uv[1] * self.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let at = |dx: f32, dy: f32| {
            let column = wrapped(x0 + dx, self.width, wrap[0]);
            let row = wrapped(y0 + dy, self.height, wrap[1]);
            encoding.decoded(self.texels[row * self.width as usize + column])
        };
        let upper = at(0.0, 0.0).lerp(at(1.0, 0.0), x - x0);
        let lower = at(0.0, 1.0).lerp(at(1.0, 1.0), x - x0);
        upper.lerp(lower, y - y0)
    }

    /// The next coarser level: means of 2 × 2 texels in linear light (edges repeat when a side is odd).
    fn halved(&self, encoding: Encoding) -> Option<Self> {
        if self.width == 1 && self.height == 1 {
            return None;
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let at = |x: u32, y: u32| {
            let (x, y) = (x.min(self.width - 1), y.min(self.height - 1));
            encoding.decoded(self.texels[(y * self.width + x) as usize])
        };
        let mean = |x: u32, y: u32| {
            let sum =
                at(2 * x, 2 * y) + at(2 * x + 1, 2 * y) + at(2 * x, 2 * y + 1) + at(2 * x + 1, 2 * y + 1);
            encoding.encoded(sum * 0.25)
        };
        let texels =
            (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| mean(x, y)).collect();
        Some(Self { width, height, texels })
    }
}

impl Encoding {
    fn decoded(self, codes: [u8; 4]) -> Vec4 {
        let numbers = Vec4::from(codes.map(|code| f32::from(code) / 255.0));
        match self {
            Self::Numbers => numbers,
            Self::Colour => {
                let [r, g, b, _] = codes.map(|code| LINEAR_OF_SRGB[usize::from(code)]);
                Vec4::new(r, g, b, numbers.w)
            }
        }
    }

    fn encoded(self, texel: Vec4) -> [u8; 4] {
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        let [r, g, b, a] = texel.to_array();
        match self {
            Self::Numbers => [r, g, b, a].map(byte),
            Self::Colour => {
                [byte(srgb_of_linear(r)), byte(srgb_of_linear(g)), byte(srgb_of_linear(b)), byte(a)]
            }
        }
    }
}

fn wrapped(index: f32, size: u32, wrap: Wrap) -> usize {
    let (size_i, size_f) = (size as i64, size as f32);
    let inside = match wrap {
        Wrap::Clamp => return index.clamp(0.0, size_f - 1.0) as usize,
        Wrap::Repeat => (index as i64).rem_euclid(size_i),
        Wrap::Mirror => {
            let folded = (index as i64).rem_euclid(2 * size_i);
            folded.min(2 * size_i - 1 - folded)
        }
    };
    inside as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker() -> Texture {
        Texture::new(2, 2, vec![[0, 0, 0, 255], [255; 4], [255; 4], [0, 0, 0, 255]])
    }

    #[test]
    fn coarsest_level_is_the_mean_in_linear_light() {
        let coarse = checker().sample([0.5, 0.5], [Wrap::Repeat; 2], 9.0);
        assert!((coarse.x - 0.5).abs() < 5e-3, "{coarse}");
    }

    #[test]
    fn numbers_are_read_and_averaged_as_they_are() {
        let numbers = checker().of_numbers();
        let read = |lod| numbers.sample([0.25, 0.25], [Wrap::Clamp; 2], lod).x;
        assert_eq!(read(0.0), 0.0);
        assert_eq!(read(9.0), 128.0 / 255.0);
        let colour = Texture::new(1, 1, vec![[128, 128, 255, 51]]);
        let [of_colour, of_numbers] = [colour.clone(), colour.of_numbers()]
            .map(|texture| texture.sample([0.5; 2], [Wrap::Clamp; 2], 0.0));
        assert!((of_colour.x - 0.2159).abs() < 1e-3 && of_colour.w == 0.2, "{of_colour}");
        assert_eq!((of_numbers.x, of_numbers.z, of_numbers.w), (128.0 / 255.0, 1.0, 0.2));
    }

    #[test]
    fn wrap_modes_differ_outside_the_texture() {
        let texture = Texture::new(2, 1, vec![[0, 0, 0, 255], [255; 4]]);
        let read = |wrap| texture.sample([1.25, 0.5], [wrap, Wrap::Clamp], 0.0).x;
        assert_eq!((read(Wrap::Repeat), read(Wrap::Clamp), read(Wrap::Mirror)), (0.0, 1.0, 1.0));
    }

    #[test]
    fn picture_beyond_the_longest_side_is_refused() {
        let png = |[width, height]: [u32; 2]| {
            let mut png = Cursor::new(Vec::new());
            image::GrayImage::new(width, height).write_to(&mut png, image::ImageFormat::Png).unwrap();
            png.into_inner()
        };
        assert!(Texture::decode(&png([MAX_SIDE, 1])).is_ok());
        for size in [[MAX_SIDE + 1, 1], [1, MAX_SIDE + 1]] {
            let error = Texture::decode(&png(size)).unwrap_err();
            assert!(matches!(error, image::ImageError::Limits(_)), "{error}");
        }
    }

    #[test]
    fn broken_picture_is_an_error() {
        assert!(Texture::decode(b"\x89PNG\r\n\x1a\nnothing").is_err());
        assert!(Texture::decode(b"").is_err());
    }
}
