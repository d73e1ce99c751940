//! Scales of columns: how much coarser the numbers of some columns of ΣVᵀ are stored than those of others, where each key has
//! one column.
//!
//! A number's error counts by the light that its column reads. Patches beside each other differ in radiance by far less than
//! either has, and the less the smaller they are, so a column of differences is worth fewer bits.

use super::bytes::Reader;
use super::error::{ChunkError, in_range};
use crate::content::{ColumnKey, PatchKey};

/// Scale of a step: `2^(code/4)`.
const QUARTERS: [f32; 4] = [1.0, 1.189_207_1, std::f32::consts::SQRT_2, 1.681_792_8];
/// Highest code: a scale of 2¹⁶.
const CODE_MAX: u8 = 64;

/// Light that a column is expected to read, in deviations of a patch's radiance: that of a patch 1, of a part of the sky 0.7,
/// of a difference 0.05 at level 0 and half as much again at each level above, up to 1. Always `2^(−n/4)`.
pub fn column_deviation(key: ColumnKey) -> f32 {
    scale_of(code_of(PatchKey(key))).recip()
}

/// Columns whose numbers have one scale: those of patches, or of differences, of one level.
fn class(key: PatchKey) -> (bool, u64) {
    (key.is_difference(), key.level())
}

/// Code of the scale that the encoder gives a column: from the light of patches in Sponza under seven lights.
fn code_of(key: PatchKey) -> u8 {
    match class(key) {
        (true, level) => (52 - 7 * level.min(7) as u8) / 3,
        (false, _) => {
            if key.sky().is_some() {
                2
            } else {
                0
            }
        }
    }
}

fn scale_of(code: u8) -> f32 {
    (1_u32 << (code / 4)) as f32 * QUARTERS[usize::from(code % 4)]
}

/// Classes of ascending keys, in order.
fn classes(keys: &[ColumnKey]) -> Vec<(bool, u64)> {
    let mut classes: Vec<_> = keys.iter().map(|&key| class(PatchKey(key))).collect();
    classes.sort_unstable();
    classes.dedup();
    classes
}

/// Most raw bytes of the scales of `count` columns.
pub(super) fn scales_bytes_max(count: usize) -> u64 {
    count.min(32) as u64
}

/// Scale of each column as the encoder has them.
pub(super) fn scales(keys: &[ColumnKey]) -> Vec<f32> {
    keys.iter().map(|&key| scale_of(code_of(PatchKey(key)))).collect()
}

/// Appends the code of each class of `keys`.
pub(super) fn put_scales(out: &mut Vec<u8>, keys: &[ColumnKey]) {
    let of_class = |&class_: &(bool, u64)| {
        keys.iter().map(|&key| PatchKey(key)).find(|&key| class(key) == class_).map_or(0, code_of)
    };
    out.extend(classes(keys).iter().map(of_class));
}

/// Reads the scale of each column.
pub(super) fn take_scales(reader: &mut Reader, keys: &[ColumnKey]) -> Result<Vec<f32>, ChunkError> {
    let classes = classes(keys);
    let codes = reader.take("scales of columns", classes.len(), 1)?;
    for &code in codes {
        in_range(reader.section(), "scale of columns", code.into(), 0, CODE_MAX.into())?;
    }
    let of = |&key: &ColumnKey| {
        classes.binary_search(&class(PatchKey(key))).map_or(1.0, |place| scale_of(codes[place]))
    };
    Ok(keys.iter().map(of).collect())
}
