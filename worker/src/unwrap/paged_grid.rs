//! An unbounded 2D grid that stores only the pages written to.

use std::collections::BTreeMap;

const PAGE_SIDE: i32 = 8;
const PAGE_CELLS: usize = (PAGE_SIDE * PAGE_SIDE) as usize;

/// Cells addressed by integer coordinates, `empty` until set.
pub(super) struct PagedGrid<T> {
    empty: T,
    pages: Vec<[T; PAGE_CELLS]>,
    page_at: BTreeMap<(i32, i32), u32>,
    recent: Option<((i32, i32), u32)>,
}

impl<T: Copy> PagedGrid<T> {
    /// A grid without pages.
    pub fn new(empty: T) -> Self {
        Self { empty, pages: Vec::new(), page_at: BTreeMap::new(), recent: None }
    }

    /// Empties every cell.
    pub fn clear(&mut self) {
        self.pages.clear();
        self.page_at.clear();
        self.recent = None;
    }

    /// Value of a cell.
    pub fn get(&mut self, x: i32, y: i32) -> T {
        let key = page_key(x, y);
        match self.recent.filter(|r| r.0 == key).map(|r| r.1).or_else(|| self.page_at.get(&key).copied()) {
            Some(page) => {
                self.recent = Some((key, page));
                self.pages[page as usize][cell_in_page(x, y)]
            }
            None => self.empty,
        }
    }

    /// Changes a cell and returns what it held.
    pub fn set(&mut self, x: i32, y: i32, value: T) -> T {
        let key = page_key(x, y);
        let page = match self.recent {
            Some((recent, page)) if recent == key => page,
            _ => *self.page_at.entry(key).or_insert_with(|| {
                self.pages.push([self.empty; PAGE_CELLS]);
                self.pages.len() as u32 - 1
            }),
        };
        self.recent = Some((key, page));
        std::mem::replace(&mut self.pages[page as usize][cell_in_page(x, y)], value)
    }

    /// Visits cells of written pages that meet `min..=max`, until `visit` returns true; whether it did.
    pub fn any_written(
        &self,
        min: (i32, i32),
        max: (i32, i32),
        mut visit: impl FnMut(i32, i32, T) -> bool,
    ) -> bool {
        let (low, high) = (page_key(min.0, min.1), page_key(max.0, max.1));
        let columns = low.0..=high.0;
        // A wide box over few pages: walk the pages, not the box.
        let is_sparse = i64::from(high.0) - i64::from(low.0) >= self.page_at.len() as i64;
        let mut in_pages = |(key, page): (&(i32, i32), &u32)| {
            let cells = &self.pages[*page as usize];
            (0..PAGE_CELLS as i32).any(|i| {
                let (x, y) = (key.0 * PAGE_SIDE + i % PAGE_SIDE, key.1 * PAGE_SIDE + i / PAGE_SIDE);
                let inside = (min.0..=max.0).contains(&x) && (min.1..=max.1).contains(&y);
                inside && visit(x, y, cells[i as usize])
            })
        };
        if is_sparse {
            self.page_at.range(low..=high).filter(|p| (low.1..=high.1).contains(&p.0.1)).any(in_pages)
        } else {
            columns.into_iter().any(|x| self.page_at.range((x, low.1)..=(x, high.1)).any(&mut in_pages))
        }
    }
}

fn page_key(x: i32, y: i32) -> (i32, i32) {
    (x.div_euclid(PAGE_SIDE), y.div_euclid(PAGE_SIDE))
}

fn cell_in_page(x: i32, y: i32) -> usize {
    (x.rem_euclid(PAGE_SIDE) + y.rem_euclid(PAGE_SIDE) * PAGE_SIDE) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_keep_what_was_set_on_both_sides_of_the_origin() {
        let mut grid = PagedGrid::new(0);
        for (x, y) in [(-1, -1), (0, 0), (-9, 100_000), (7, 8)] {
            assert_eq!(grid.set(x, y, x + y + 1000), 0);
        }
        assert_eq!(grid.get(-9, 100_000), 100_991);
        assert_eq!(grid.get(-10, 100_000), 0);
        let mut seen = Vec::new();
        grid.any_written((-1, -1), (7, 7), |x, y, value| {
            if value != 0 {
                seen.push((x, y));
            }
            false
        });
        assert_eq!(seen, [(-1, -1), (0, 0)]);
    }
}
