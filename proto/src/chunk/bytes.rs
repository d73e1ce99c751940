//! Little-endian reading and writing; a reader checks every length before it takes or allocates anything.

use super::error::ChunkError;

/// Reads from the front of some bytes.
pub struct Reader<'a> {
    section: &'static str,
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Reader<'a> {
    /// Reads `bytes`; errors name `section`.
    pub fn new(section: &'static str, bytes: &'a [u8]) -> Self {
        Self { section, bytes, offset: 0 }
    }

    /// Offset of the next byte.
    pub fn offset(&self) -> usize {
        self.offset
    }

    /// Name used in errors.
    pub fn section(&self) -> &'static str {
        self.section
    }

    /// The next `count` items of `size` bytes.
    pub fn take(&mut self, what: &'static str, count: usize, size: usize) -> Result<&'a [u8], ChunkError> {
        let left = self.bytes.len() - self.offset;
        let wanted = (count as u64).saturating_mul(size as u64);
        if wanted > left as u64 {
            let (section, offset) = (self.section, self.offset);
            return Err(ChunkError::Truncated { section, what, offset, wanted, left: left as u64 });
        }
        let start = self.offset;
        self.offset += wanted as usize;
        Ok(&self.bytes[start..self.offset])
    }

    fn array<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], ChunkError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(what, 1, N)?);
        Ok(array)
    }

    /// One byte.
    pub fn u8(&mut self, what: &'static str) -> Result<u8, ChunkError> {
        Ok(self.array::<1>(what)?[0])
    }

    /// Two bytes.
    pub fn u16(&mut self, what: &'static str) -> Result<u16, ChunkError> {
        self.array(what).map(u16::from_le_bytes)
    }

    /// Four bytes.
    pub fn u32(&mut self, what: &'static str) -> Result<u32, ChunkError> {
        self.array(what).map(u32::from_le_bytes)
    }

    /// A number; it must be finite.
    pub fn f32(&mut self, what: &'static str) -> Result<f32, ChunkError> {
        let number = self.array(what).map(f32::from_le_bytes)?;
        super::error::all_finite(self.section, what, &[number])?;
        Ok(number)
    }

    /// `count` numbers of eight bytes.
    pub fn u64s(&mut self, what: &'static str, count: usize) -> Result<Vec<u64>, ChunkError> {
        let bytes = self.take(what, count, 8)?.chunks_exact(8);
        Ok(bytes.map(|b| b.iter().rev().fold(0, |value, &byte| value << 8 | u64::from(byte))).collect())
    }

    /// `count` finite numbers.
    pub fn f32s(&mut self, what: &'static str, count: usize) -> Result<Vec<f32>, ChunkError> {
        let bytes = self.take(what, count, 4)?.chunks_exact(4);
        let numbers: Vec<f32> = bytes.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        super::error::all_finite(self.section, what, &numbers)?;
        Ok(numbers)
    }

    /// Errs if anything is left.
    pub fn end(self) -> Result<(), ChunkError> {
        let extra = (self.bytes.len() - self.offset) as u64;
        let (section, offset) = (self.section, self.offset);
        if extra == 0 { Ok(()) } else { Err(ChunkError::Trailing { section, offset, extra }) }
    }
}

/// Appends `numbers`, little endian.
pub fn put_f32s(out: &mut Vec<u8>, numbers: &[f32]) {
    numbers.iter().for_each(|number| out.extend_from_slice(&number.to_le_bytes()));
}

/// Appends `numbers`, little endian.
pub fn put_u64s(out: &mut Vec<u8>, numbers: &[u64]) {
    numbers.iter().for_each(|number| out.extend_from_slice(&number.to_le_bytes()));
}
