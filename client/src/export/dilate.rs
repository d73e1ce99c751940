//! Texels of a block as engines read them: bilinearly, across walls and rims alike.
//!
//! A client reads along links, so that light does not pass under a wall. An engine cannot: texels that hold no receiver's light are
//! chosen so that its reads come near to the client's, by least squares over points of the surface, within the light that
//! the client shows around each texel. Nothing overshoots.

use glam::{UVec2, Vec2, Vec3};
use lightkiln_proto::content::COVERAGE_SIDE;
use rayon::prelude::*;

use super::pages::GUTTER;
use crate::passes::atlas::Lightmap;
use crate::passes::atlas::reference::{AtlasPages, shown};
use crate::scene::{DrawTable, LoadedDraw};

/// Points along a texel's side at which reads are compared. More → nearer to the client's reads, more time.
const POINTS: u32 = 4;
/// Weight of points that no receiver has for its own: inside solids, or behind the wall that cuts its texel.
const HIDDEN_WEIGHT: f32 = 1.0 / 16.0;
/// Sweeps of the least squares. Texels without receivers are few in a row: each sweep leaves less than half of the error.
const SWEEPS: u32 = 24;
/// Marks a texel that is given.
const GIVEN: u32 = u32::MAX;

/// Light in a lightmap, to be read as the client reads it.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// The lightmap.
    pub lightmap: Lightmap<'a>,
    /// Its light.
    pub pages: &'a AtlasPages,
}

/// Triangles of each block, in its texels.
pub type Charts = Vec<Vec<[Vec2; 3]>>;

/// The triangles that read each of `count` blocks.
pub fn charts(draws: &DrawTable, count: usize) -> Charts {
    let mut charts: Charts = vec![Vec::new(); count];
    for draw in &draws.draws {
        for block in [draw.front, draw.back] {
            if let Some(chart) = charts.get_mut(block as usize) {
                chart.extend(draw.triangles.iter().map(|triangle| corners(draw, triangle)));
            }
        }
    }
    charts
}

fn corners(draw: &LoadedDraw, triangle: &[u32; 3]) -> [Vec2; 3] {
    triangle.map(|vertex| Vec2::from(draw.vertices[vertex as usize].lightmap_texel))
}

/// Texels of every block with its rim, row after row, `scale` along each of the lightmap's; none for a block that no triangle reads.
pub fn spread(light: Shown<'_>, charts: &Charts, scale: u32) -> Vec<Vec<Vec3>> {
    let blocks: Vec<(u32, &Vec<[Vec2; 3]>)> = (0..).zip(charts).collect();
    let texels = |(block, chart): &(u32, &Vec<[Vec2; 3]>)| match chart.is_empty() {
        true => Vec::new(),
        false => Sheet::new(light, *block, scale).texels(chart),
    };
    blocks.par_iter().map(texels).collect()
}

/// A point of the surface: the first of the four texels around it, its place between their centres, and the light that the
/// client shows there.
#[derive(Clone, Copy, Debug)]
struct Point {
    first: u32,
    share: Vec2,
    weight: f32,
    light: Vec3,
}

/// A block with its rim.
struct Sheet<'a> {
    light: Shown<'a>,
    block: u32,
    scale: u32,
    /// Width and height with the rim, in exported texels.
    size: UVec2,
}

impl<'a> Sheet<'a> {
    fn new(light: Shown<'a>, block: u32, scale: u32) -> Self {
        let own = light.lightmap.layout.block(block).map_or([0; 2], |block| block.size);
        Self { light, block, scale, size: UVec2::from(own) * scale + 2 * GUTTER }
    }

    fn texels(&self, chart: &[[Vec2; 3]]) -> Vec<Vec3> {
        let given = self.given();
        let mut number = vec![GIVEN; given.len()];
        let mut count = 0;
        for (number, _) in number.iter_mut().zip(&given).filter(|(_, given)| given.is_none()) {
            *number = count;
            count += 1;
        }
        let points = self.points(chart, &number);
        let texels: Vec<Vec3> = given.iter().map(|light| light.unwrap_or_default()).collect();
        let mut fit = Fit::new(points, number, count as usize, texels, self.size.x);
        for _ in 0..SWEEPS {
            fit.sweep();
        }
        let known =
            given.iter().zip(&fit.number).map(|(given, number)| given.is_some() || fit.is_read(*number));
        let known = known.collect();
        grown(fit.texels, known, self.size).iter().map(|light| light.max(Vec3::ZERO)).collect()
    }

    /// Light of texels that lie in a receiver's: its own, and in finer ones that which the client shows at their middles. Between linked
    /// receivers an engine's reads are then the client's.
    fn given(&self) -> Vec<Option<Vec3>> {
        let mut given = vec![None; self.size.element_product() as usize];
        let inner = self.size - 2 * GUTTER;
        for at in (0..inner.y).flat_map(|y| (0..inner.x).map(move |x| UVec2::new(x, y))) {
            let middle = (at.as_vec2() + 0.5) / self.scale as f32;
            let texel = middle.as_uvec2();
            if self.slot(texel).is_some() {
                let index = (at + GUTTER).dot(UVec2::new(1, self.size.x)) as usize;
                given[index] = if self.scale == 1 { self.own(texel) } else { self.shown(middle) };
            }
        }
        given
    }

    /// Points of the surface that read a texel which is not given; those on an edge come with both of its triangles.
    fn points(&self, chart: &[[Vec2; 3]], number: &[u32]) -> Vec<Point> {
        let fine = (self.size - 2 * GUTTER) * POINTS;
        let mut points = Vec::new();
        for corners in chart {
            lattice(corners.map(|at| at * (self.scale * POINTS) as f32), fine, |at| {
                let place = (at.as_vec2() + 0.5) / POINTS as f32;
                let from_first = place + GUTTER as f32 - 0.5;
                let first = from_first.floor().as_uvec2().dot(UVec2::new(1, self.size.x));
                if taps(first, self.size.x).iter().all(|tap| number[*tap as usize] == GIVEN) {
                    return;
                }
                let place = place / self.scale as f32;
                if let Some(light) = self.shown(place) {
                    let weight = if self.is_covered(place) { 1.0 } else { HIDDEN_WEIGHT };
                    points.push(Point { first, share: from_first.fract(), weight, light });
                }
            });
        }
        points
    }

    fn slot(&self, texel: UVec2) -> Option<u32> {
        self.light.lightmap.slots.slot(self.block, texel.to_array().map(|at| at as u16))
    }

    fn own(&self, texel: UVec2) -> Option<Vec3> {
        let block = self.light.lightmap.layout.block(self.block)?;
        let [x, y] = [0, 1].map(|axis| (block.origin[axis] + texel[axis]) as usize);
        let page = block.page as usize;
        Some(self.light.pages.pages[page][y * self.light.pages.sizes[page][0] as usize + x].truncate())
    }

    /// Light that the client shows at a place in texels of the lightmap; `None` where it has none.
    fn shown(&self, place: Vec2) -> Option<Vec3> {
        shown(self.light.lightmap.layout, self.light.pages, self.block, place.into())
    }

    /// Whether the receiver of a place's texel has the place for its own.
    fn is_covered(&self, place: Vec2) -> bool {
        let Some(slot) = self.slot(place.as_uvec2()) else { return false };
        let cell = (place.fract() * COVERAGE_SIDE as f32).as_uvec2();
        let coverage = self.light.lightmap.receivers.coverage[slot as usize];
        coverage == 0 || coverage >> (COVERAGE_SIDE * cell.y + cell.x) & 1 == 1
    }
}

/// The texels around a point, in the order (0, 0), (1, 0), (0, 1), (1, 1).
fn taps(first: u32, width: u32) -> [u32; 4] {
    [first, first + 1, first + width, first + width + 1]
}

/// Calls `met` with each cell of a lattice of `size` whose middle a triangle has, on its rim too; corners in cells.
fn lattice([a, b, c]: [Vec2; 3], size: UVec2, mut met: impl FnMut(UVec2)) {
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() || size.min_element() == 0 {
        return;
    }
    let last = size.as_vec2() - 1.0;
    let low = (a.min(b).min(c) - 0.5).ceil().clamp(Vec2::ZERO, last).as_uvec2();
    let high = (a.max(b).max(c) - 0.5).floor().clamp(Vec2::ZERO, last).as_uvec2();
    for at in (low.y..=high.y).flat_map(|y| (low.x..=high.x).map(move |x| UVec2::new(x, y))) {
        let middle = at.as_vec2() + 0.5;
        let shares = [(b, c), (c, a), (a, b)].map(|(from, to)| (to - from).perp_dot(middle - from) / area);
        if shares.iter().all(|share| *share >= 0.0) {
            met(at);
        }
    }
}

/// Least squares over points, by texels that are not given.
struct Fit {
    points: Vec<Point>,
    /// Of each texel, its number among those that are sought, or [`GIVEN`].
    number: Vec<u32>,
    texels: Vec<Vec3>,
    width: u32,
    /// First of each sought texel's entries in `reads`, and the end.
    starts: Vec<u32>,
    /// Point and tap.
    reads: Vec<(u32, u8)>,
    /// Least and most light that the client shows around each sought texel.
    bounds: Vec<[Vec3; 2]>,
}

impl Fit {
    fn new(points: Vec<Point>, number: Vec<u32>, count: usize, texels: Vec<Vec3>, width: u32) -> Self {
        let mut all: Vec<(u32, u32, u8)> = Vec::new();
        for (index, point) in (0..).zip(&points) {
            let sought =
                (0..).zip(taps(point.first, width)).filter(|(_, tap)| number[*tap as usize] != GIVEN);
            all.extend(sought.map(|(tap, texel)| (number[texel as usize], index, tap)));
        }
        all.sort_unstable();
        let mut starts = vec![0; count + 1];
        all.iter().for_each(|(number, ..)| starts[*number as usize + 1] += 1);
        (0..count).for_each(|number| starts[number + 1] += starts[number]);
        let reads = all.into_iter().map(|(_, point, tap)| (point, tap)).collect();
        let mut fit = Self { points, number, texels, width, starts, reads, bounds: Vec::new() };
        fit.bounds = (0..count as u32).map(|number| fit.bounds_of(number)).collect();
        fit.begin();
        fit
    }

    fn reads_of(&self, number: u32) -> &[(u32, u8)] {
        let [start, end] = [number, number + 1].map(|index| self.starts[index as usize] as usize);
        &self.reads[start..end]
    }

    /// Some point of the surface reads a texel.
    fn is_read(&self, number: u32) -> bool {
        number != GIVEN && !self.reads_of(number).is_empty()
    }

    /// Least and most light at the heaviest points around a texel.
    fn bounds_of(&self, number: u32) -> [Vec3; 2] {
        let reads = self.reads_of(number);
        let point = |read: &(u32, u8)| self.points[read.0 as usize];
        let heaviest = reads.iter().map(|read| point(read).weight).fold(0.0, f32::max);
        let counted = reads.iter().map(point).filter(|point| point.weight == heaviest);
        counted.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[least, most], point| {
            [least.min(point.light), most.max(point.light)]
        })
    }

    /// Starts with means of the light around.
    fn begin(&mut self) {
        for texel in 0..self.texels.len() {
            let number = self.number[texel];
            if self.is_read(number) {
                let [mut sum, mut total] = [Vec3::ZERO, Vec3::ZERO];
                for (point, tap) in self.reads_of(number) {
                    let point = self.points[*point as usize];
                    let weight = (point.weight * shares(point.share)[usize::from(*tap)]).max(1e-6);
                    sum += weight * point.light;
                    total += weight;
                }
                let [least, most] = self.bounds[number as usize];
                self.texels[texel] = (sum / total).max(least).min(most);
            }
        }
    }

    /// One sweep of Gauss–Seidel: each texel's best light, all others as they are.
    fn sweep(&mut self) {
        for texel in 0..self.texels.len() {
            let number = self.number[texel];
            if number == GIVEN {
                continue;
            }
            let (mut pull, mut stiffness) = (Vec3::ZERO, 0.0);
            for (point, tap) in self.reads_of(number) {
                let point = self.points[*point as usize];
                let shares = shares(point.share);
                let own = shares[usize::from(*tap)];
                let others = (0..).zip(taps(point.first, self.width)).filter(|(other, _)| other != tap);
                let rest: Vec3 = others
                    .map(|(other, texel)| shares[usize::from(other)] * self.texels[texel as usize])
                    .sum();
                pull += point.weight * own * (point.light - rest);
                stiffness += point.weight * own * own;
            }
            if stiffness > 1e-9 {
                let [least, most] = self.bounds[number as usize];
                self.texels[texel] = (pull / stiffness).max(least).min(most);
            }
        }
    }
}

/// Bilinear weights of the four taps.
fn shares(share: Vec2) -> [f32; 4] {
    let [x, y] = share.to_array();
    [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y]
}

/// Gives every texel that is not known the light of the nearest known one, so that coarser levels of an engine meet no black.
fn grown(mut texels: Vec<Vec3>, mut known: Vec<bool>, size: UVec2) -> Vec<Vec3> {
    let mut front: Vec<u32> = (0..texels.len() as u32).filter(|texel| known[*texel as usize]).collect();
    while !front.is_empty() {
        let mut next = Vec::new();
        for texel in front {
            let (x, y) = (texel % size.x, texel / size.x);
            let around = [
                (x > 0).then(|| texel - 1),
                (x + 1 < size.x).then(|| texel + 1),
                (y > 0).then(|| texel - size.x),
                (y + 1 < size.y).then(|| texel + size.x),
            ];
            for other in around.into_iter().flatten() {
                if !std::mem::replace(&mut known[other as usize], true) {
                    texels[other as usize] = texels[texel as usize];
                    next.push(other);
                }
            }
        }
        front = next;
    }
    texels
}
