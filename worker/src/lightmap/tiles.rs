//! Squares of a block's texels: the parts of a lightmap that a hit is looked up in.

use super::Lightmap;

/// Side of a tile in texels. More → fewer tiles, more hits on those that an edit changes.
pub const TILE_TEXELS: u32 = 8;
/// The tiles of all blocks of a lightmap, numbered block by block and row by row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tiles {
    /// First tile of each block, and the end.
    starts: Vec<u32>,
    /// Size of each block in tiles.
    sizes: Vec<[u32; 2]>,
}

impl Tiles {
    /// Of a lightmap.
    pub fn of(lightmap: &Lightmap) -> Self {
        let sizes: Vec<[u32; 2]> =
            lightmap.blocks.iter().map(|block| block.size.map(|side| side.div_ceil(TILE_TEXELS))).collect();
        let mut starts = vec![0];
        sizes.iter().for_each(|[width, height]| starts.push(starts[starts.len() - 1] + width * height));
        Self { starts, sizes }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.starts.last().map_or(0, |end| *end as usize)
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Block of a tile, and its column and row there.
    pub fn place(&self, tile: u32) -> (u32, [u32; 2]) {
        let block = self.starts.partition_point(|start| *start <= tile) - 1;
        let (at, width) = (tile - self.starts[block], self.sizes[block][0]);
        (block as u32, [at % width, at / width])
    }

    /// The tiles that a box of texels of a block meets, from its lowest texel to its highest.
    pub fn of_box(&self, block: u32, [low, high]: [[i32; 2]; 2]) -> impl Iterator<Item = u32> + '_ {
        let size = self.sizes[block as usize];
        let range = move |axis: usize| {
            let tile = |texel: i32| (texel.max(0) as u32 / TILE_TEXELS).min(size[axis].saturating_sub(1));
            tile(low[axis])..tile(high[axis]) + 1
        };
        let first = self.starts[block as usize];
        range(1).flat_map(move |y| range(0).map(move |x| first + y * size[0] + x))
    }
}
