//! The one order in which receivers are stored: coarse levels first, then block key, then the Morton code of the
//! texel. The same receivers give the same bytes, however the baker listed them.

use super::error::{ChunkError, in_range};
use crate::content::{BlockKey, Receivers, Texel};

/// Most levels of receivers.
pub const LEVELS_MAX: u32 = 4;

/// Bits of x and y interleaved, x lowest: neighbours in the code are mostly neighbours in the plane.
pub fn morton(texel: Texel) -> u32 {
    spread(texel[0]) | spread(texel[1]) << 1
}

/// Inverse of [`morton`].
pub(super) fn texel_of(morton: u32) -> Texel {
    [gather(morton), gather(morton >> 1)]
}

fn spread(bits: u16) -> u32 {
    let mut wide = u32::from(bits);
    wide = (wide | wide << 8) & 0x00ff_00ff;
    wide = (wide | wide << 4) & 0x0f0f_0f0f;
    wide = (wide | wide << 2) & 0x3333_3333;
    (wide | wide << 1) & 0x5555_5555
}

fn gather(wide: u32) -> u16 {
    let mut bits = wide & 0x5555_5555;
    bits = (bits | bits >> 1) & 0x3333_3333;
    bits = (bits | bits >> 2) & 0x0f0f_0f0f;
    bits = (bits | bits >> 4) & 0x00ff_00ff;
    (bits | bits >> 8) as u16
}

/// How receivers are rearranged for storage.
pub(super) struct Arrangement {
    /// Blocks that are used, ascending by key.
    pub blocks: Vec<BlockKey>,
    /// For each receiver in stored order, its index in the input.
    pub source: Vec<usize>,
    /// For each receiver in stored order, its index into `blocks`.
    pub block: Vec<u16>,
    /// Receivers of each level, finest (0) first.
    pub counts: [usize; LEVELS_MAX as usize],
}

impl Arrangement {
    /// Sorts receivers into stored order. Errs if one names no block or two share a texel.
    pub fn of(receivers: &Receivers, levels: u32) -> Result<Self, ChunkError> {
        let section = "encoder";
        let mut blocks = Vec::with_capacity(receivers.len());
        for &block in &receivers.block {
            let count = receivers.blocks.len() as u64;
            let index = in_range(section, "block index + 1", u64::from(block) + 1, 1, count)? - 1;
            blocks.push(receivers.blocks[index]);
        }
        let key_of = blocks.clone();
        blocks.sort_unstable();
        blocks.dedup();
        let mut counts = [0; LEVELS_MAX as usize];
        let mut keyed: Vec<(u32, u16, u32, usize)> = Vec::with_capacity(receivers.len());
        for (index, (&texel, key)) in receivers.texel.iter().zip(&key_of).enumerate() {
            let level = Receivers::level(texel, levels);
            counts[level as usize] += 1;
            let block = blocks.partition_point(|other| other < key) as u16;
            keyed.push((LEVELS_MAX - level, block, morton(texel), index));
        }
        keyed.sort_unstable();
        if let Some(index) =
            keyed.windows(2).position(|pair| (pair[0].1, pair[0].2) == (pair[1].1, pair[1].2))
        {
            return Err(ChunkError::Order { section, what: "receiver (its texel is taken)", index });
        }
        let source = keyed.iter().map(|entry| entry.3).collect();
        let block = keyed.iter().map(|entry| entry.1).collect();
        Ok(Self { blocks, source, block, counts })
    }

    /// `values` in stored order.
    pub fn sorted<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.source.iter().map(|&index| values[index]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_codes_go_there_and_back() {
        for texel in [[0, 0], [1, 0], [0, 1], [65_535, 12_345], [7, 65_535]] {
            assert_eq!(texel_of(morton(texel)), texel);
        }
        assert_eq!([morton([1, 0]), morton([0, 1]), morton([3, 3])], [1, 2, 15]);
    }

    #[test]
    fn coarse_levels_come_first_then_blocks_by_key() {
        let receivers = Receivers {
            blocks: vec![9, 5],
            block: vec![0, 0, 1, 1],
            texel: vec![[1, 0], [4, 4], [3, 3], [2, 0]],
            ..Receivers::default()
        };
        let arrangement = Arrangement::of(&receivers, 3).unwrap();
        assert_eq!(arrangement.source, [1, 3, 2, 0]);
        assert_eq!(arrangement.blocks, [5, 9]);
        assert_eq!(arrangement.counts, [2, 1, 1, 0]);
    }

    #[test]
    fn two_receivers_on_one_texel_are_refused() {
        let receivers = Receivers {
            blocks: vec![9],
            block: vec![0, 0],
            texel: vec![[1, 0], [1, 0]],
            ..Receivers::default()
        };
        assert!(Arrangement::of(&receivers, 3).is_err());
    }
}
