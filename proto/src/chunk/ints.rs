//! Arrays of whole numbers as byte planes: all lowest bytes, then all second bytes, and so on, so that zstd sees
//! bytes of one kind side by side.
//!
//! An array is one byte `width` (0…4) and `width` planes of `count` bytes; width 0 means that all are zero.
//! Signed numbers are zigzag coded first: 0, −1, 1, −2, … become 0, 1, 2, 3, ….

use super::bytes::Reader;
use super::error::{ChunkError, in_range};

/// 0, −1, 1, −2, … to 0, 1, 2, 3, ….
pub fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

/// Inverse of [`zigzag`].
pub fn unzigzag(code: u32) -> i32 {
    (code >> 1) as i32 ^ -((code & 1) as i32)
}

/// Appends an array.
pub fn put_u32s(out: &mut Vec<u8>, values: &[u32]) {
    let all = values.iter().fold(0, |bits, value| bits | value);
    let width = 4 - all.leading_zeros() / 8;
    out.push(width as u8);
    for plane in 0..width {
        out.extend(values.iter().map(|value| (value >> (8 * plane)) as u8));
    }
}

/// Appends an array of signed numbers.
pub fn put_i32s(out: &mut Vec<u8>, values: &[i32]) {
    let codes: Vec<u32> = values.iter().map(|&value| zigzag(value)).collect();
    put_u32s(out, &codes);
}

/// Reads an array of `count` numbers; the caller has checked `count`.
pub fn take_u32s(reader: &mut Reader, what: &'static str, count: usize) -> Result<Vec<u32>, ChunkError> {
    let width = reader.u8(what)?;
    let width = in_range(reader.section(), "byte width", width.into(), 0, 4)?;
    let planes = reader.take(what, count, width)?;
    let mut values = vec![0; count];
    if count > 0 {
        for (plane, bytes) in planes.chunks_exact(count).enumerate() {
            for (value, &byte) in values.iter_mut().zip(bytes) {
                *value |= u32::from(byte) << (8 * plane);
            }
        }
    }
    Ok(values)
}

/// Reads an array of `count` signed numbers.
pub fn take_i32s(reader: &mut Reader, what: &'static str, count: usize) -> Result<Vec<i32>, ChunkError> {
    Ok(take_u32s(reader, what, count)?.into_iter().map(unzigzag).collect())
}

/// Most bytes that an array of `count` numbers takes.
pub fn bytes_max(count: usize) -> u64 {
    1 + 4 * count as u64
}

/// Appends numbers as they are, one plane per byte of their bits.
pub fn put_f32_planes(out: &mut Vec<u8>, numbers: &[f32]) {
    let bits: Vec<u32> = numbers.iter().map(|number| number.to_bits()).collect();
    put_u32s(out, &bits);
}

/// Reads `count` finite numbers written by [`put_f32_planes`].
pub fn take_f32_planes(
    reader: &mut Reader,
    what: &'static str,
    count: usize,
) -> Result<Vec<f32>, ChunkError> {
    let numbers: Vec<f32> = take_u32s(reader, what, count)?.into_iter().map(f32::from_bits).collect();
    super::error::all_finite(reader.section(), what, &numbers)?;
    Ok(numbers)
}

/// Appends the differences between neighbours.
pub fn put_deltas(out: &mut Vec<u8>, values: impl Iterator<Item = i32>) {
    let mut before = 0;
    let deltas: Vec<i32> = values.map(|value| value - std::mem::replace(&mut before, value)).collect();
    put_i32s(out, &deltas);
}

/// Reads what [`put_deltas`] wrote; every value must lie in `allowed`.
pub fn take_deltas(
    reader: &mut Reader,
    what: &'static str,
    count: usize,
    allowed: std::ops::RangeInclusive<i32>,
) -> Result<Vec<i32>, ChunkError> {
    let mut values = take_i32s(reader, what, count)?;
    let mut before = 0_i32;
    for value in &mut values {
        *value = before.wrapping_add(*value);
        if !allowed.contains(value) {
            let (min, max) = (0, allowed.end().unsigned_abs().into());
            let section = reader.section();
            return Err(ChunkError::OutOfRange {
                section,
                what,
                value: value.unsigned_abs().into(),
                min,
                max,
            });
        }
        before = *value;
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_survive_at_every_width() {
        for values in [vec![], vec![0, 0], vec![1, -1, 63], vec![300, -5], vec![i32::MAX, i32::MIN, 0]] {
            let mut out = Vec::new();
            put_i32s(&mut out, &values);
            let mut reader = Reader::new("test", &out);
            assert_eq!(take_i32s(&mut reader, "values", values.len()).unwrap(), values);
            reader.end().unwrap();
        }
    }

    #[test]
    fn an_array_longer_than_its_bytes_is_refused() {
        let mut reader = Reader::new("test", &[4, 0, 0]);
        assert!(take_u32s(&mut reader, "values", usize::MAX / 2).is_err());
    }
}
