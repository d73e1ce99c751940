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
/// Bit of a slot whose receiver only stands for that of the texel; above [`super::MAX_RECEIVERS`].
const STANDS_IN: u32 = 1 << 31;

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
    /// Side of walls that each texel is of, in the order of `slots`; empty where no receiver stands for others.
    sides: Vec<u32>,
}

/// The texel at an offset, if there can be one.
pub(super) fn beside(texel: Texel, [dx, dy]: [i32; 2]) -> Option<Texel> {
    let at = |axis: usize, step: i32| u16::try_from(i32::from(texel[axis]) + step).ok();
    Some([at(0, dx)?, at(1, dy)?])
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
        (slot & STANDS_IN == 0).then_some(slot)
    }

    /// Slot of the receiver of a texel, or of one that stands for it; `None` where there is neither.
    pub fn standing(&self, block: u32, texel: Texel) -> Option<u32> {
        let slot = self.slots[self.texel_index(block, texel)?];
        (slot != NONE).then_some(slot & !STANDS_IN)
    }

    /// Slot, block and texel of each receiver, block after block, row after row.
    pub fn receivers(&self) -> impl Iterator<Item = (u32, u32, Texel)> {
        let of_block = |(index, block): (usize, &Block)| {
            let [width, height] = block.size.map(|side| side as usize);
            let own = &self.slots[block.first..][..width * height];
            let receiver = move |(place, &slot): (usize, &u32)| {
                let texel = [(place % width) as u16, (place / width) as u16];
                (slot & STANDS_IN == 0).then_some((slot, index as u32, texel))
            };
            own.iter().enumerate().filter_map(receiver)
        };
        self.blocks.iter().enumerate().flat_map(of_block)
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

    /// Whether two texels of a block are of one side of walls, as far as sides are known.
    pub fn are_of_one_side(&self, block: u32, a: Texel, b: Texel) -> bool {
        let side = |texel| self.texel_index(block, texel).and_then(|index| self.sides.get(index).copied());
        side(a).is_some_and(|of_a| of_a != NONE && side(b) == Some(of_a))
    }

    /// Slot of the receiver that stands for that of a texel whose surroundings are all of its side, so that no wall cuts the
    /// texel; `None` for all others.
    pub fn standing_inside(&self, block: u32, texel: Texel) -> Option<u32> {
        let own = self.texel_index(block, texel).map(|index| self.slots[index]);
        let slot = own.filter(|&slot| slot != NONE && slot & STANDS_IN != 0)? & !STANDS_IN;
        let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| beside(texel, [dx, dy])));
        around
            .all(|other| other.is_some_and(|other| self.are_of_one_side(block, texel, other)))
            .then_some(slot)
    }

    /// Says of which side of all walls a texel is; texels outside of their block are left out.
    pub(super) fn set_side(&mut self, block: u32, texel: Texel, side: u32) {
        if let Some(index) = self.texel_index(block, texel) {
            self.sides.resize(self.slots.len(), NONE);
            self.sides[index] = side;
        }
    }

    /// Makes the receiver at `slot` stand for that of a texel which has none; texels outside of their block are left out.
    pub(super) fn stand_in(&mut self, block: u32, texel: Texel, slot: u32) {
        if let Some(index) = self.texel_index(block, texel).filter(|&index| self.slots[index] == NONE) {
            self.slots[index] = slot | STANDS_IN;
        }
    }

    fn texel_index(&self, block: u32, texel: Texel) -> Option<usize> {
        let block = self.blocks.get(block as usize)?;
        let [x, y] = texel.map(u32::from);
        (x < block.size[0] && y < block.size[1])
            .then(|| block.first + y as usize * block.size[0] as usize + x as usize)
    }
}
