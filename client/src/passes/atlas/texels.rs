//! Lightmap texels that hold irradiance: receivers' own, and empty ones near them.

use lightkiln_proto::relight::SlotTable;

use crate::scene::{LightmapLayout, PlacedBlock};

/// Empty texels as far as this from a receiver are filled. More → bridges larger holes, more memory.
pub const EXTENSION_TEXELS: i32 = 4;

/// A texel that holds irradiance: the mean over `count` receivers, `sources[first..first + count]`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct AtlasTexel {
    /// Column in the page.
    pub x: u32,
    /// Row in the page.
    pub y: u32,
    /// First source in [`AtlasTexels::sources`].
    pub first: u32,
    /// Page in bits 0–15, the receiver's links in bits 16–19, whether it is a receiver's in bit 20, number of sources in
    /// bits 24–31.
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

/// All texels that hold irradiance.
#[derive(Debug, Default)]
pub struct AtlasTexels {
    /// Texels, block after block, row after row.
    pub texels: Vec<AtlasTexel>,
    /// Slots that texels average.
    pub sources: Vec<u32>,
}

impl AtlasTexels {
    /// Receivers' texels, and empty ones near them.
    ///
    /// An empty texel takes the mean of the receivers at the smallest Chebyshev distance within its block, so that
    /// bilinear reads at chart edges never meet an unlit texel. `links` are the receivers', by slot.
    pub fn new(layout: &LightmapLayout, slots: &SlotTable, links: &[u8]) -> Self {
        let mut texels = Self::default();
        for (index, block) in layout.blocks.iter().enumerate() {
            let near = Neighbourhood { slots, index: index as u32, size: block.size.map(|side| side as i32) };
            for y in 0..block.size[1] as i32 {
                for x in 0..block.size[0] as i32 {
                    texels.extend(&near, block, [x, y], links);
                }
            }
        }
        texels
    }

    fn extend(&mut self, near: &Neighbourhood<'_>, block: &PlacedBlock, [x, y]: [i32; 2], links: &[u8]) {
        let first = self.sources.len();
        let found = (0..=EXTENSION_TEXELS).find(|ring| {
            near.push_ring([x, y], *ring, &mut self.sources);
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
}

/// Receivers of one block.
struct Neighbourhood<'a> {
    slots: &'a SlotTable,
    index: u32,
    size: [i32; 2],
}

impl Neighbourhood<'_> {
    /// Adds the receivers at Chebyshev distance `ring` from a texel, in rows.
    fn push_ring(&self, [x, y]: [i32; 2], ring: i32, sources: &mut Vec<u32>) {
        let [width, height] = self.size;
        for row in (y - ring).max(0)..=(y + ring).min(height - 1) {
            let on_edge = row == y - ring || row == y + ring;
            let step = if on_edge || ring == 0 { 1 } else { 2 * ring };
            let columns = (x - ring..=x + ring).step_by(step as usize);
            for column in columns.filter(|column| (0..width).contains(column)) {
                sources.extend(self.slots.slot(self.index, [column as u16, row as u16]));
            }
        }
    }
}
