//! Whether a triangle's projection overlaps what a chart already holds.
//!
//! A chart must map texels to one place of the surface. The rule, in texels:
//! - two triangles of at least [`SMALL_TEXELS`] must not penetrate each other by more than
//!   [`PENETRATION_TEXELS`] (separating axis test, exact up to rounding);
//! - smaller ones, and needles thinner than [`THIN_TEXELS`], are detail below the lattice's resolution: they may
//!   share a texel as long as the heights there span at most [`FOLD_TEXELS`], so the texel still stands for one
//!   spot of one surface.
//!
//! This keeps work linear where a texel holds thousands of triangles.

use glam::DVec2;

use super::paged_grid::PagedGrid;

/// Penetration of two triangles that counts as touching.
pub(super) const PENETRATION_TEXELS: f64 = 0.02;

/// Triangles whose bounds are shorter than this on both sides are small.
pub(super) const SMALL_TEXELS: f64 = 1.0;

/// Triangles lower than this on their longest side are small too.
pub(super) const THIN_TEXELS: f64 = 0.125;

/// Range of heights that one texel may stand for.
pub(super) const FOLD_TEXELS: f64 = 2.0;

/// More large triangles than this in the area of a texel are refused, which bounds the work on wild input.
const MAX_TEXEL_TRIANGLES: f64 = 256.0;

const END: u32 = u32::MAX;

/// A triangle projected by a chart's frame, in texels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// Corners on the lattice.
    pub uv: [DVec2; 3],
    /// Heights of the corners over the frame's plane.
    pub height: [f64; 3],
}

impl Footprint {
    /// Lower and upper corner of the bounds.
    pub fn bounds(&self) -> (DVec2, DVec2) {
        let [a, b, c] = self.uv;
        (a.min(b).min(c), a.max(b).max(c))
    }

    /// Whether the triangle is detail below the lattice's resolution.
    pub fn is_small(&self) -> bool {
        let (low, high) = self.bounds();
        if (high - low).max_element() < SMALL_TEXELS {
            return true;
        }
        let [a, b, c] = self.uv;
        let (_, longest) = self.longest_edge();
        (b - a).perp_dot(c - a).abs() < THIN_TEXELS * longest
    }

    /// Index of the longest edge, and its length.
    fn longest_edge(&self) -> (usize, f64) {
        let length = |edge: usize| self.uv[edge].distance(self.uv[(edge + 1) % 3]);
        (0..3).fold((0, 0.0), |best, edge| if length(edge) > best.1 { (edge, length(edge)) } else { best })
    }

    /// Points that stand for a small triangle, and their heights: its centre, or a row along a needle.
    fn samples(&self) -> impl Iterator<Item = (DVec2, f64)> {
        let (edge, longest) = self.longest_edge();
        let count = if longest < 1.5 { 1 } else { longest.ceil() as u32 };
        let (a, b, c) = (edge, (edge + 1) % 3, (edge + 2) % 3);
        let Self { uv, height } = *self;
        (0..count).map(move |i| {
            let along = (f64::from(i) + 0.5) / f64::from(count);
            // Slightly inwards, where the neighbour over the edge does not answer.
            let weights = [(1.0 - along) * 0.75, along * 0.75, 0.25];
            let mix =
                |values: [f64; 3]| values[a] * weights[0] + values[b] * weights[1] + values[c] * weights[2];
            (uv[a] * weights[0] + uv[b] * weights[1] + uv[c] * weights[2], mix(height))
        })
    }

    /// Height of the triangle's plane at a point when that lies inside, `None` outside.
    fn height_at(&self, point: DVec2) -> Option<f64> {
        let [a, b, c] = self.uv;
        let doubled = (b - a).perp_dot(c - a);
        if doubled <= 0.0 {
            return None;
        }
        let weights = [(b, c), (c, a), (a, b)].map(|(p, q)| (p - point).perp_dot(q - point) / doubled);
        let inside = weights.iter().all(|&w| w >= 0.0);
        inside.then(|| weights.iter().zip(self.height).map(|(w, h)| w * h).sum())
    }
}

/// How far two triangles penetrate: the least overlap over their six edge normals; ≤ 0 when apart.
pub(super) fn penetration(a: &[DVec2; 3], b: &[DVec2; 3]) -> f64 {
    let mut least = f64::INFINITY;
    for triangle in [a, b] {
        for edge in 0..3 {
            let axis = (triangle[(edge + 1) % 3] - triangle[edge]).perp().normalize_or_zero();
            if axis == DVec2::ZERO {
                continue;
            }
            let (low_a, high_a) = extent_along(axis, a);
            let (low_b, high_b) = extent_along(axis, b);
            least = least.min((high_a - low_b).min(high_b - low_a));
            if least <= 0.0 {
                return least;
            }
        }
    }
    if least.is_finite() { least } else { 0.0 }
}

fn extent_along(axis: DVec2, triangle: &[DVec2; 3]) -> (f64, f64) {
    let [a, b, c] = triangle.map(|p| p.dot(axis));
    (a.min(b).min(c), a.max(b).max(c))
}

/// Visits the cells of side `cell` that a triangle reaches by more than `inset` (negative: also those it misses by
/// less), row by row, until `visit` returns true; whether it did.
pub(super) fn any_cell(
    uv: &[DVec2; 3],
    cell: f64,
    inset: f64,
    mut visit: impl FnMut(i32, i32) -> bool,
) -> bool {
    let low = uv[0].y.min(uv[1].y).min(uv[2].y);
    let high = uv[0].y.max(uv[1].y).max(uv[2].y);
    let (first, last) = (((low + inset) / cell).floor(), ((high - inset) / cell).floor());
    for y in first as i32..=last as i32 {
        let bottom = (f64::from(y) * cell).max(low);
        let top = (f64::from(y + 1) * cell).min(high);
        let Some((left, right)) = band_extent(uv, bottom, top) else { continue };
        let (first, last) = (((left + inset) / cell).floor(), ((right - inset) / cell).floor());
        if (first as i32..=last as i32).any(|x| visit(x, y)) {
            return true;
        }
    }
    false
}

/// Least and greatest x of the part of a triangle with y in `bottom..=top`.
fn band_extent(uv: &[DVec2; 3], bottom: f64, top: f64) -> Option<(f64, f64)> {
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut include = |x: f64| {
        left = left.min(x);
        right = right.max(x);
    };
    for edge in 0..3 {
        let (a, b) = (uv[edge], uv[(edge + 1) % 3]);
        if (bottom..=top).contains(&a.y) {
            include(a.x);
        }
        for line in [bottom, top] {
            if (a.y < line) != (b.y < line) {
                include(a.x + (b.x - a.x) * ((line - a.y) / (b.y - a.y)));
            }
        }
    }
    (left <= right).then_some((left, right))
}

/// Heights of the small triangles centred in a texel, and where the first one lies.
#[derive(Clone, Copy)]
struct SmallCell {
    low: f64,
    high: f64,
    at: DVec2,
}

impl SmallCell {
    const EMPTY: Self = Self { low: f64::INFINITY, high: f64::NEG_INFINITY, at: DVec2::ZERO };

    fn is_empty(&self) -> bool {
        self.low > self.high
    }
}

/// An entry in a cell's list of large triangles.
struct Link {
    footprint: u32,
    next: u32,
    length: u32,
}

enum Undo {
    Large { x: i32, y: i32, head: u32 },
    Small { x: i32, y: i32, cell: SmallCell },
}

/// Cells that one chart covers.
pub(super) struct Cover {
    cell_texels: f64,
    large: Vec<Footprint>,
    large_at: PagedGrid<u32>,
    links: Vec<Link>,
    /// The query that last tested each large triangle.
    tested: Vec<u64>,
    query: u64,
    small_at: PagedGrid<SmallCell>,
    undo: Vec<Undo>,
}

/// A state to return to.
pub(super) struct Checkpoint {
    large: usize,
    links: usize,
    undo: usize,
}

impl Cover {
    /// An empty cover; cells of large triangles have the given side, small ones use texels.
    pub fn new(cell_texels: f64) -> Self {
        Self {
            cell_texels,
            large: Vec::new(),
            large_at: PagedGrid::new(END),
            links: Vec::new(),
            tested: Vec::new(),
            query: 0,
            small_at: PagedGrid::new(SmallCell::EMPTY),
            undo: Vec::new(),
        }
    }

    /// Empties the cover.
    pub fn clear(&mut self) {
        self.large.clear();
        self.large_at.clear();
        self.links.clear();
        self.small_at.clear();
        self.undo.clear();
    }

    /// A state to [`Cover::roll_back`] to.
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint { large: self.large.len(), links: self.links.len(), undo: self.undo.len() }
    }

    /// Takes back all insertions since the checkpoint.
    pub fn roll_back(&mut self, to: &Checkpoint) {
        while self.undo.len() > to.undo {
            match self.undo.pop() {
                Some(Undo::Large { x, y, head }) => self.large_at.set(x, y, head),
                Some(Undo::Small { x, y, cell }) => {
                    self.small_at.set(x, y, cell);
                    continue;
                }
                None => return,
            };
        }
        self.large.truncate(to.large);
        self.links.truncate(to.links);
    }

    /// Adds the triangle unless it overlaps what is there; whether it was added.
    pub fn try_insert(&mut self, footprint: Footprint) -> bool {
        if footprint.is_small() {
            self.try_insert_small(&footprint)
        } else {
            self.try_insert_large(footprint)
        }
    }

    fn try_insert_small(&mut self, footprint: &Footprint) -> bool {
        let checkpoint = self.checkpoint();
        let fits = footprint.samples().all(|(at, height)| self.try_insert_sample(at, height));
        if !fits {
            self.roll_back(&checkpoint);
        }
        fits
    }

    fn try_insert_sample(&mut self, at: DVec2, height: f64) -> bool {
        let cell = (at / self.cell_texels).floor();
        let mut next = self.large_at.get(cell.x as i32, cell.y as i32);
        while let Some(link) = self.links.get(next as usize) {
            let below = self.large[link.footprint as usize].height_at(at);
            if below.is_some_and(|h| (h - height).abs() > FOLD_TEXELS) {
                return false;
            }
            next = link.next;
        }
        let (x, y) = (at.x.floor() as i32, at.y.floor() as i32);
        let before = self.small_at.get(x, y);
        let at = if before.is_empty() { at } else { before.at };
        let after = SmallCell { low: before.low.min(height), high: before.high.max(height), at };
        if after.high - after.low > FOLD_TEXELS {
            return false;
        }
        self.small_at.set(x, y, after);
        self.undo.push(Undo::Small { x, y, cell: before });
        true
    }

    fn try_insert_large(&mut self, footprint: Footprint) -> bool {
        if self.overlaps_large(&footprint) || self.overlaps_small(&footprint) {
            return false;
        }
        let index = self.large.len() as u32;
        self.large.push(footprint);
        let Self { large_at, links, undo, .. } = self;
        any_cell(&footprint.uv, self.cell_texels, 1e-6, |x, y| {
            let head = large_at.set(x, y, links.len() as u32);
            let length = links.get(head as usize).map_or(0, |link| link.length) + 1;
            links.push(Link { footprint: index, next: head, length });
            undo.push(Undo::Large { x, y, head });
            false
        });
        true
    }

    fn overlaps_large(&mut self, footprint: &Footprint) -> bool {
        let Self { large, large_at, links, tested, query, .. } = self;
        let max_length = (MAX_TEXEL_TRIANGLES * self.cell_texels * self.cell_texels) as u32;
        *query += 1;
        tested.resize(large.len(), 0);
        any_cell(&footprint.uv, self.cell_texels, 1e-6, |x, y| {
            let mut next = large_at.get(x, y);
            if links.get(next as usize).is_some_and(|head| head.length >= max_length) {
                return true;
            }
            while let Some(link) = links.get(next as usize) {
                next = link.next;
                let other = link.footprint as usize;
                let is_new = std::mem::replace(&mut tested[other], *query) != *query;
                if is_new && penetration(&large[other].uv, &footprint.uv) > PENETRATION_TEXELS {
                    return true;
                }
            }
            false
        })
    }

    fn overlaps_small(&self, footprint: &Footprint) -> bool {
        let (low, high) = footprint.bounds();
        let (low, high) = (low.floor().as_ivec2(), high.floor().as_ivec2());
        self.small_at.any_written((low.x, low.y), (high.x, high.y), |_, _, cell| {
            !cell.is_empty()
                && footprint
                    .height_at(cell.at)
                    .is_some_and(|h| (cell.low - h).abs().max((cell.high - h).abs()) > FOLD_TEXELS)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(corners: [[f64; 2]; 3], height: f64) -> Footprint {
        Footprint { uv: corners.map(DVec2::from), height: [height; 3] }
    }

    #[test]
    fn neighbours_fit_and_overlaps_do_not() {
        let mut cover = Cover::new(2.0);
        assert!(cover.try_insert(flat([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]], 0.0)));
        assert!(cover.try_insert(flat([[0.0, 0.0], [10.0, 10.0], [0.0, 10.0]], 0.0)));
        assert!(!cover.try_insert(flat([[4.0, 4.0], [6.0, 4.0], [5.0, 7.0]], 0.0)));
        assert!(!cover.try_insert(flat([[-20.0, -20.0], [40.0, -20.0], [5.0, 40.0]], 0.0)));
        assert!(cover.try_insert(flat([[10.0, 0.0], [20.0, 0.0], [10.0, 10.0]], 0.0)));
    }

    #[test]
    fn small_triangles_share_a_texel_only_near_one_height() {
        let mut cover = Cover::new(1.0);
        let small = |height| flat([[0.2, 0.2], [0.8, 0.2], [0.5, 0.8]], height);
        assert!(cover.try_insert(small(0.0)) && cover.try_insert(small(1.0)));
        assert!(!cover.try_insert(small(3.0)));
        assert!(!cover.try_insert(flat([[-5.0, -5.0], [5.0, -5.0], [0.0, 5.0]], 9.0)));
        assert!(cover.try_insert(flat([[-5.0, -5.0], [5.0, -5.0], [0.0, 5.0]], 1.0)));
        assert!(!cover.try_insert(flat([[1.2, -0.2], [1.4, -0.2], [1.2, 0.0]], 9.0)));
    }

    #[test]
    fn rolling_back_frees_what_was_taken() {
        let mut cover = Cover::new(1.0);
        let big = flat([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]], 0.0);
        let checkpoint = cover.checkpoint();
        assert!(cover.try_insert(big) && !cover.try_insert(big));
        cover.roll_back(&checkpoint);
        assert!(cover.try_insert(big));
    }

    #[test]
    fn cells_of_a_triangle_are_those_it_reaches() {
        let uv = [[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]].map(DVec2::from);
        let mut seen = Vec::new();
        any_cell(&uv, 1.0, 1e-6, |x, y| {
            seen.push((x, y));
            false
        });
        assert_eq!(seen, [(0, 0), (1, 0), (0, 1)]);
    }
}
