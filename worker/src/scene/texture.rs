//! Decoded textures, sampled in linear light at a point or averaged over a footprint.

use rayon::prelude::*;

use super::error::Result;
use super::images;
use super::model::{Scene, TextureUse, Wrap};

/// Samples along one side of a footprint at most. Higher → sharper long footprints; lower → faster.
const MAX_TAPS: f64 = 16.0;

/// Texels of the chosen level that the footprint's short side spans at least, where the image has them. Higher → closer
/// to a box average; lower → faster.
const MIN_TEXELS_ACROSS: f64 = 2.0;

/// A scene's images, decoded once; indices are those of [`Scene::images`].
///
/// Memory: 4 bytes a pixel, and 5⅓ for its coarser levels.
#[derive(Clone, Debug)]
pub struct DecodedImages {
    pyramids: Vec<Pyramid>,
    linear_of_srgb: Vec<f32>,
}

/// An image and its coarser levels, each of half the size, rounded down.
#[derive(Clone, Debug)]
struct Pyramid {
    size_px: [usize; 2],
    /// sRGB-encoded rgb and linear alpha; 16-bit images are rounded to 8.
    base: Vec<[u8; 4]>,
    /// Level 1 and up, in linear light: area averages of the level before.
    coarser: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    size_px: [usize; 2],
    texels: Vec<[f32; 4]>,
}

impl DecodedImages {
    /// Decodes all images of a scene and builds their coarser levels.
    ///
    /// Errors if an image does not decode, which cannot be for a scene that [`super::import`] gave.
    pub fn decode(scene: &Scene) -> Result<Self> {
        let linear_of_srgb: Vec<f32> = (0..=255).map(linear_of_srgb).collect();
        let build = |image| {
            let pixels = images::decode(image)?.into_rgba8();
            let size_px = [pixels.width() as usize, pixels.height() as usize];
            let base: Vec<[u8; 4]> = pixels.pixels().map(|pixel| pixel.0).collect();
            Ok(Pyramid::build(size_px, base, &linear_of_srgb))
        };
        let pyramids = scene.images.par_iter().map(build).collect::<Result<_>>()?;
        Ok(Self { pyramids, linear_of_srgb })
    }

    /// Bilinear sample of the full image: linear rgb and alpha.
    ///
    /// `uv` is the mesh's; the texture's own transform and wrap modes are applied here.
    pub fn sample_bilinear(&self, texture: &TextureUse, uv: [f32; 2]) -> [f32; 4] {
        self.bilinear(texture, 0, transformed(texture, uv, 1.0)).map(|channel| channel as f32)
    }

    /// Mean over the parallelogram with sides `duv_dx` and `duv_dy` around `uv_centre`: linear rgb and alpha.
    ///
    /// All three are in the mesh's uv, before the texture's own transform. The mean is taken over a grid of bilinear
    /// samples in the level whose texels are just small enough; a footprint below a texel is one bilinear sample.
    pub fn sample_footprint(
        &self,
        texture: &TextureUse,
        uv_centre: [f32; 2],
        duv_dx: [f32; 2],
        duv_dy: [f32; 2],
    ) -> [f32; 4] {
        let pyramid = &self.pyramids[texture.image_index as usize];
        let centre = transformed(texture, uv_centre, 1.0);
        let sides = [duv_dx, duv_dy].map(|side| transformed(texture, side, 0.0));
        let lengths_px = sides.map(|side| pyramid.length_px(side));
        let level = pyramid.level_for(lengths_px);
        let texel_px = (1_u64 << level) as f64;
        let taps = lengths_px.map(|length| (length / texel_px).ceil().clamp(1.0, MAX_TAPS) as usize);
        let mut sum = [0.0; 4];
        for i in 0..taps[0] {
            for j in 0..taps[1] {
                let [s, t] = [(i, taps[0]), (j, taps[1])].map(|(k, n)| (k as f64 + 0.5) / n as f64 - 0.5);
                let uv = [0, 1].map(|axis| centre[axis] + s * sides[0][axis] + t * sides[1][axis]);
                let sample = self.bilinear(texture, level, uv);
                sum = [0, 1, 2, 3].map(|channel| sum[channel] + sample[channel]);
            }
        }
        sum.map(|channel| (channel / (taps[0] * taps[1]) as f64) as f32)
    }

    /// Bilinear sample of one level at a transformed uv.
    fn bilinear(&self, texture: &TextureUse, level: usize, uv: [f64; 2]) -> [f64; 4] {
        let pyramid = &self.pyramids[texture.image_index as usize];
        let size_px = pyramid.level_size_px(level);
        let [(x0, x1, fx), (y0, y1, fy)] =
            [0, 1].map(|axis| neighbours(uv[axis], size_px[axis], texture.wrap[axis]));
        let texel = |x, y| pyramid.texel(level, x, y, &self.linear_of_srgb);
        let (top, bottom) = (mix(texel(x0, y0), texel(x1, y0), fx), mix(texel(x0, y1), texel(x1, y1), fx));
        mix(top, bottom, fy)
    }
}

impl Pyramid {
    fn build(size_px: [usize; 2], base: Vec<[u8; 4]>, linear_of_srgb: &[f32]) -> Self {
        let mut pyramid = Self { size_px, base, coarser: Vec::new() };
        let level_count = usize::BITS - size_px[0].max(size_px[1]).leading_zeros();
        for level in 1..level_count as usize {
            let next = pyramid.halved(level - 1, linear_of_srgb);
            pyramid.coarser.push(next);
        }
        pyramid
    }

    /// The level after `level`: each texel the mean of the area that it covers, also where sizes are odd.
    fn halved(&self, level: usize, linear_of_srgb: &[f32]) -> Level {
        let from_px = self.level_size_px(level);
        let size_px = from_px.map(|length| (length / 2).max(1));
        let [columns, rows] = [0, 1].map(|axis| area_weights(from_px[axis], size_px[axis]));
        let mean = |x: usize, y: usize| {
            let mut sum = [0.0; 4];
            for (row, row_weight) in rows[y].iter() {
                for (column, column_weight) in columns[x].iter() {
                    let texel = self.texel(level, *column, *row, linear_of_srgb);
                    let weight = row_weight * column_weight;
                    sum = [0, 1, 2, 3].map(|channel| sum[channel] + weight * texel[channel]);
                }
            }
            sum.map(|channel| channel as f32)
        };
        let mut texels = vec![[0.0; 4]; size_px[0] * size_px[1]];
        let fill_row = |(y, row): (usize, &mut [[f32; 4]])| {
            row.iter_mut().enumerate().for_each(|(x, texel)| *texel = mean(x, y));
        };
        texels.par_chunks_mut(size_px[0]).enumerate().for_each(fill_row);
        Level { size_px, texels }
    }

    fn level_size_px(&self, level: usize) -> [usize; 2] {
        if level == 0 { self.size_px } else { self.coarser[level - 1].size_px }
    }

    fn texel(&self, level: usize, x: usize, y: usize, linear_of_srgb: &[f32]) -> [f64; 4] {
        if level > 0 {
            let level = &self.coarser[level - 1];
            return level.texels[y * level.size_px[0] + x].map(f64::from);
        }
        let [r, g, b, a] = self.base[y * self.size_px[0] + x];
        let linear = |code: u8| f64::from(linear_of_srgb[usize::from(code)]);
        [linear(r), linear(g), linear(b), f64::from(a) / 255.0]
    }

    /// Length in texels of the full image of a difference in uv; 0 if it is not finite.
    fn length_px(&self, duv: [f64; 2]) -> f64 {
        let length = libm::hypot(duv[0] * self.size_px[0] as f64, duv[1] * self.size_px[1] as f64);
        if length.is_finite() { length } else { 0.0 }
    }

    /// The coarsest level that still resolves a footprint's short side, or a coarser one if the long side would take
    /// too many samples.
    fn level_for(&self, lengths_px: [f64; 2]) -> usize {
        let (short, long) = (lengths_px[0].min(lengths_px[1]), lengths_px[0].max(lengths_px[1]));
        let is_too_fine = |level: &usize| {
            let texel_px = (1_u64 << level) as f64;
            short >= 2.0 * MIN_TEXELS_ACROSS * texel_px || long > MAX_TAPS * texel_px
        };
        (0..self.coarser.len()).find(|level| !is_too_fine(level)).unwrap_or(self.coarser.len())
    }
}

/// For each of `to` equal parts of a line of `from` texels: the texels that it covers, and their shares.
fn area_weights(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let length = from as f64 / to as f64;
    let part = |index: usize| {
        let (start, end) = (index as f64 * length, (index + 1) as f64 * length);
        let texels = start as usize..(end.ceil() as usize).min(from);
        let share = |texel: usize| (end.min(texel as f64 + 1.0) - start.max(texel as f64)).max(0.0) / length;
        texels.map(|texel| (texel, share(texel))).collect()
    };
    (0..to).map(part).collect()
}

/// The texture's own map applied to a point (`w` = 1) or a difference (`w` = 0); 0 where that is not finite.
fn transformed(texture: &TextureUse, uv: [f32; 2], w: f64) -> [f64; 2] {
    let [u, v] = uv.map(f64::from);
    texture.uv_transform.map(|row| {
        let [a, b, c] = row.map(f64::from);
        let value = a * u + b * v + c * w;
        if value.is_finite() { value } else { 0.0 }
    })
}

/// The two texels around coordinate `u` of a line of `count`, and the share of the second.
fn neighbours(u: f64, count: usize, wrap: Wrap) -> (usize, usize, f64) {
    // Brought near 0 first, so that no coordinate is too big for an integer.
    let near = match wrap {
        Wrap::Repeat => u - u.floor(),
        Wrap::Mirror => u - 2.0 * (u / 2.0).floor(),
        Wrap::Clamp => u.clamp(-1.0, 2.0),
    };
    let position = near * count as f64 - 0.5;
    let first = position.floor();
    let wrapped = |texel: i64| wrap_texel(texel, count as i64, wrap) as usize;
    (wrapped(first as i64), wrapped(first as i64 + 1), position - first)
}

fn wrap_texel(texel: i64, count: i64, wrap: Wrap) -> i64 {
    match wrap {
        Wrap::Repeat => texel.rem_euclid(count),
        Wrap::Clamp => texel.clamp(0, count - 1),
        Wrap::Mirror => {
            let folded = texel.rem_euclid(2 * count);
            folded.min(2 * count - 1 - folded)
        }
    }
}

fn mix(a: [f64; 4], b: [f64; 4], share_of_b: f64) -> [f64; 4] {
    [0, 1, 2, 3].map(|channel| a[channel] + (b[channel] - a[channel]) * share_of_b)
}

/// IEC 61966-2-1 decoding of an 8-bit code.
fn linear_of_srgb(code: u8) -> f32 {
    let encoded = f64::from(code) / 255.0;
    let linear = if encoded <= 0.04045 { encoded / 12.92 } else { libm::pow((encoded + 0.055) / 1.055, 2.4) };
    linear as f32
}
