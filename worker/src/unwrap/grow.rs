//! Charts by growing regions from the largest triangles.
//!
//! A region takes neighbours over smooth edges, flattest against its seed first, while one cone of
//! `chart_cone_rad` holds all its normals. The cone turns as it widens, so a region that starts at the rim of a
//! curved surface still spans the full angle. Then the region gets its axis, and is parted where its projection
//! along that axis overlaps itself.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use glam::DVec3;

use super::UnwrapSettings;
use super::adjacency::{Adjacency, NO_NEIGHBOUR};
use super::frame::ChartFrame;
use super::overlap::{Cover, Footprint};
use super::soup::Soup;
use crate::task::{Cancelled, Progress};

/// Normals this close to the seed's (cosine of 2°) belong to its plane.
const PLANE_COSINE: f64 = 0.999_39;

/// Share of a region's area in its seed's plane from which that plane is the chart's.
const PLANE_SHARE: f64 = 0.4;

/// How much further than the cone a triangle may lie from the axis chosen in the end.
const AXIS_SLACK_RAD: f64 = 0.12;

/// Steps in which growth tells flatter from steeper neighbours (2° is less than one).
const COSINE_STEPS: f64 = 1024.0;

/// Triangles projected along one axis.
pub(super) struct Chart {
    /// The projection.
    pub frame: ChartFrame,
    /// Source triangles in the order they joined.
    pub triangles: Vec<u32>,
}

impl Chart {
    /// Area of the surface, in texels.
    pub fn area_texels(&self, soup: &Soup, settings: &UnwrapSettings) -> f64 {
        let area_m2: f64 = self.triangles.iter().map(|&t| soup.area_m2[t as usize]).sum();
        area_m2 / (f64::from(settings.texel_m) * f64::from(settings.texel_m))
    }
}

/// A triangle as a frame sees it.
pub(super) fn footprint(soup: &Soup, frame: &ChartFrame, triangle: u32) -> Footprint {
    let corners = soup.positions_m(triangle).map(|p| frame.project(p));
    Footprint { uv: corners.map(|c| c.0), height: corners.map(|c| c.1) }
}

/// Side in texels of the cells that find large triangles again: a texel, or more where a big surface of few
/// triangles would make needlessly many.
pub(super) fn cover_cell_texels(soup: &Soup, settings: &UnwrapSettings) -> f64 {
    let texel_m2 = f64::from(settings.texel_m) * f64::from(settings.texel_m);
    let texels = soup.area_m2.iter().sum::<f64>() / texel_m2;
    (texels / (1 << 20) as f64).max(1.0).sqrt()
}

/// Puts every live triangle in a chart.
pub(super) fn grow_charts(
    soup: &Soup,
    adjacency: &Adjacency,
    settings: &UnwrapSettings,
    progress: &Progress,
) -> Result<Vec<Chart>, Cancelled> {
    let mut seeds: Vec<u32> = (0..soup.len() as u32).filter(|&t| soup.is_live(t)).collect();
    let area = |t: u32| soup.area_m2[t as usize] as f32;
    seeds.sort_unstable_by(|&a, &b| area(b).total_cmp(&area(a)).then(a.cmp(&b)));
    let mut growth = Growth {
        soup,
        adjacency,
        settings,
        progress,
        is_charted: vec![false; soup.len()],
        region_of: vec![NO_REGION; soup.len()],
        cover: Cover::new(cover_cell_texels(soup, settings)),
        charts: Vec::new(),
    };
    for (region, seed) in seeds.into_iter().enumerate() {
        if !growth.is_charted[seed as usize] {
            growth.grow(region as u32, seed)?;
        }
    }
    Ok(growth.charts)
}

const NO_REGION: u32 = u32::MAX;

struct Growth<'a> {
    soup: &'a Soup,
    adjacency: &'a Adjacency,
    settings: &'a UnwrapSettings,
    progress: &'a Progress,
    is_charted: Vec<bool>,
    /// Region that a triangle was last taken into.
    region_of: Vec<u32>,
    cover: Cover,
    charts: Vec<Chart>,
}

impl Growth<'_> {
    fn grow(&mut self, region: u32, seed: u32) -> Result<(), Cancelled> {
        let (members, cone) = self.region(region, seed)?;
        let axis = self.axis(&members, &cone);
        let frame = ChartFrame::new(axis, self.settings.texel_m);
        let least_cosine = libm::cos(f64::from(self.settings.chart_cone_rad) + AXIS_SLACK_RAD);
        let is_seen = |t: u32| self.normal(t).is_none_or(|normal| normal.dot(frame.normal) >= least_cosine);
        let (kept, dropped): (Vec<u32>, Vec<u32>) =
            members.into_iter().partition(|&t| t == seed || is_seen(t));
        for triangle in dropped {
            self.region_of[triangle as usize] = NO_REGION;
        }
        self.part(region, frame, &kept)
    }

    /// Triangles reached from the seed within one normal cone.
    fn region(&mut self, region: u32, seed: u32) -> Result<(Vec<u32>, NormalCone), Cancelled> {
        let seed_normal = self.soup.normals[seed as usize];
        let mut cone = NormalCone { axis: seed_normal, half_rad: 0.0 };
        let mut members = Vec::new();
        let mut frontier = BinaryHeap::from([Reverse((0_u32, 0_u32, seed))]);
        let mut sequence = 0;
        while let Some(Reverse((_, _, triangle))) = frontier.pop() {
            self.progress.check()?;
            let is_taken = self.region_of[triangle as usize] == region;
            let limit_rad = self.settings.chart_cone_rad.into();
            if is_taken || self.normal(triangle).is_some_and(|normal| !cone.widen(normal, limit_rad)) {
                continue;
            }
            self.region_of[triangle as usize] = region;
            members.push(triangle);
            for next in self.smooth_neighbours(triangle) {
                if !self.is_charted[next as usize] && self.region_of[next as usize] != region {
                    let bend = 1.0 - self.soup.normals[next as usize].dot(seed_normal);
                    sequence += 1;
                    frontier.push(Reverse(((bend * COSINE_STEPS) as u32, sequence, next)));
                }
            }
        }
        Ok((members, cone))
    }

    /// The seed's plane where that dominates, else the mean normal if it sees all, else the cone's axis.
    fn axis(&self, members: &[u32], cone: &NormalCone) -> DVec3 {
        let seed_normal = self.soup.normals[members[0] as usize];
        let weighted = |t: &u32| self.soup.normals[*t as usize] * self.soup.area_m2[*t as usize];
        let is_in_plane = |t: &&u32| self.soup.normals[**t as usize].dot(seed_normal) > PLANE_COSINE;
        let plane: DVec3 = members.iter().filter(is_in_plane).map(weighted).sum();
        let plane_m2: f64 = members.iter().filter(is_in_plane).map(|&t| self.soup.area_m2[t as usize]).sum();
        let all_m2: f64 = members.iter().map(|&t| self.soup.area_m2[t as usize]).sum();
        if plane_m2 >= PLANE_SHARE * all_m2 {
            return plane.normalize();
        }
        let mean = members.iter().map(weighted).sum::<DVec3>().try_normalize();
        let limit = libm::cos(f64::from(self.settings.chart_cone_rad) + AXIS_SLACK_RAD);
        match mean {
            Some(mean) if members.iter().all(|&t| self.normal(t).is_none_or(|n| n.dot(mean) > limit)) => mean,
            _ => cone.axis,
        }
    }

    /// Cuts a region into connected charts without overlap, each grown breadth-first.
    fn part(&mut self, region: u32, frame: ChartFrame, members: &[u32]) -> Result<(), Cancelled> {
        for &seed in members {
            if self.is_charted[seed as usize] {
                continue;
            }
            self.cover.clear();
            let mut triangles = Vec::new();
            let mut queue = VecDeque::from([seed]);
            while let Some(triangle) = queue.pop_front() {
                self.progress.check()?;
                let is_free = !self.is_charted[triangle as usize];
                if !is_free || !self.cover.try_insert(footprint(self.soup, &frame, triangle)) {
                    continue;
                }
                self.is_charted[triangle as usize] = true;
                triangles.push(triangle);
                queue.extend(self.smooth_neighbours(triangle).filter(|&next| {
                    self.region_of[next as usize] == region && !self.is_charted[next as usize]
                }));
            }
            self.charts.push(Chart { frame, triangles });
        }
        Ok(())
    }

    /// The geometric normal, unless the triangle is too thin to have one.
    fn normal(&self, triangle: u32) -> Option<DVec3> {
        let is_sliver = self.soup.is_sliver(triangle, self.settings.texel_m);
        (!is_sliver).then(|| self.soup.normals[triangle as usize])
    }

    fn smooth_neighbours(&self, triangle: u32) -> impl Iterator<Item = u32> + use<'_> {
        let neighbours = self.adjacency.neighbours[triangle as usize];
        (0..3)
            .filter(move |&edge| neighbours[edge] != NO_NEIGHBOUR && !self.adjacency.is_hard(triangle, edge))
            .map(move |edge| neighbours[edge])
    }
}

/// A cone that holds normals.
struct NormalCone {
    axis: DVec3,
    half_rad: f64,
}

impl NormalCone {
    /// Takes in a normal by the least turn and widening, unless the half-angle would exceed the limit.
    fn widen(&mut self, normal: DVec3, limit_rad: f64) -> bool {
        let angle = libm::acos(self.axis.dot(normal).clamp(-1.0, 1.0));
        if angle <= self.half_rad {
            return true;
        }
        let half_rad = 0.5 * (self.half_rad + angle);
        if half_rad > limit_rad {
            return false;
        }
        let turn = half_rad - self.half_rad;
        let turned = self.axis * libm::sin(angle - turn) + normal * libm::sin(turn);
        self.axis = turned.try_normalize().unwrap_or(self.axis);
        self.half_rad = half_rad;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cone_turns_towards_new_normals() {
        let mut cone = NormalCone { axis: DVec3::Z, half_rad: 0.0 };
        for degrees in [10.0_f64, 40.0, 80.0] {
            let rad = degrees.to_radians();
            assert!(cone.widen(DVec3::new(libm::sin(rad), 0.0, libm::cos(rad)), 0.75));
        }
        assert!((cone.half_rad.to_degrees() - 40.0).abs() < 1e-6);
        assert!(!cone.widen(-DVec3::X, 0.75));
    }
}
