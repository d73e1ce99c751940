//! Cells of space that rays cross: a world-aligned grid over the scene, and the set of its cells that were crossed.
//!
//! Whoever casts a ray marks the cells along it. While those hold what they held, and the scene reaches no further where a ray
//! left it, the ray meets the same.

use std::cell::Cell;

use glam::{IVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::lattice::cell_of;

/// Cells along the longest side of a scene, at most twice as many. More → fewer rays that cross a changed cell and miss the
/// change, more to mark and to keep.
const CELLS_ALONG: f32 = 16.0;
/// By how much of its side a cell is wider than the grid says, when things are put in it: far above the rounding of a ray's
/// way through the grid.
pub const SLACK: f32 = 1.0 / 64.0;

/// The grid over a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Side of a cell in metres, a power of two.
    pub cell_m: f32,
    /// Lowest cell on the lattice of that side.
    pub low: IVec3,
    /// Cells along each axis; none of a grid that takes no marks.
    pub size: IVec3,
}

impl Grid {
    /// Cells of a power of two over some bounds, none narrower than `least_m`.
    pub fn over([low_m, high_m]: [Vec3; 2], least_m: f32) -> Self {
        let extent_m = (high_m - low_m).max_element().max(least_m).max(f32::MIN_POSITIVE);
        let mut cell_m = 1.0_f32;
        while cell_m * CELLS_ALONG < extent_m || cell_m < least_m {
            cell_m *= 2.0;
        }
        while cell_m * 0.5 * CELLS_ALONG >= extent_m && cell_m * 0.5 >= least_m {
            cell_m *= 0.5;
        }
        let slack = Vec3::splat(cell_m * SLACK);
        let low = cell_of(low_m - slack, cell_m);
        Self { cell_m, low, size: cell_of(high_m + slack, cell_m) - low + 1 }
    }

    /// How many cells there are.
    pub fn len(&self) -> usize {
        self.size.to_array().iter().map(|&side| side.max(0) as usize).product()
    }

    /// It takes no marks.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Cell of the lattice by its number.
    pub fn cell(&self, index: usize) -> IVec3 {
        let (index, size) = (index as i32, self.size);
        self.low + IVec3::new(index % size.x, index / size.x % size.y, index / (size.x * size.y))
    }

    /// Number of a cell of the lattice, if it is one of the grid.
    fn index(&self, cell: IVec3) -> Option<usize> {
        let at = cell - self.low;
        let is_inside = at.cmpge(IVec3::ZERO).all() && at.cmplt(self.size).all();
        is_inside.then(|| ((at.z * self.size.y + at.y) * self.size.x + at.x) as usize)
    }

    /// Numbers of the cells that a box meets.
    pub fn cells_of_box(&self, [low_m, high_m]: [Vec3; 2]) -> impl Iterator<Item = usize> + '_ {
        let first = cell_of(low_m, self.cell_m).max(self.low);
        let last = cell_of(high_m, self.cell_m).min(self.low + self.size - 1);
        let along = |axis: usize| first[axis]..last[axis] + 1;
        let row = move |y: i32, z: i32| (first.x..last.x + 1).map(move |x| IVec3::new(x, y, z));
        let [_, ys, zs] = [along(0), along(1), along(2)];
        zs.flat_map(move |z| ys.clone().flat_map(move |y| row(y, z))).filter_map(|cell| self.index(cell))
    }

    /// Numbers of the cells, each widened by its slack, that a triangle may meet: those of its bounds that its plane cuts.
    pub fn cells_of_triangle(&self, corners: [Vec3; 3]) -> Vec<usize> {
        let [a, b, c] = corners;
        let slack = Vec3::splat(self.cell_m * SLACK);
        let bounds = [a.min(b).min(c) - slack, a.max(b).max(c) + slack];
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3());
        let half = f64::from(self.cell_m * (0.5 + 2.0 * SLACK));
        let reach = half * normal.abs().element_sum();
        let meets = |&index: &usize| {
            let centre_m = (self.cell(index).as_dvec3() + 0.5) * f64::from(self.cell_m);
            normal.dot(centre_m - a.as_dvec3()).abs() <= reach
        };
        self.cells_of_box(bounds).filter(meets).collect()
    }
}

/// The cells of a grid that were crossed. Of one thread.
#[derive(Clone, Debug)]
pub struct Trail<'a> {
    grid: &'a Grid,
    bits: Vec<Cell<u64>>,
    has_left: Cell<bool>,
}

impl<'a> Trail<'a> {
    /// Nothing crossed yet.
    pub fn new(grid: &'a Grid) -> Self {
        Self { grid, bits: vec![Cell::new(0); grid.len().div_ceil(64)], has_left: Cell::new(false) }
    }

    /// A ray left the scene: it crossed all that might be beyond.
    pub fn has_left(&self) -> bool {
        self.has_left.get()
    }

    /// Numbers of the cells that were crossed, ascending.
    pub fn crossed(&self) -> impl Iterator<Item = usize> + '_ {
        let of_word = |(word, bits): (usize, &Cell<u64>)| {
            let bits = bits.get();
            (0..64).filter(move |bit| bits >> bit & 1 == 1).map(move |bit| word * 64 + bit)
        };
        self.bits.iter().enumerate().flat_map(of_word)
    }

    /// Words of the set, for trails of other threads to be put together.
    pub fn into_words(self) -> Vec<u64> {
        self.bits.into_iter().map(Cell::into_inner).collect()
    }

    fn mark(&self, index: usize) {
        let word = &self.bits[index / 64];
        word.set(word.get() | 1 << (index % 64));
    }

    /// Marks the cells that a box meets.
    pub fn mark_box(&self, low_m: Vec3, high_m: Vec3) {
        self.grid.cells_of_box([low_m, high_m]).for_each(|index| self.mark(index));
    }

    /// Marks the cells along a ray, up to `t` units of its direction, or to the end of the scene.
    pub fn mark_ray(&self, origin_m: Vec3, direction: Vec3, t: Option<f32>) {
        if t.is_none() {
            self.has_left.set(true);
        }
        if self.grid.is_empty() {
            return;
        }
        // From cell to cell, always across the nearest plane.
        let scale = 1.0 / f64::from(self.grid.cell_m);
        let from = origin_m.as_dvec3() * scale;
        let along = direction.as_dvec3() * scale;
        let end = t.map_or(f64::INFINITY, f64::from);
        let mut cell = from.floor().as_ivec3();
        let mut step = [0; 3];
        let (mut next, mut every) = ([f64::INFINITY; 3], [f64::INFINITY; 3]);
        for axis in 0..3 {
            if along[axis] != 0.0 {
                step[axis] = if along[axis] > 0.0 { 1 } else { -1 };
                let plane = f64::from(cell[axis] + i32::from(along[axis] > 0.0));
                next[axis] = (plane - from[axis]) / along[axis];
                every[axis] = 1.0 / along[axis].abs();
            }
        }
        while let Some(index) = self.grid.index(cell) {
            self.mark(index);
            let axis = usize::from(next[1] < next[0]);
            let axis = if next[2] < next[axis] { 2 } else { axis };
            if next[axis] > end || next[axis] == f64::INFINITY {
                return;
            }
            cell[axis] += step[axis];
            next[axis] += every[axis];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::{Sequence, uniform_sphere};

    #[test]
    fn point_of_a_ray_lies_in_a_crossed_cell_that_has_each_triangle_through_it() {
        let mut sequence = Sequence::new(3);
        let grid = Grid::over([Vec3::splat(-3.0), Vec3::new(5.0, 2.0, 4.0)], 0.1);
        assert!((16..=40).contains(&grid.size.max_element()), "{grid:?}");
        for _ in 0..400 {
            let mut place = || {
                Vec3::new(
                    sequence.next_f32() * 7.9 - 2.95,
                    sequence.next_f32() * 4.9 - 2.95,
                    sequence.next_f32() * 6.9 - 2.95,
                )
            };
            let (origin_m, end_m) = (place(), place());
            let trail = Trail::new(&grid);
            trail.mark_ray(origin_m, end_m - origin_m, Some(1.0));
            assert!(!trail.has_left());
            let crossed: Vec<usize> = trail.crossed().collect();
            for step in 0..=64 {
                let at_m = origin_m.lerp(end_m, step as f32 / 64.0);
                let out = [0, 1].map(|_| uniform_sphere(sequence.next_f32(), sequence.next_f32()));
                let met =
                    grid.cells_of_triangle([at_m - out[0], at_m + 2.0 * out[0] - out[1], at_m + out[1]]);
                // The point is in the triangle's middle parts, whatever its rounding.
                assert!(met.iter().any(|cell| crossed.contains(cell)), "{at_m}");
            }
        }
    }

    #[test]
    fn ray_that_meets_nothing_crosses_all_cells_to_the_end_of_the_scene() {
        let grid = Grid::over([Vec3::ZERO, Vec3::splat(4.0)], 0.1);
        let trail = Trail::new(&grid);
        trail.mark_ray(Vec3::splat(0.1), Vec3::X, None);
        assert!(trail.has_left());
        assert_eq!(
            trail.crossed().count() as i32,
            grid.size.x - 1,
            "all of a row but the cell of the slack before it"
        );
    }
}
