//! The lightmap's layout: pages, and the places of blocks in them.

use std::collections::HashMap;

use lightkiln_proto::content::BlockKey;
use lightkiln_proto::manifest::{Block, Lightmap, Manifest};

use crate::error::{ClientError, Result};

/// Most texels of all pages together.
pub const MAX_ATLAS_TEXELS: u64 = lightkiln_proto::relight::MAX_TEXELS;
/// Most pages.
pub const MAX_PAGES: usize = 256;
/// Longest side of a page in texels.
pub const MAX_PAGE_SIDE: u32 = 1 << 14;
/// Marks a side of a draw that has no block.
pub const NO_BLOCK: u32 = u32::MAX;

/// A block and its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedBlock {
    /// Identity.
    pub key: BlockKey,
    /// Page.
    pub page: u32,
    /// Corner in the page, in texels.
    pub origin: [u32; 2],
    /// Width and height in texels.
    pub size: [u32; 2],
}

/// Pages and blocks of a bake; there are none where its kind has no lightmap.
#[derive(Clone, Debug, Default)]
pub struct LightmapLayout {
    /// Pages: width and height in texels.
    pub pages: Vec<[u32; 2]>,
    /// Blocks in the manifest's order.
    pub blocks: Vec<PlacedBlock>,
    by_key: HashMap<BlockKey, u32>,
}

impl LightmapLayout {
    /// Reads the manifest's blocks, if it has some; every block must lie inside its page.
    pub(super) fn new(manifest: &Manifest) -> Result<Self> {
        let Some(Lightmap { pages, blocks, .. }) = &manifest.lightmap else { return Ok(Self::default()) };
        check_pages(pages)?;
        let mut layout = Self { pages: pages.clone(), ..Self::default() };
        for (index, block) in blocks.iter().enumerate() {
            let wrong = |problem: &str| ClientError::inconsistent(format!("block {index}"), problem);
            layout.blocks.push(placed(block, pages).map_err(wrong)?);
            if layout.by_key.insert(block.key, index as u32).is_some() {
                return Err(wrong("has the key of another block"));
            }
        }
        Ok(layout)
    }

    /// Index of a block by its key.
    pub fn block_index(&self, key: BlockKey) -> Option<u32> {
        self.by_key.get(&key).copied()
    }

    /// The block of an index; `None` for [`NO_BLOCK`].
    pub fn block(&self, index: u32) -> Option<&PlacedBlock> {
        self.blocks.get(index as usize)
    }
}

fn placed(block: &Block, pages: &[[u32; 2]]) -> std::result::Result<PlacedBlock, &'static str> {
    let page = pages.get(block.page as usize).ok_or("lies in a page that does not exist")?;
    if block.size.contains(&0) {
        return Err("has no texels");
    }
    let inside =
        |axis: usize| u64::from(block.origin[axis]) + u64::from(block.size[axis]) <= u64::from(page[axis]);
    if !inside(0) || !inside(1) {
        return Err("does not fit into its page");
    }
    Ok(PlacedBlock { key: block.key, page: block.page, origin: block.origin, size: block.size })
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
