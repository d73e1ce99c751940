//! Small procedural images, encoded as PNG.
//!
//! Noise is an integer hash of texel coordinates. The encoder's fast mode is used because its bytes do not depend on
//! which deflate library a build has chosen.

use glam::Vec3;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

/// An sRGB colour.
pub type Srgb = [u8; 3];

/// A square floor pattern of 4 × 4 tiles with grout, of two colours in turn; each tile has its own shade.
pub fn tiles(size_px: u32, light: Srgb, dark: Srgb, grout: Srgb) -> Vec<u8> {
    let tile_px = size_px / 4;
    encode(size_px, |x, y| {
        let (column, row) = (x / tile_px, y / tile_px);
        let (in_x, in_y) = (x % tile_px, y % tile_px);
        let edge = in_x.min(in_y).min(tile_px - 1 - in_x).min(tile_px - 1 - in_y);
        if edge < 1 {
            return grout;
        }
        let base = if (column + row).is_multiple_of(2) { light } else { dark };
        let shade = 0.12 * (noise(column, row, 1) - 0.5) + 0.06 * (cloud(x, y, size_px, 16) - 0.5);
        shaded(base, 1.0 + shade + if edge < 2 { -0.06 } else { 0.0 })
    })
}

/// Squared stone: four courses of two blocks, joints staggered, each block with its own shade.
pub fn ashlar(size_px: u32, stone: Srgb) -> Vec<u8> {
    let (course_px, block_px) = (size_px / 4, size_px / 2);
    encode(size_px, |x, y| {
        let course = y / course_px;
        let shifted = (x + (course % 2) * block_px / 2) % size_px;
        let (in_x, in_y) = (shifted % block_px, y % course_px);
        let joint = in_x < 2 || in_y < 2;
        let block = noise(shifted / block_px, course, 2) - 0.5;
        let grain = cloud(x, y, size_px, 8) - 0.5;
        shaded(stone, if joint { 0.80 } else { 1.0 + 0.08 * block + 0.08 * grain })
    })
}

/// A cloth with a border, and stripes across (`along` = false) or down it.
pub fn striped_cloth(size_px: u32, ground: Srgb, stripe: Srgb, stripes: u32, along: bool) -> Vec<u8> {
    encode(size_px, |x, y| {
        let (across, down) = (x * 64 / size_px, y * 64 / size_px);
        let border = (3..6).contains(&across) || (58..61).contains(&across) || (57..61).contains(&down);
        let ordinate = if along { x } else { y };
        let band = stripes > 0 && (ordinate * stripes * 6 / size_px) % 6 == 3;
        let weave = if (x + y).is_multiple_of(2) { 1.0 } else { 0.96 };
        shaded(if border || band { stripe } else { ground }, weave)
    })
}

/// A normal map of one normal: x along the texture's u, y towards its upper edge.
pub fn slope(normal: Vec3) -> Vec<u8> {
    let codes = normal.to_array().map(|part| (127.5 + 127.5 * part).round() as u8);
    encode(8, |_, _| codes)
}

fn shaded(colour: Srgb, factor: f32) -> Srgb {
    colour.map(|channel| (f32::from(channel) * factor + 0.5) as u8)
}

/// Smooth noise that repeats with the image: bilinear between hashed lattice points.
fn cloud(x: u32, y: u32, size_px: u32, cell_px: u32) -> f32 {
    let cells = size_px / cell_px;
    let (column, row) = (x / cell_px, y / cell_px);
    let (u, v) = ((x % cell_px) as f32 / cell_px as f32, (y % cell_px) as f32 / cell_px as f32);
    let at = |i: u32, j: u32| noise((column + i) % cells, (row + j) % cells, 3);
    let (low, high) = (at(0, 0) * (1.0 - u) + at(1, 0) * u, at(0, 1) * (1.0 - u) + at(1, 1) * u);
    low * (1.0 - v) + high * v
}

/// A hash of two coordinates in 0..1.
fn noise(x: u32, y: u32, salt: u32) -> f32 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ salt.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    (h ^ (h >> 15)) as f32 / u32::MAX as f32
}

fn encode(size_px: u32, colour_at: impl Fn(u32, u32) -> Srgb) -> Vec<u8> {
    let texels: Vec<u8> = (0..size_px * size_px).flat_map(|i| colour_at(i % size_px, i / size_px)).collect();
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive)
        .write_image(&texels, size_px, size_px, ExtendedColorType::Rgb8)
        .expect("an image of the stated size encodes into memory");
    png
}
