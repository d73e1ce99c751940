//! Places blocks in atlas pages; the last step, so that no identity depends on it.

/// Smallest page side in texels; pages grow by doubling up to [`PAGE_MAX`].
const PAGE_MIN: u32 = 64;
/// Largest page side in texels; every GPU that runs the client has textures of this size.
const PAGE_MAX: u32 = 8192;
/// Corners of blocks lie on multiples of this, so that coarser levels of blocks start on whole texels.
const ALIGN: u32 = 8;

/// Where blocks lie.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pages {
    /// Width and height of each page.
    pub sizes: Vec<[u32; 2]>,
    /// Page and corner of each block, in the order given.
    pub places: Vec<(u32, [u32; 2])>,
}

/// Packs blocks of the given sizes on shelves, tallest first. A block wider than a page gets one of its own width.
pub fn pack(sizes: &[[u32; 2]]) -> Pages {
    let padded: Vec<[u32; 2]> =
        sizes.iter().map(|size| size.map(|side| side.next_multiple_of(ALIGN))).collect();
    let area: u64 = padded.iter().map(|[w, h]| u64::from(*w) * u64::from(*h)).sum();
    let widest = padded.iter().map(|[w, _]| *w).max().unwrap_or(PAGE_MIN);
    let mut width = PAGE_MIN;
    while (u64::from(width) * u64::from(width) < area && width < PAGE_MAX) || width < widest {
        width *= 2;
    }
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&index| {
        (std::cmp::Reverse(padded[index][1]), std::cmp::Reverse(padded[index][0]), index)
    });
    let mut pages = Pages { sizes: Vec::new(), places: vec![(0, [0, 0]); sizes.len()] };
    let (mut x, mut shelf_y, mut shelf_height) = (0, 0, 0);
    for index in order {
        let [w, h] = padded[index];
        if x + w > width {
            (x, shelf_y, shelf_height) = (0, shelf_y + shelf_height, 0);
        }
        let full = shelf_y > 0 && shelf_y + h > PAGE_MAX;
        if pages.sizes.is_empty() || full {
            pages.sizes.push([width, 0]);
            (x, shelf_y, shelf_height) = (0, 0, 0);
        }
        let page = pages.sizes.len() - 1;
        pages.places[index] = (page as u32, [x, shelf_y]);
        shelf_height = shelf_height.max(h);
        x += w;
        pages.sizes[page][1] = pages.sizes[page][1].max(shelf_y + shelf_height);
    }
    pages
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_lie_inside_their_page_and_do_not_overlap() {
        let sizes: Vec<[u32; 2]> = (1..200).map(|i| [1 + i * 37 % 300, 1 + i * 91 % 500]).collect();
        let pages = pack(&sizes);
        for (a, size) in sizes.iter().enumerate() {
            let (page, [x, y]) = pages.places[a];
            let [width, height] = pages.sizes[page as usize];
            assert!(x + size[0] <= width && y + size[1] <= height);
            for (b, other) in sizes.iter().enumerate().take(a) {
                let (other_page, [ox, oy]) = pages.places[b];
                let apart =
                    x + size[0] <= ox || ox + other[0] <= x || y + size[1] <= oy || oy + other[1] <= y;
                assert!(page != other_page || apart, "{a} and {b} overlap");
            }
        }
    }

    #[test]
    fn no_blocks_give_no_pages() {
        assert_eq!(pack(&[]), Pages::default());
    }
}
