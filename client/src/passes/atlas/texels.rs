//! Lightmap texels that hold irradiance: receivers' own, and empty ones near them.

use lightkiln_proto::relight::{ReceiverTable, SlotTable, TexelKind};

use crate::scene::{LightmapLayout, PlacedBlock};

/// Empty texels as far as this from a receiver are filled. More → bridges larger holes, more memory.
pub const EXTENSION_TEXELS: i32 = 4;

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
    /// [`TexelKind`]: the fourth component in the atlas.
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
    /// Receivers' texels, and empty ones near them.
    ///
    /// An empty texel takes the mean of the receivers at the smallest Chebyshev distance within its block, so that
    /// bilinear reads at chart edges never meet an unlit texel.
    pub fn new(layout: &LightmapLayout, slots: &SlotTable, receivers: &ReceiverTable) -> Self {
        let mut texels = Self::default();
        for (index, block) in layout.blocks.iter().enumerate() {
            let near = Neighbourhood { slots, index: index as u32, size: block.size.map(|side| side as i32) };
            for y in 0..block.size[1] as i32 {
                for x in 0..block.size[0] as i32 {
                    texels.extend(&near, block, [x, y], receivers);
                }
            }
        }
        texels
    }

    fn extend(
        &mut self,
        near: &Neighbourhood<'_>,
        block: &PlacedBlock,
        [x, y]: [i32; 2],
        receivers: &ReceiverTable,
    ) {
        let first = self.sources.len();
        let found = (0..=EXTENSION_TEXELS).find(|ring| {
            near.push_ring([x, y], *ring, &mut self.sources);
            self.sources.len() > first
        });
        let kind = match found {
            Some(0) => {
                let slot = self.sources[first] as usize;
                TexelKind::of_receiver(receivers.links[slot], receivers.edge[slot])
            }
            _ => TexelKind::FILLED,
        };
        let count = (self.sources.len() - first) as u32;
        if count > 0 {
            self.texels.push(AtlasTexel {
                x: block.origin[0] + x as u32,
                y: block.origin[1] + y as u32,
                first: first as u32,
                packed: block.page | count << 24,
                kind: kind.0,
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
