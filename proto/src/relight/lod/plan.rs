//! Detail of each cluster for an eye.

use glam::Vec3;
use serde::Serialize;

use super::{Detail, LOD_LEVELS, Lod, LodTable};
use crate::relight::{ClusterTable, packed::GROUP};

/// Where the eye is, and where it looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LodEye {
    /// Position in metres.
    pub position_m: Vec3,
    /// Unit direction of the view.
    pub forward: Vec3,
    /// Cosine of the angle from there to the corners of the picture, above 0.
    pub view_cos: f32,
    /// Longest way through the scene's bounds in metres.
    pub diagonal_m: f32,
}

/// Numbers for the blend at receivers, as shaders read them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct LodView {
    /// The eye in metres.
    pub position_m: [f32; 3],
    /// [`LodEye::view_cos`].
    pub view_cos: f32,
    /// Unit direction of the view.
    pub forward: [f32; 3],
    /// [`Lod::beside`].
    pub beside: f32,
    /// Distances at which receivers of the levels 0, 1 and 2 begin to go over to their stand-ins, in metres.
    pub starts_m: [f32; 3],
    /// [`Lod::behind`].
    pub behind: f32,
    /// Distances at which they have.
    pub ends_m: [f32; 3],
    /// Padding.
    pub pad: f32,
}

/// Detail of all clusters for an eye.
#[derive(Clone, Debug, PartialEq)]
pub struct LodPlan {
    /// Level of each cluster.
    pub levels: Vec<u8>,
    /// Detail of each.
    pub details: Vec<Detail>,
    /// Numbers for the blend.
    pub view: LodView,
    lod: Lod,
    eye: LodEye,
}

/// Work at one level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LevelCount {
    /// Clusters of the level.
    pub clusters: u64,
    /// Their receivers.
    pub receivers: u64,
    /// Those that are computed.
    pub receivers_computed: u64,
    /// Numbers of their ΣVᵀ: columns times ranks.
    pub numbers: u64,
    /// Those that are read.
    pub numbers_read: u64,
    /// Bounces from one update to the next.
    pub interval: u32,
}

impl LodPlan {
    /// Bounces in which each cluster takes part once at least.
    pub fn cycle(&self) -> u32 {
        self.details.iter().map(|detail| detail.interval).max().unwrap_or(1)
    }

    /// Work by level.
    pub fn counts(&self, clusters: &ClusterTable) -> [LevelCount; LOD_LEVELS] {
        let mut counts = [LevelCount::default(); LOD_LEVELS];
        for (count, level) in counts.iter_mut().zip(&self.lod.levels) {
            count.interval = level.interval;
        }
        let planned = self.levels.iter().zip(&self.details).zip(&clusters.clusters);
        for ((&level, detail), cluster) in planned {
            let count = &mut counts[usize::from(level)];
            count.clusters += 1;
            count.receivers += u64::from(detail.row_count);
            count.receivers_computed += u64::from(detail.rows);
            let ranks_read = cluster.rank.min(detail.groups as usize * GROUP) as u64;
            count.numbers += (cluster.column_count * cluster.rank) as u64;
            count.numbers_read += u64::from(detail.columns()) * ranks_read;
        }
        counts
    }

    /// Distance of a place in metres, longer outside of the view.
    pub(super) fn distance_m(&self, place_m: Vec3) -> f32 {
        let LodEye { position_m, forward, view_cos, .. } = self.eye;
        let way = place_m - position_m;
        let length = way.length();
        let cos = if length > 0.0 { way.dot(forward) / length } else { 1.0 };
        length * self.lod.zone(cos, view_cos)
    }

    /// Share of its stand-ins in the light of a receiver of a level, by the receiver's own distance: 0 to 1.
    pub(super) fn share(&self, level: usize, place_m: Vec3) -> f32 {
        let (start, end) = (self.view.starts_m[level], self.view.ends_m[level]);
        let along = ((self.distance_m(place_m) - start) / (end - start).max(1e-6)).clamp(0.0, 1.0);
        along * along * (3.0 - 2.0 * along)
    }
}

impl LodTable {
    /// The detail of each cluster for an eye; a cluster that was planned before keeps its level unless it is past the
    /// distance by a margin.
    ///
    /// The closest place of a cluster's bounds counts, in the most visible direction to any of them: no receiver is closer.
    pub fn plan(&self, clusters: &ClusterTable, lod: &Lod, eye: LodEye, before: Option<&LodPlan>) -> LodPlan {
        let before = before.filter(|before| before.lod == *lod && before.levels.len() == self.rows.len());
        let distances_m = lod.distances_m(eye.diagonal_m);
        let level_at = |distance_m: f32, margin: f32| {
            let is_past = |level: &usize| *level == 0 || distance_m >= distances_m[*level] * (1.0 + margin);
            (0..LOD_LEVELS).rev().find(is_past).unwrap_or(0)
        };
        let mut plan = LodPlan {
            levels: Vec::with_capacity(self.rows.len()),
            details: Vec::with_capacity(self.rows.len()),
            view: view_of(lod, eye, distances_m),
            lod: *lod,
            eye,
        };
        for (index, bounds_m) in self.bounds_m.iter().enumerate() {
            let distance_m = closest_m(*bounds_m, lod, eye);
            let level = match before.map(|before| usize::from(before.levels[index])) {
                Some(own) if level_at(distance_m, 0.0) > own => own.max(level_at(distance_m, lod.margin)),
                _ => level_at(distance_m, 0.0),
            };
            let detail = match before {
                Some(before) if usize::from(before.levels[index]) == level => before.details[index],
                _ => self.detail(clusters, index, lod, level),
            };
            plan.levels.push(level as u8);
            plan.details.push(detail);
        }
        plan
    }

    fn detail(&self, clusters: &ClusterTable, index: usize, lod: &Lod, level: usize) -> Detail {
        let (cluster, settings) = (&clusters.clusters[index], &lod.levels[level]);
        let [wide, bytes, rest] = cluster.classes().map(|class| {
            let levels = &clusters.column_levels[cluster.first_column..][class];
            levels.partition_point(|&of_column| u32::from(of_column) >= settings.columns) as u32
        });
        Detail {
            rows: self.rows[index][settings.receivers as usize],
            wide,
            bytes,
            rest,
            groups: cluster.groups().min((settings.rank as usize).div_ceil(GROUP)) as u32,
            level: settings.receivers,
            interval: settings.interval,
            ..Detail::full(cluster)
        }
    }
}

/// Distance of the closest place of bounds in metres, longer outside of the view: no place within them is closer.
pub(super) fn closest_m([low, high]: [Vec3; 2], lod: &Lod, eye: LodEye) -> f32 {
    if low.cmpgt(high).any() {
        return f32::INFINITY;
    }
    let length = eye.position_m.clamp(low, high).distance(eye.position_m);
    let (middle, radius) = (0.5 * (low + high), 0.5 * low.distance(high));
    let way = middle - eye.position_m;
    let to_middle = way.length();
    let cos = if to_middle <= radius {
        1.0
    } else {
        // The ball around the bounds is seen within this angle.
        let half_rad = libm::asinf(radius / to_middle);
        let angle_rad = libm::acosf((way.dot(eye.forward) / to_middle).clamp(-1.0, 1.0));
        libm::cosf((angle_rad - half_rad).max(0.0))
    };
    length * lod.zone(cos, eye.view_cos)
}

fn view_of(lod: &Lod, eye: LodEye, distances_m: [f32; LOD_LEVELS]) -> LodView {
    // Receivers of a level are left out from the first level of detail on that has none of them.
    let ends_m = [0, 1, 2].map(|level| {
        let first = lod.levels.iter().position(|detail| detail.receivers > level);
        first.map_or(super::LodDistance::NOWHERE.metres(0.0), |first| distances_m[first])
    });
    LodView {
        position_m: eye.position_m.into(),
        view_cos: eye.view_cos,
        forward: eye.forward.into(),
        beside: lod.beside,
        starts_m: ends_m.map(|end| end * (1.0 - lod.blend)),
        behind: lod.behind,
        ends_m,
        pad: 0.0,
    }
}
