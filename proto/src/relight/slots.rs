//! Block and texel → slot.

use std::collections::HashMap;

use super::Inconsistent;
use crate::content::{BlockKey, Texel};

/// Slot of a texel whose receiver no cluster has: no light reaches it, and it sends none.
pub const DARK: u32 = u32::MAX - 1;
/// Most texels of all blocks together.
pub const MAX_TEXELS: u64 = 1 << 27;

/// Marks a texel without a receiver.
const NONE: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Block {
    size: [u32; 2],
    /// Index of its first texel in [`SlotTable::slots`].
    first: usize,
}

/// Slot of every texel of every block.
#[derive(Debug, Default)]
pub struct SlotTable {
    blocks: Vec<Block>,
    by_key: HashMap<BlockKey, u32>,
    /// Block after block, row after row.
    slots: Vec<u32>,
}

impl SlotTable {
    /// Blocks by key and size in texels, all of their texels without receiver.
    pub fn new(blocks: impl IntoIterator<Item = (BlockKey, [u32; 2])>) -> Result<Self, Inconsistent> {
        let mut table = Self::default();
        let mut texels = 0_u64;
        for (index, (key, size)) in blocks.into_iter().enumerate() {
            let wrong = |problem| Err(Inconsistent::new(format!("block {index}"), problem));
            table.blocks.push(Block { size, first: texels as usize });
            texels = texels.saturating_add(u64::from(size[0]) * u64::from(size[1]));
            if texels > MAX_TEXELS {
                return wrong(format!("brings the texels above {MAX_TEXELS}"));
            }
            if table.by_key.insert(key, index as u32).is_some() {
                return wrong("has the key of another block".to_owned());
            }
        }
        table.slots = vec![NONE; texels as usize];
        Ok(table)
    }

    /// Index of a block by its key, in the order given.
    pub fn block_index(&self, key: BlockKey) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    /// Indices of blocks; errs when there is no block of a key.
    pub fn block_indices(&self, keys: &[BlockKey]) -> Result<Vec<u32>, String> {
        let find = |key: &BlockKey| {
            self.block_index(*key).ok_or_else(|| format!("names block {key:016x}, which the manifest lacks"))
        };
        keys.iter().map(find).collect()
    }

    /// Width and height of a block in texels.
    pub fn size(&self, block: u32) -> Option<[u32; 2]> {
        self.blocks.get(block as usize).map(|block| block.size)
    }

    /// Slot of a receiver by its block's index; `None` when the block does not exist or the texel has no receiver.
    pub fn slot(&self, block: u32, texel: Texel) -> Option<u32> {
        let slot = self.slots[self.texel_index(block, texel)?];
        (slot != NONE).then_some(slot)
    }

    /// Slot of a receiver by its block's key, as [`SlotTable::slot`].
    pub fn slot_of(&self, block: BlockKey, texel: Texel) -> Option<u32> {
        self.slot(self.block_index(block)?, texel)
    }

    /// Enters a receiver; its texel must be inside the block and free.
    pub(super) fn enter(&mut self, block: u32, texel: Texel, slot: u32) -> Result<(), &'static str> {
        let index = self.texel_index(block, texel).ok_or("lies outside its block")?;
        if self.slots[index] != NONE {
            return Err("lies on the texel of another receiver");
        }
        self.slots[index] = slot;
        Ok(())
    }

    fn texel_index(&self, block: u32, texel: Texel) -> Option<usize> {
        let block = self.blocks.get(block as usize)?;
        let [x, y] = texel.map(u32::from);
        (x < block.size[0] && y < block.size[1])
            .then(|| block.first + y as usize * block.size[0] as usize + x as usize)
    }
}
