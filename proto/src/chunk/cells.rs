//! Whole numbers of very different sizes, in cells of similar ones.
//!
//! Every cell has a shift chosen from its mean. Of each zigzag code, the bits above the shift go to the `high` bytes,
//! which are alike in all cells and compress well; the bits below it are as good as random and are packed as they are.
//! A cell of zeros is one byte. High and low parts are sections of their own, so that zstd sees one kind of byte.

use super::bytes::Reader;
use super::error::{ChunkError, in_range};
use super::ints::{unzigzag, zigzag};

/// Shift of a cell whose numbers are all zero; it has no high or low bits.
pub(super) const ZERO_CELL: u8 = 255;
/// Largest shift: the high part of a 32-bit code then still fits a byte.
pub(super) const SHIFT_MAX: u8 = 24;

/// Collects cells.
#[derive(Default)]
pub(super) struct CellWriter {
    shifts: Vec<u8>,
    high: Vec<u8>,
    low: Vec<u8>,
    /// Bits not in `low` yet, fewer than eight.
    pending: u64,
    pending_bits: u32,
}

impl CellWriter {
    /// Appends a cell.
    pub fn push(&mut self, values: &[i32]) {
        let codes = || values.iter().map(|&value| zigzag(value));
        let largest = codes().max().unwrap_or(0);
        if largest == 0 {
            self.shifts.push(ZERO_CELL);
            return;
        }
        let sum: u64 = values.iter().map(|value| u64::from(value.unsigned_abs())).sum();
        let count = values.len() as u64;
        let half_mean = sum / (2 * count);
        let by_mean = if sum > 2 * count { half_mean.ilog2() + 1 } else { 0 };
        let shift = by_mean.max((32 - largest.leading_zeros()).saturating_sub(8)).min(SHIFT_MAX.into());
        self.shifts.push(shift as u8);
        for code in codes() {
            self.high.push((code >> shift) as u8);
            self.push_low(code & ((1 << shift) - 1), shift);
        }
    }

    fn push_low(&mut self, bits: u32, count: u32) {
        self.pending |= u64::from(bits) << self.pending_bits;
        self.pending_bits += count;
        while self.pending_bits >= 8 {
            self.low.push(self.pending as u8);
            self.pending >>= 8;
            self.pending_bits -= 8;
        }
    }

    /// Shifts and high parts; low parts.
    pub fn finish(mut self) -> (Vec<u8>, Vec<u8>) {
        if self.pending_bits > 0 {
            self.low.push(self.pending as u8);
        }
        self.shifts.append(&mut self.high);
        (self.shifts, self.low)
    }
}

/// Gives cells back one by one.
pub(super) struct CellReader<'a> {
    shifts: &'a [u8],
    high: &'a [u8],
    low: &'a [u8],
    low_bit: usize,
}

impl<'a> CellReader<'a> {
    /// Cells of the given lengths; errs unless both parts have exactly the bytes that they need.
    pub fn new(
        high: &mut Reader<'a>,
        low: &mut Reader<'a>,
        lengths: impl Iterator<Item = usize> + Clone,
    ) -> Result<Self, ChunkError> {
        let shifts = high.take("shifts", lengths.clone().count(), 1)?;
        let (mut high_count, mut low_bits) = (0, 0);
        for (length, &shift) in lengths.zip(shifts) {
            if shift != ZERO_CELL {
                low_bits += length * in_range(high.section(), "shift", shift.into(), 0, SHIFT_MAX.into())?;
                high_count += length;
            }
        }
        let high = high.take("high parts", high_count, 1)?;
        let low = low.take("low parts", low_bits.div_ceil(8), 1)?;
        Ok(Self { shifts, high, low, low_bit: 0 })
    }

    /// Appends the next cell, of `length` numbers; lengths must come as given to [`Self::new`].
    pub fn next(&mut self, length: usize, values: &mut Vec<i32>) {
        let Some((&shift, shifts)) = self.shifts.split_first() else { return };
        self.shifts = shifts;
        if shift == ZERO_CELL {
            values.resize(values.len() + length, 0);
            return;
        }
        let (high, rest) = self.high.split_at(length.min(self.high.len()));
        self.high = rest;
        for &high in high {
            let low = self.take_low(shift.into());
            values.push(unzigzag(u32::from(high) << shift | low));
        }
    }

    fn take_low(&mut self, count: usize) -> u32 {
        let (first, offset) = (self.low_bit / 8, self.low_bit % 8);
        self.low_bit += count;
        // At most 24 + 7 bits: four bytes.
        let bytes = self.low[first.min(self.low.len())..].iter().take(4).rev();
        let bits = bytes.fold(0_u32, |bits, &byte| bits << 8 | u32::from(byte));
        (bits >> offset) & ((1 << count) - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn round_trip(cells: &[Vec<i32>]) -> Vec<Vec<i32>> {
        let mut writer = CellWriter::default();
        cells.iter().for_each(|cell| writer.push(cell));
        let (high, low) = writer.finish();
        let (mut high, mut low) = (Reader::new("high", &high), Reader::new("low", &low));
        let mut reader = CellReader::new(&mut high, &mut low, cells.iter().map(Vec::len)).unwrap();
        high.end().unwrap();
        low.end().unwrap();
        let mut read = |length| {
            let mut values = Vec::new();
            reader.next(length, &mut values);
            values
        };
        cells.iter().map(|cell| read(cell.len())).collect()
    }

    #[test]
    fn a_cell_of_zeros_is_one_byte() {
        let mut writer = CellWriter::default();
        writer.push(&[0; 100]);
        let (high, low) = writer.finish();
        assert_eq!((high.len(), low.len()), (1, 0));
    }

    proptest! {
        #[test]
        fn cells_come_back(cells in prop::collection::vec(
            prop_oneof![
                prop::collection::vec(-3..3, 0..40),
                prop::collection::vec(-3000..3000, 0..40),
                prop::collection::vec(any::<i32>(), 0..10),
                prop::collection::vec(prop_oneof![9 => Just(0), 1 => any::<i32>()], 0..40),
            ], 0..12))
        {
            prop_assert_eq!(round_trip(&cells), cells);
        }
    }
}
