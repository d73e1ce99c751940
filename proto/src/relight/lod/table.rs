//! Facts of a bake that levels of detail need, whatever the eye: bounds, the order of rows, stand-ins.

use std::cmp::Reverse;

use glam::Vec3;

use super::LOD_LEVELS;
use crate::content::Texel;
use crate::relight::{ClusterTable, LightmapTexels, ReceiverTable, SlotTable};

/// No receiver.
pub const NO_STAND_IN: u32 = u32::MAX;

/// A receiver and those of the next levels beside it, as shaders read them.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct StandIn {
    /// Slot of the receiver.
    pub slot: u32,
    /// Its cluster.
    pub cluster: u32,
    /// Slots of its stand-ins, and [`NO_STAND_IN`] behind the last. Each has the same weight: the receiver is in their middle.
    pub sources: [u32; 4],
}

/// Bounds of clusters, orders of their rows, and stand-ins.
#[derive(Debug, Default)]
pub struct LodTable {
    /// Bounds of each cluster's receivers in metres.
    pub(super) bounds_m: Vec<[Vec3; 2]>,
    /// Rows of each cluster by slot, those first that all levels compute; each counts from its cluster's first.
    pub order: Vec<u32>,
    /// Rows of each cluster that are computed at each level of receivers.
    pub(super) rows: Vec<[u32; LOD_LEVELS]>,
    /// Receivers with stand-ins by level, the finest first.
    pub stand_ins: [Vec<StandIn>; LOD_LEVELS - 1],
}

impl LodTable {
    /// Of a bake's clusters, whose rows are receivers.
    pub fn new(slots: &SlotTable, receivers: &ReceiverTable, clusters: &ClusterTable) -> Self {
        let mut table = Self { order: vec![0; receivers.len()], ..Self::default() };
        let mut cluster_of = vec![0_u32; receivers.len()];
        for (cluster, index) in clusters.clusters.iter().zip(0..) {
            cluster_of[cluster.rows()].fill(index);
        }
        // Rows without stand-ins are of all levels.
        let mut levels = vec![LOD_LEVELS - 1; receivers.len()];
        let texels = LightmapTexels { slots, receivers };
        for (slot, block, texel) in slots.receivers() {
            let level = level_of(texel);
            if level + 1 == LOD_LEVELS {
                continue;
            }
            let sources = stand_ins(&texels, block, texel, level);
            if sources[0] != NO_STAND_IN {
                levels[slot as usize] = level;
                let cluster = cluster_of[slot as usize];
                table.stand_ins[level].push(StandIn { slot, cluster, sources });
            }
        }
        for cluster in &clusters.clusters {
            let own = &levels[cluster.rows()];
            let mut order: Vec<u32> = (0..own.len() as u32).collect();
            order.sort_by_key(|&row| Reverse(own[row as usize]));
            table.order[cluster.rows()].copy_from_slice(&order);
            let rows_of = |least: usize| own.iter().filter(|level| **level >= least).count() as u32;
            table.rows.push(std::array::from_fn(rows_of));
            let start = [Vec3::INFINITY, Vec3::NEG_INFINITY];
            let positions = receivers.position_m[cluster.rows()].iter().map(|position| position.truncate());
            table.bounds_m.push(positions.fold(start, |[low, high], at| [low.min(at), high.max(at)]));
        }
        table
    }

    /// Receivers that have no stand-ins though their texels are of a fine level.
    pub fn alone(&self, slots: &SlotTable) -> usize {
        let fine = slots.receivers().filter(|(_, _, texel)| level_of(*texel) + 1 < LOD_LEVELS).count();
        fine - self.stand_ins.iter().map(Vec::len).sum::<usize>()
    }
}

/// Trailing zero bits common to both coordinates, as chunks count them.
fn level_of([x, y]: Texel) -> usize {
    ((x | y).trailing_zeros() as usize).min(LOD_LEVELS - 1)
}

/// Receivers of higher levels in whose middle a texel of a level is: two along an axis, or four around. Those that a wall parts
/// from it, or a texel without receiver, are left out.
fn stand_ins(texels: &LightmapTexels<'_>, block: u32, texel: Texel, level: usize) -> [u32; 4] {
    let is_odd = texel.map(|along| along >> level & 1 == 1);
    let ways = match is_odd {
        [true, true] => &[[-1, -1], [1, -1], [-1, 1], [1, 1]][..],
        [true, false] => &[[-1, 0], [1, 0]],
        _ => &[[0, -1], [0, 1]],
    };
    let mut found = ways.iter().filter_map(|&way| walked(texels, block, texel, way, 1 << level));
    std::array::from_fn(|_| found.next().unwrap_or(NO_STAND_IN))
}

/// Slot of the receiver so many steps away from that of a texel, if no wall parts any two on the way.
fn walked(
    texels: &LightmapTexels<'_>,
    block: u32,
    texel: Texel,
    [dx, dy]: [i32; 2],
    steps: i32,
) -> Option<u32> {
    let mut slot = None;
    for step in 0..steps {
        let at = |along: u16, by: i32| u16::try_from(i32::from(along) + by * step).ok();
        slot = Some(texels.linked(block, [at(texel[0], dx)?, at(texel[1], dy)?], [dx, dy])?);
    }
    slot
}
