//! Lightmap texels that hold irradiance: receivers' own, and empty ones near them.

use lightkiln_proto::relight::{LightmapTexels, ReceiverTable, SlotTable};

use crate::scene::{LightmapLayout, PlacedBlock};

/// A texel that holds irradiance: the mean over `count` receivers, `sources[first..first + count]`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct AtlasTexel {
    /// Column in the page.
    pub x: u32,
    /// Row in the page.
    pub y: u32,
    /// First source in [`AtlasTexels::sources`].
    pub first: u32,
    /// Page in bits 0–15, number of sources in bits 24–31.
    pub packed: u32,
    /// [`lightkiln_proto::relight::TexelKind`]: the fourth component in the atlas.
    pub kind: f32,
}

impl AtlasTexel {
    /// Page.
    pub fn page(&self) -> u32 {
        self.packed & 0xFFFF
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
    /// Receivers' texels, and empty ones near them, see [`LightmapTexels::push_sources`].
    pub fn new(layout: &LightmapLayout, slots: &SlotTable, receivers: &ReceiverTable) -> Self {
        let near = LightmapTexels { slots, receivers };
        let mut texels = Self::default();
        for (index, block) in layout.blocks.iter().enumerate() {
            for y in 0..block.size[1] {
                for x in 0..block.size[0] {
                    texels.extend(&near, (index as u32, block), [x, y]);
                }
            }
        }
        texels
    }

    fn extend(&mut self, near: &LightmapTexels<'_>, (index, block): (u32, &PlacedBlock), [x, y]: [u32; 2]) {
        let first = self.sources.len();
        let kind = near.push_sources(index, [x as u16, y as u16], &mut self.sources);
        let count = (self.sources.len() - first) as u32;
        if count > 0 {
            self.texels.push(AtlasTexel {
                x: block.origin[0] + x,
                y: block.origin[1] + y,
                first: first as u32,
                packed: block.page | count << 24,
                kind: kind.0,
            });
        }
    }
}
