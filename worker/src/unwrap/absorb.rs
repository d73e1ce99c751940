//! Merging scraps into neighbouring charts.
//!
//! A scrap costs its gutter: a chart of one texel takes nine. From the largest chart to the smallest, each takes
//! in neighbouring smaller scraps whole, if its axis sees all their triangles under `scrap_cone_rad`, its
//! projection stays free of overlaps, and its bounds grow by less than the scrap alone would take. Scraps far
//! smaller than a texel may face elsewhere, but not back to back with a chart of whole texels: such a fold is seen
//! from its own side alone, and would show the light of the other.

use glam::{DVec2, DVec3};

use super::UnwrapSettings;
use super::adjacency::{Adjacency, NO_NEIGHBOUR};
use super::grow::{Chart, cover_cell_texels, footprint};
use super::overlap::{Cover, Footprint};
use super::soup::Soup;
use crate::task::{Cancelled, Progress};

/// Charts below this area, in texels, are scraps.
const SCRAP_AREA_TEXELS: f64 = 64.0;

/// A scrap behind a hard edge is merged only if it is narrower than this, in texels.
const HARD_SCRAP_WIDTH_TEXELS: f64 = 1.0;

/// Scraps below this area that span less than a texel are specks: no texel is theirs anyway, so they may join a
/// neighbour that faces elsewhere.
const SPECK_AREA_TEXELS: f64 = 0.25;

/// A triangle is folded over if the cosine between its normal and the chart's axis is below this.
const FOLDED_COSINE: f64 = -0.9;

/// A chart below this area takes folded specks too: it is a thing smaller than a texel, and one receiver lights it.
const WHOLE_THING_AREA_TEXELS: f64 = 1.0;

const NO_CHART: u32 = u32::MAX;

/// Merges scraps and drops the charts that became empty.
pub(super) fn absorb_scraps(
    soup: &Soup,
    adjacency: &Adjacency,
    settings: &UnwrapSettings,
    charts: &mut Vec<Chart>,
    progress: &Progress,
) -> Result<(), Cancelled> {
    let mut order: Vec<u32> = (0..charts.len() as u32).collect();
    let area_texels: Vec<f64> = charts.iter().map(|c| c.area_texels(soup, settings)).collect();
    let area = |c: u32| area_texels[c as usize] as f32;
    order.sort_unstable_by(|&a, &b| area(b).total_cmp(&area(a)).then(a.cmp(&b)));
    let mut rank = vec![0; charts.len()];
    for (position, &chart) in order.iter().enumerate() {
        rank[chart as usize] = position;
    }
    let mut chart_of = vec![NO_CHART; soup.len()];
    for (index, chart) in charts.iter().enumerate() {
        for &triangle in &chart.triangles {
            chart_of[triangle as usize] = index as u32;
        }
    }
    let tried_by = vec![NO_CHART; charts.len()];
    let cover = Cover::new(cover_cell_texels(soup, settings));
    let mut absorber =
        Absorber { soup, adjacency, settings, charts, chart_of, area_texels, rank, tried_by, cover };
    for chart in order {
        progress.check()?;
        absorber.feed(chart);
    }
    charts.retain(|chart| !chart.triangles.is_empty());
    Ok(())
}

struct Absorber<'a> {
    soup: &'a Soup,
    adjacency: &'a Adjacency,
    settings: &'a UnwrapSettings,
    charts: &'a mut Vec<Chart>,
    chart_of: Vec<u32>,
    area_texels: Vec<f64>,
    rank: Vec<usize>,
    /// The chart that last tried to take in this one.
    tried_by: Vec<u32>,
    cover: Cover,
}

impl Absorber<'_> {
    /// Lets one chart take in scraps until none around it fits.
    fn feed(&mut self, chart: u32) {
        let mut bounds = None;
        let mut next = 0;
        while let Some(&triangle) = self.charts[chart as usize].triangles.get(next) {
            next += 1;
            for beyond in self.adjacency.neighbours[triangle as usize] {
                let Some(scrap) = self.candidate(chart, beyond) else { continue };
                self.tried_by[scrap as usize] = chart;
                if self.is_worth_trying(chart, scrap) {
                    let mut current = bounds.unwrap_or_else(|| self.load(chart));
                    self.try_merge(chart, scrap, &mut current);
                    bounds = Some(current);
                }
            }
        }
    }

    /// The scrap beyond an edge, unless it is none or was tried.
    fn candidate(&self, chart: u32, beyond: u32) -> Option<u32> {
        let scrap = if beyond == NO_NEIGHBOUR { NO_CHART } else { self.chart_of[beyond as usize] };
        let is_new = scrap != NO_CHART && scrap != chart && self.tried_by[scrap as usize] != chart;
        let is_scrap = is_new
            && self.rank[scrap as usize] > self.rank[chart as usize]
            && self.area_texels[scrap as usize] < SCRAP_AREA_TEXELS;
        is_scrap.then_some(scrap)
    }

    /// The tests that need no cover: angle to the axis, and hard edges between the two.
    fn is_worth_trying(&self, chart: u32, scrap: u32) -> bool {
        if self.is_speck(scrap) {
            return self.area_texels[chart as usize] < WHOLE_THING_AREA_TEXELS
                || !self.is_folded(chart, scrap);
        }
        let axis = self.charts[chart as usize].frame.normal;
        let least_cosine = libm::cos(self.settings.scrap_cone_rad.into());
        let scrap_triangles = &self.charts[scrap as usize].triangles;
        let is_steep = |t: u32| self.soup.normals[t as usize].dot(axis) < least_cosine;
        let texel_m = self.settings.texel_m;
        if scrap_triangles.iter().any(|&t| is_steep(t) && !self.soup.is_sliver(t, texel_m)) {
            return false;
        }
        let (mut smooth_m, mut hard_m) = (0.0, 0.0);
        for &triangle in scrap_triangles {
            for (edge, &beyond) in self.adjacency.neighbours[triangle as usize].iter().enumerate() {
                if beyond != NO_NEIGHBOUR && self.chart_of[beyond as usize] == chart {
                    let length_m = self.edge_m(triangle, edge).length();
                    if self.adjacency.is_hard(triangle, edge) {
                        hard_m += length_m;
                    } else {
                        smooth_m += length_m;
                    }
                }
            }
        }
        let border_texels = (smooth_m + hard_m) / f64::from(self.settings.texel_m);
        smooth_m >= hard_m || self.area_texels[scrap as usize] < HARD_SCRAP_WIDTH_TEXELS * border_texels
    }

    fn is_speck(&self, scrap: u32) -> bool {
        if self.area_texels[scrap as usize] > SPECK_AREA_TEXELS {
            return false;
        }
        let triangles = self.charts[scrap as usize].triangles.iter();
        let corners = || triangles.clone().flat_map(|&t| self.soup.positions_m(t));
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        (high - low).length() < f64::from(self.settings.texel_m)
    }

    fn is_folded(&self, chart: u32, scrap: u32) -> bool {
        let axis = self.charts[chart as usize].frame.normal;
        let folds = |t: u32| self.soup.normals[t as usize].dot(axis) < FOLDED_COSINE;
        self.charts[scrap as usize].triangles.iter().any(|&t| folds(t))
    }

    fn edge_m(&self, triangle: u32, edge: usize) -> DVec3 {
        let corners = self.soup.positions_m(triangle);
        corners[(edge + 1) % 3] - corners[edge]
    }

    /// Fills the cover with a chart and returns its bounds.
    fn load(&mut self, chart: u32) -> Bounds {
        self.cover.clear();
        let chart = &self.charts[chart as usize];
        let mut bounds = Bounds::EMPTY;
        for &triangle in &chart.triangles {
            let footprint = footprint(self.soup, &chart.frame, triangle);
            bounds.include(&footprint);
            self.cover.try_insert(footprint);
        }
        bounds
    }

    fn try_merge(&mut self, chart: u32, scrap: u32, bounds: &mut Bounds) {
        let gutter = f64::from(self.settings.gutter_texels);
        let footprints = |scrap: u32, frame| {
            let triangles = self.charts[scrap as usize].triangles.iter();
            triangles.map(|&t| footprint(self.soup, frame, t)).collect::<Vec<Footprint>>()
        };
        let joined = footprints(scrap, &self.charts[chart as usize].frame);
        let alone = footprints(scrap, &self.charts[scrap as usize].frame);
        let mut grown = *bounds;
        joined.iter().for_each(|f| grown.include(f));
        let mut own = Bounds::EMPTY;
        alone.iter().for_each(|f| own.include(f));
        if grown.texels(gutter) - bounds.texels(gutter) > own.texels(gutter) {
            return;
        }
        let checkpoint = self.cover.checkpoint();
        if !joined.into_iter().all(|footprint| self.cover.try_insert(footprint)) {
            self.cover.roll_back(&checkpoint);
            return;
        }
        *bounds = grown;
        let moved = std::mem::take(&mut self.charts[scrap as usize].triangles);
        for &triangle in &moved {
            self.chart_of[triangle as usize] = chart;
        }
        self.charts[chart as usize].triangles.extend(moved);
        self.area_texels[chart as usize] += self.area_texels[scrap as usize];
    }
}

/// Bounds on the lattice.
#[derive(Clone, Copy)]
struct Bounds {
    low: DVec2,
    high: DVec2,
}

impl Bounds {
    const EMPTY: Self = Self { low: DVec2::INFINITY, high: DVec2::NEG_INFINITY };

    fn include(&mut self, footprint: &Footprint) {
        let (low, high) = footprint.bounds();
        self.low = self.low.min(low);
        self.high = self.high.max(high);
    }

    /// Texels that the bounds take in a block.
    fn texels(&self, gutter: f64) -> f64 {
        let size = self.high.ceil() - self.low.floor() + gutter;
        size.x * size.y
    }
}
