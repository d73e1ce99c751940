//! Where blocks lie in atlas pages, which texel is which receiver, and how irradiance is extended past chart edges.

use std::collections::HashMap;

use lightkiln_proto::manifest::Manifest;
#[cfg(doc)]
use lightkiln_proto::prt::Receivers;
use lightkiln_proto::prt::{BlockKey, Texel};

use super::{MAX_ATLAS_TEXELS, MAX_PAGE_SIDE, MAX_PAGES};
use crate::error::{ClientError, Result};

/// Marks a texel without a receiver.
pub const NO_RECEIVER: u32 = u32::MAX;
/// Empty texels as far as this from a receiver are filled. More → bridges larger holes, more memory.
pub const EXTENSION_TEXELS: i32 = 4;

/// A block and where it lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedBlock {
    /// Atlas page.
    pub page: u32,
    /// Corner in the page, in texels.
    pub origin: [u32; 2],
    /// Width and height in texels.
    pub size: [u32; 2],
    /// Index of its first texel in [`AtlasLayout::slot_of_texel`].
    first: usize,
}

/// A texel of the atlas that holds irradiance: the mean over `count` receivers, `sources[first..first + count]`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct AtlasTexel {
    /// Column in the page.
    pub x: u32,
    /// Row in the page.
    pub y: u32,
    /// First source in [`AtlasLayout::sources`].
    pub first: u32,
    /// Page in bits 0–15, [`Receivers::links`] in bits 16–19, whether it is a receiver's in bit 20, number of sources
    /// in bits 24–31.
    pub packed: u32,
}

/// Bit of [`AtlasTexel::packed`] that a receiver's own texel has; filled texels do not.
const IS_RECEIVER: u32 = 1 << 20;

impl AtlasTexel {
    /// Page.
    pub fn page(&self) -> u32 {
        self.packed & 0xFFFF
    }

    /// Fourth component in the atlas: `1 + links` for a receiver's texel, −1 for a filled one.
    pub fn kind(&self) -> f32 {
        if self.packed & IS_RECEIVER == 0 { -1.0 } else { (1 + (self.packed >> 16 & 0xF)) as f32 }
    }

    /// Number of sources.
    pub fn count(&self) -> u32 {
        self.packed >> 24
    }
}

/// Placement of all blocks.
#[derive(Debug, Default)]
pub struct AtlasLayout {
    /// Blocks in the manifest's order.
    pub blocks: Vec<PlacedBlock>,
    /// Pages: width and height.
    pub pages: Vec<[u32; 2]>,
    /// Slot of every texel of every block, block after block, row after row; [`NO_RECEIVER`] where there is none.
    pub slot_of_texel: Vec<u32>,
    /// Texels that hold irradiance.
    pub texels: Vec<AtlasTexel>,
    /// Slots that texels average.
    pub sources: Vec<u32>,
    by_key: HashMap<BlockKey, u32>,
}

impl AtlasLayout {
    /// Reads the manifest's blocks; every block must lie inside its page.
    pub(super) fn place(manifest: &Manifest) -> Result<Self> {
        check_pages(&manifest.pages)?;
        let mut layout = Self { pages: manifest.pages.clone(), ..Self::default() };
        let mut texel_count = 0_u64;
        for (index, block) in manifest.blocks.iter().enumerate() {
            let wrong = |problem: &str| ClientError::inconsistent(format!("block {index}"), problem);
            let Some(page) = manifest.pages.get(block.page as usize) else {
                return Err(wrong("lies in a page that does not exist"));
            };
            if block.size.contains(&0) {
                return Err(wrong("has no texels"));
            }
            let inside = |axis: usize| {
                u64::from(block.origin[axis]) + u64::from(block.size[axis]) <= u64::from(page[axis])
            };
            if !inside(0) || !inside(1) {
                return Err(wrong("does not fit into its page"));
            }
            let first = texel_count as usize;
            texel_count += u64::from(block.size[0]) * u64::from(block.size[1]);
            if texel_count > MAX_ATLAS_TEXELS {
                return Err(wrong("is one too many: the blocks together exceed the atlas' limit"));
            }
            if layout.by_key.insert(block.key, index as u32).is_some() {
                return Err(wrong("has the key of another block"));
            }
            let (page, origin, size) = (block.page, block.origin, block.size);
            layout.blocks.push(PlacedBlock { page, origin, size, first });
        }
        layout.slot_of_texel = vec![NO_RECEIVER; texel_count as usize];
        Ok(layout)
    }

    /// Index of a block by its key.
    pub fn block_index(&self, key: BlockKey) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    /// Slot of a receiver; `None` when the block does not exist or the texel has none.
    pub fn slot(&self, block: u32, texel: Texel) -> Option<u32> {
        let slot = self.slot_of_texel[self.texel_index(block, texel)?];
        (slot != NO_RECEIVER).then_some(slot)
    }

    /// Enters a receiver; the texel must be inside the block and free.
    pub(super) fn enter(
        &mut self,
        block: u32,
        texel: Texel,
        slot: u32,
    ) -> std::result::Result<(), &'static str> {
        let index = self.texel_index(block, texel).ok_or("lies outside its block")?;
        if self.slot_of_texel[index] != NO_RECEIVER {
            return Err("lies on the texel of another receiver");
        }
        self.slot_of_texel[index] = slot;
        Ok(())
    }

    fn texel_index(&self, block: u32, texel: Texel) -> Option<usize> {
        let block = self.blocks.get(block as usize)?;
        let [x, y] = texel.map(u32::from);
        (x < block.size[0] && y < block.size[1])
            .then(|| block.first + y as usize * block.size[0] as usize + x as usize)
    }

    /// Lists the texels that hold irradiance: receivers' own, and empty ones near them.
    ///
    /// An empty texel takes the mean of the receivers at the smallest Chebyshev distance within its block, so that
    /// bilinear reads at chart edges never meet an unlit texel.
    ///
    /// `links` are the receivers', by slot.
    pub(super) fn extend_edges(&mut self, links: &[u8]) {
        for index in 0..self.blocks.len() {
            let block = self.blocks[index];
            for y in 0..block.size[1] as i32 {
                for x in 0..block.size[0] as i32 {
                    self.extend_texel(&block, x, y, links);
                }
            }
        }
    }

    fn extend_texel(&mut self, block: &PlacedBlock, x: i32, y: i32, links: &[u8]) {
        let first = self.sources.len();
        let found = (0..=EXTENSION_TEXELS).find(|ring| {
            self.push_ring(block, x, y, *ring);
            self.sources.len() > first
        });
        let kind = match found {
            Some(0) => IS_RECEIVER | u32::from(links[self.sources[first] as usize] & 0xF) << 16,
            _ => 0,
        };
        let count = (self.sources.len() - first) as u32;
        if count > 0 {
            self.texels.push(AtlasTexel {
                x: block.origin[0] + x as u32,
                y: block.origin[1] + y as u32,
                first: first as u32,
                packed: block.page | kind | count << 24,
            });
        }
    }

    /// Adds the receivers at Chebyshev distance `ring` from a texel, in rows.
    fn push_ring(&mut self, block: &PlacedBlock, x: i32, y: i32, ring: i32) {
        let [width, height] = block.size.map(|side| side as i32);
        for row in (y - ring).max(0)..=(y + ring).min(height - 1) {
            let on_edge = row == y - ring || row == y + ring;
            let step = if on_edge || ring == 0 { 1 } else { 2 * ring };
            let mut column = x - ring;
            while column <= x + ring {
                if (0..width).contains(&column) {
                    let slot = self.slot_of_texel[block.first + (row * width + column) as usize];
                    if slot != NO_RECEIVER {
                        self.sources.push(slot);
                    }
                }
                column += step;
            }
        }
    }
}

fn check_pages(pages: &[[u32; 2]]) -> Result<()> {
    let wrong = |problem: String| Err(ClientError::inconsistent("atlas pages", problem));
    if pages.len() > MAX_PAGES {
        return wrong(format!("{} of them, at most {MAX_PAGES}", pages.len()));
    }
    if let Some(page) = pages.iter().find(|page| page.iter().any(|side| !(1..=MAX_PAGE_SIDE).contains(side)))
    {
        return wrong(format!("one is {} × {}, sides are 1..={MAX_PAGE_SIDE}", page[0], page[1]));
    }
    let texels: u64 = pages.iter().map(|page| u64::from(page[0]) * u64::from(page[1])).sum();
    if texels > MAX_ATLAS_TEXELS {
        return wrong(format!("{texels} texels, at most {MAX_ATLAS_TEXELS}"));
    }
    Ok(())
}
