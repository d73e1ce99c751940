//! Cells of space that rays cross: a world-aligned grid over the scene, and the set of its cells that were crossed.
//!
//! Whoever casts a ray marks the cells along it. While those hold what they held, and the scene reaches no further where a ray
//! left it, the ray meets the same.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use glam::{IVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::bits::OwnBits;
use super::lattice::cell_of;

/// Cells along the longest side of a scene, at least half as many unless there are too many in all. More → fewer rays that cross
/// a changed cell and miss the change, more to mark and to keep.
const CELLS_ALONG: f32 = 64.0;
/// Most cells of a grid. More → as above; and in open scenes as tall as wide tasks read more than a record may name.
const CELLS_MAX: usize = 1 << 15;
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
        let of_side = |cell_m: f32| {
            let slack = Vec3::splat(cell_m * SLACK);
            let low = cell_of(low_m - slack, cell_m);
            Self { cell_m, low, size: cell_of(high_m + slack, cell_m) - low + 1 }
        };
        let mut grid = of_side(cell_m);
        while grid.len() > CELLS_MAX {
            grid = of_side(2.0 * grid.cell_m);
        }
        grid
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

    /// Number of a cell of the grid, counted from the lowest.
    fn number(&self, at: IVec3) -> usize {
        ((at.z * self.size.y + at.y) * self.size.x + at.x) as usize
    }

    /// A place in cells from the lowest corner, exact but for far less than [`SLACK`].
    fn at(&self, place_m: Vec3) -> Vec3 {
        (place_m - self.low.as_vec3() * self.cell_m) * self.cell_m.recip()
    }

    /// Cell of the grid that is nearest to a place in cells, counted from the lowest.
    fn nearest(&self, at: Vec3) -> IVec3 {
        // Numbers below 0 are cut to 0 or less, which is the lowest all the same.
        at.as_ivec3().clamp(IVec3::ZERO, self.size - 1)
    }

    /// Units of a direction from a place of the grid to where the ray leaves it; 0 where it stands still.
    fn way_out(&self, from: Vec3, along: Vec3) -> f32 {
        let size = self.size.as_vec3();
        let of_axis = |axis: usize| {
            let wall = if along[axis] > 0.0 { size[axis] } else { 0.0 };
            if along[axis] == 0.0 { f32::INFINITY } else { (wall - from[axis]) / along[axis] }
        };
        let least = of_axis(0).min(of_axis(1)).min(of_axis(2));
        if least.is_finite() { least.max(0.0) } else { 0.0 }
    }

    /// Numbers of the cells that a box meets.
    pub fn cells_of_box(&self, [low_m, high_m]: [Vec3; 2]) -> impl Iterator<Item = usize> + '_ {
        let first = cell_of(low_m, self.cell_m).max(self.low);
        let last = cell_of(high_m, self.cell_m).min(self.low + self.size - 1);
        let along = |axis: usize| first[axis]..last[axis] + 1;
        let row = move |y: i32, z: i32| (first.x..last.x + 1).map(move |x| IVec3::new(x, y, z));
        let [_, ys, zs] = [along(0), along(1), along(2)];
        let inside = zs.flat_map(move |z| ys.clone().flat_map(move |y| row(y, z)));
        inside.map(|cell| self.number(cell - self.low))
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

/// The cells of a grid that the rays of a few receivers crossed.
///
/// Their rays go from a few cells to those of the surfaces around. So all cells that any way from one cell to another can cross
/// are marked at once, which holds more than the one ray's and never fewer.
#[derive(Debug)]
pub struct Trail<'a> {
    grid: &'a Grid,
    crossed: OwnBits,
    has_left: Cell<bool>,
    /// Cells that rays left from, each with the cells that they went to.
    ends: RefCell<Vec<(usize, Rc<OwnBits>)>>,
}

/// The part of a trail that rays from one point leave.
#[derive(Debug)]
pub struct TrailFrom<'a> {
    trail: &'a Trail<'a>,
    /// The point, in cells from the lowest corner.
    at: Vec3,
    cell: IVec3,
    /// `None` if the grid takes no marks.
    ends: Option<Rc<OwnBits>>,
}

impl TrailFrom<'_> {
    /// Marks the cells along a ray, up to `t` units of its direction, or to the end of the scene.
    pub fn mark(&self, direction: Vec3, t: Option<f32>) {
        let (trail, grid) = (self.trail, self.trail.grid);
        if t.is_none() {
            trail.has_left.set(true);
        }
        let Some(ends) = &self.ends else { return };
        let along = direction * grid.cell_m.recip();
        let end = t.unwrap_or_else(|| grid.way_out(self.at, along));
        let last = grid.nearest(self.at + along * end);
        if !ends.has(grid.number(last)) {
            trail.mark_between(self.cell, last);
            ends.add(grid.number(last));
        }
    }
}

impl<'a> Trail<'a> {
    /// Nothing crossed yet.
    pub fn new(grid: &'a Grid) -> Self {
        Self { grid, crossed: OwnBits::new(grid.len()), has_left: Cell::default(), ends: RefCell::default() }
    }

    /// Of rays from a point.
    pub fn from(&self, origin_m: Vec3) -> TrailFrom<'_> {
        let at = self.grid.at(origin_m);
        if self.grid.is_empty() {
            return TrailFrom { trail: self, at, cell: IVec3::ZERO, ends: None };
        }
        let cell = self.grid.nearest(at);
        TrailFrom { trail: self, at, cell, ends: Some(self.ends_from(self.grid.number(cell))) }
    }

    fn ends_from(&self, cell: usize) -> Rc<OwnBits> {
        let mut all = self.ends.borrow_mut();
        let known = all.iter().position(|(from, _)| *from == cell);
        let place = known.unwrap_or_else(|| {
            all.push((cell, Rc::new(OwnBits::new(self.grid.len()))));
            all.len() - 1
        });
        Rc::clone(&all[place].1)
    }

    /// A ray left the scene: it crossed all that might be beyond.
    pub fn has_left(&self) -> bool {
        self.has_left.get()
    }

    /// Cells of the lattice that were crossed, in the order of their numbers.
    pub fn crossed(&self) -> impl Iterator<Item = IVec3> + '_ {
        let Grid { low, size, .. } = *self.grid;
        // Rows are counted on, as divisions would cost more than all else.
        let (mut row, mut at) = (0, low);
        self.crossed.iter().map(move |index| {
            while index >= row + size.x as usize {
                row += size.x as usize;
                at.y += 1;
                if at.y == low.y + size.y {
                    (at.y, at.z) = (low.y, at.z + 1);
                }
            }
            at.with_x(low.x + (index - row) as i32)
        })
    }

    /// Marks the cells that a box meets.
    pub fn mark_box(&self, low_m: Vec3, high_m: Vec3) {
        if self.grid.is_empty() {
            return;
        }
        let [low, high] = [low_m, high_m].map(|corner_m| self.grid.nearest(self.grid.at(corner_m)));
        for (z, y) in (low.z..=high.z).flat_map(|z| (low.y..=high.y).map(move |y| (z, y))) {
            (low.x..=high.x).for_each(|x| self.crossed.add(self.grid.number(IVec3::new(x, y, z))));
        }
    }

    /// Marks all cells that a straight way from a point of cell `a` to a point of cell `b` can cross: those that are less than
    /// a cell from the line between their middles, along each axis.
    fn mark_between(&self, a: IVec3, b: IVec3) {
        let (a, way) = (a.to_array(), (b - a).to_array());
        let longest = (0..3).max_by_key(|&axis| way[axis].abs()).unwrap_or(0);
        let steps = way[longest].abs();
        let others = [(longest + 1) % 3, (longest + 2) % 3];
        let strides = [1, self.grid.size.x, self.grid.size.x * self.grid.size.y];
        let [mut u, mut v] = others.map(|axis| Band::of(a[axis], way[axis], steps));
        let mut at = a[longest] * strides[longest];
        for step in 0..=steps {
            for number in u.range().map(|u| at + u * strides[others[0]]) {
                v.range().for_each(|v| self.crossed.add((number + v * strides[others[1]]) as usize));
            }
            at += way[longest].signum() * strides[longest];
            [&mut u, &mut v].into_iter().for_each(|band| band.go_on(step));
        }
    }
}

/// Cells along an axis that are less than a cell from a line, while it goes on by steps along another axis.
struct Band {
    steps: i32,
    /// Places of the line a step before and a step after, both within its ends.
    near: [Place; 2],
    /// Length of the way along the axis.
    way: i32,
}

/// A place on a line in cells: `whole + rest / steps`.
#[derive(Clone, Copy)]
struct Place {
    whole: i32,
    rest: i32,
}

impl Band {
    /// At the start of a line from `a` over `way` cells in `steps`, `way` being no longer.
    fn of(a: i32, way: i32, steps: i32) -> Self {
        let mut band = Self { steps, near: [Place { whole: a, rest: 0 }; 2], way };
        if steps > 0 {
            band.advance(1);
        }
        band
    }

    /// From a step to the next.
    fn go_on(&mut self, step: i32) {
        if step > 0 {
            self.advance(0);
        }
        if step + 1 < self.steps {
            self.advance(1);
        }
    }

    fn advance(&mut self, which: usize) {
        let place = &mut self.near[which];
        place.rest += self.way;
        // The way is no longer than the steps, so that one of these is enough.
        if place.rest >= self.steps {
            (place.whole, place.rest) = (place.whole + 1, place.rest - self.steps);
        } else if place.rest < 0 {
            (place.whole, place.rest) = (place.whole - 1, place.rest + self.steps);
        }
    }

    fn range(&self) -> std::ops::RangeInclusive<i32> {
        let [one, other] = self.near;
        let [least, most] = if self.way < 0 { [other, one] } else { [one, other] };
        least.whole..=most.whole + i32::from(most.rest > 0)
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
        assert!((32..=66).contains(&grid.size.max_element()), "{grid:?}");
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
            trail.from(origin_m).mark(end_m - origin_m, Some(1.0));
            assert!(!trail.has_left());
            let crossed: Vec<usize> = trail.crossed().map(|cell| grid.number(cell - grid.low)).collect();
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
    fn grid_of_a_tall_scene_has_wider_cells_and_that_of_a_flat_one_as_many_along_it() {
        let of = |x: f32, y: f32, z: f32| Grid::over([Vec3::ZERO, Vec3::new(x, y, z)], 0.01);
        let [flat, tall] = [of(64.0, 4.0, 64.0), of(64.0, 64.0, 64.0)];
        assert_eq!((flat.cell_m, flat.size), (1.0, IVec3::new(66, 6, 66)));
        assert_eq!((tall.cell_m, tall.size), (4.0, IVec3::splat(18)), "34³ cells of 2 m are too many");
        let tower = of(16.0, 64.0, 16.0);
        assert_eq!((tower.cell_m, tower.size), (1.0, IVec3::new(18, 66, 18)));
        assert!([flat, tall, tower].iter().all(|grid| grid.len() <= CELLS_MAX));
    }

    #[test]
    fn ways_between_two_cells_cross_marked_cells_alone_and_none_beyond_both() {
        let mut sequence = Sequence::new(9);
        let grid = Grid::over([Vec3::ZERO, Vec3::splat(4.0)], 0.1);
        let mut place = || Vec3::new(sequence.next_f32(), sequence.next_f32(), sequence.next_f32());
        for _ in 0..300 {
            let [a, b] = [4.0 * place(), 4.0 * place()].map(|at_m| cell_of(at_m, grid.cell_m));
            let within = |cell: IVec3, at: Vec3| (cell.as_vec3() + at) * grid.cell_m;
            let trail = Trail::new(&grid);
            let (from_m, to_m) = (within(a, place()), within(b, place()));
            trail.from(from_m).mark(to_m - from_m, Some(1.0));
            let crossed: Vec<IVec3> = trail.crossed().collect();
            assert!(crossed.iter().all(|cell| cell.cmpge(a.min(b)).all() && cell.cmple(a.max(b)).all()));
            for _ in 0..40 {
                let (from_m, to_m) = (within(a, place()), within(b, place()));
                for step in 0..=100 {
                    let at_m = from_m.lerp(to_m, step as f32 / 100.0);
                    assert!(crossed.contains(&cell_of(at_m, grid.cell_m)), "{at_m} between {a} and {b}");
                }
            }
        }
    }

    /// The cells of [`Trail::mark_between`] by its words alone.
    fn between(a: IVec3, b: IVec3) -> Vec<IVec3> {
        let way = b - a;
        let steps = way.abs().max_element();
        let longest = (0..3).max_by_key(|&axis| way[axis].abs()).unwrap();
        let box_of = |a: i32, b: i32| a.min(b) - 1..=a.max(b) + 1;
        let cells = box_of(a.z, b.z).flat_map(|z| {
            box_of(a.y, b.y).flat_map(move |y| box_of(a.x, b.x).map(move |x| IVec3::new(x, y, z)))
        });
        let is_near = |cell: &IVec3| {
            let step = (cell[longest] - a[longest]) * way[longest].signum();
            a[longest] + step * way[longest].signum() == cell[longest]
                && (0..=steps).contains(&step)
                && (0..3).filter(|axis| *axis != longest).all(|axis| {
                    let at =
                        |step: i32| f64::from(way[axis] * step.clamp(0, steps)) / f64::from(steps.max(1));
                    let ends = [at(step - 1), at(step + 1)];
                    let [least, most] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
                    let cell = f64::from(cell[axis] - a[axis]);
                    (least.floor()..=most.ceil()).contains(&cell)
                })
        };
        cells.filter(is_near).collect()
    }

    #[test]
    fn ways_along_all_axes_mark_the_cells_beside_their_middle_and_no_others() {
        let grid = Grid { cell_m: 1.0, low: IVec3::splat(-3), size: IVec3::new(17, 12, 14) };
        let mut sequence = Sequence::new(4);
        for number in 0..2000 {
            let mut place =
                || (Vec3::from([(); 3].map(|()| sequence.next_f32())) * grid.size.as_vec3()).as_ivec3();
            let a = place();
            let b = if number == 0 { a } else { place() };
            let trail = Trail::new(&grid);
            trail.mark_between(a, b);
            assert!(trail.crossed().eq(between(a, b).into_iter().map(|cell| cell + grid.low)), "{a} to {b}");
        }
    }

    #[test]
    fn ray_that_meets_nothing_crosses_all_cells_to_the_end_of_the_scene() {
        let grid = Grid::over([Vec3::ZERO, Vec3::splat(4.0)], 0.1);
        let trail = Trail::new(&grid);
        trail.from(Vec3::splat(0.1)).mark(Vec3::X, None);
        assert!(trail.has_left());
        assert_eq!(
            trail.crossed().count() as i32,
            grid.size.x - 1,
            "all of a row but the cell of the slack before it"
        );
    }
}
