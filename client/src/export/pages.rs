//! Places of blocks in exported pages, each with a rim of its own: engines read across a block's edge.

use std::cmp::Reverse;

use crate::error::{ClientError, Result};
use crate::scene::MAX_PAGE_SIDE;

/// Texels around a block. Engines read bilinearly, one texel beyond a surface's edge.
pub const GUTTER: u32 = 1;
/// Smallest width of a page in texels.
const PAGE_MIN: u32 = 64;
/// Largest side of a page in texels, unless a block is larger: most adapters have textures of this size. WebGL 2 guarantees 2048.
pub const PAGE_MAX: u32 = 4096;

/// A block with its rim in a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Page.
    pub page: u32,
    /// Corner of the rim.
    pub corner: [u32; 2],
    /// Width and height with the rim.
    pub size: [u32; 2],
}

/// Pages and the blocks in them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pages {
    /// Width and height of each.
    pub sizes: Vec<[u32; 2]>,
    /// By block; `None` for one that is not exported.
    pub places: Vec<Option<Place>>,
}

impl Pages {
    /// Packs blocks on shelves, tallest first; sizes in texels of the pages, `None` for a block that is left out. Errs where one is too
    /// large for any page.
    pub fn pack(blocks: &[Option<[u32; 2]>]) -> Result<Self> {
        let padded = |size: &[u32; 2]| size.map(|side| side.saturating_add(2 * GUTTER));
        let sizes: Vec<Option<[u32; 2]>> = blocks.iter().map(|size| size.as_ref().map(padded)).collect();
        let largest = sizes.iter().flatten().flatten().copied().max().unwrap_or(0);
        if largest > MAX_PAGE_SIDE {
            let what = format!("a block of {largest} texels");
            let problem = format!("is too large for a page of {MAX_PAGE_SIDE}: export with a lower --scale");
            return Err(ClientError::Argument { what, problem });
        }
        let width = width_of(&sizes);
        let mut order: Vec<(usize, [u32; 2])> =
            sizes.iter().enumerate().filter_map(|(index, size)| Some((index, (*size)?))).collect();
        order.sort_by_key(|&(index, [width, height])| (Reverse(height), Reverse(width), index));
        let mut pages = Self { sizes: Vec::new(), places: vec![None; blocks.len()] };
        let mut shelf = Shelf::default();
        for (index, size) in order {
            if shelf.x + size[0] > width {
                shelf = Shelf { x: 0, y: shelf.y + shelf.height, height: 0 };
            }
            if pages.sizes.is_empty() || (shelf.y > 0 && shelf.y + size[1] > PAGE_MAX) {
                pages.sizes.push([width, 0]);
                shelf = Shelf::default();
            }
            let page = pages.sizes.len() - 1;
            pages.places[index] = Some(Place { page: page as u32, corner: [shelf.x, shelf.y], size });
            shelf = Shelf { x: shelf.x + size[0], y: shelf.y, height: shelf.height.max(size[1]) };
            pages.sizes[page][1] = pages.sizes[page][1].max(shelf.y + shelf.height);
        }
        Ok(pages)
    }
}

/// A row of blocks.
#[derive(Clone, Copy, Debug, Default)]
struct Shelf {
    x: u32,
    y: u32,
    height: u32,
}

/// A power of two whose square holds all blocks, if a page may be so large.
fn width_of(sizes: &[Option<[u32; 2]>]) -> u32 {
    let area: u64 =
        sizes.iter().flatten().map(|[width, height]| u64::from(*width) * u64::from(*height)).sum();
    let widest = sizes.iter().flatten().map(|[width, _]| *width).max().unwrap_or(0);
    let mut width = PAGE_MIN;
    while (width < PAGE_MAX && u64::from(width) * u64::from(width) < area) || width < widest {
        width *= 2;
    }
    width
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_with_their_rims_lie_inside_their_page_and_apart() {
        let blocks: Vec<Option<[u32; 2]>> =
            (1..150_u32).map(|i| (i % 7 != 0).then_some([1 + i * 37 % 900, 1 + i * 91 % 1500])).collect();
        let pages = Pages::pack(&blocks).unwrap();
        assert!(pages.sizes.len() > 1, "{:?}", pages.sizes);
        assert!(pages.sizes.iter().flatten().all(|side| *side <= PAGE_MAX));
        let placed: Vec<Place> = pages.places.iter().flatten().copied().collect();
        assert_eq!(placed.len(), blocks.iter().flatten().count());
        for (index, a) in placed.iter().enumerate() {
            let page = pages.sizes[a.page as usize];
            assert!((0..2).all(|axis| a.corner[axis] + a.size[axis] <= page[axis]));
            for b in &placed[..index] {
                let apart = (0..2).any(|axis| {
                    a.corner[axis] + a.size[axis] <= b.corner[axis]
                        || b.corner[axis] + b.size[axis] <= a.corner[axis]
                });
                assert!(a.page != b.page || apart, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn no_blocks_give_no_pages_and_giants_are_refused() {
        assert_eq!(Pages::pack(&[None]).unwrap(), Pages { sizes: vec![], places: vec![None] });
        let wide = Pages::pack(&[Some([9000, 3])]).unwrap();
        assert_eq!(wide.sizes, [[16_384, 5]]);
        assert!(Pages::pack(&[Some([MAX_PAGE_SIDE, 3])]).unwrap_err().to_string().contains("--scale"));
    }
}
