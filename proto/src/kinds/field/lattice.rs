//! Probes by their points of a lattice, and those between them.

use std::ops::Range;

use glam::{IVec3, Vec3};

use super::content::{FieldPart, LATTICE_MAX, ProbeKey};
use crate::relight::Inconsistent;

/// A point of the lattice without a probe.
pub const NO_PROBE: u32 = u32::MAX;

/// Most points of the lattice between the outermost probes.
const POINTS_MAX: usize = 1 << 20;

/// Which probe stands for each point of a lattice, and in each of its cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatticeTable {
    /// Least point of the lattice, and how many points there are along each axis.
    pub low: IVec3,
    /// See `low`.
    pub size: IVec3,
    /// Probe of each point, x fastest, or [`NO_PROBE`].
    pub probe_at: Vec<u32>,
    /// Likewise of each cell, by its least corner.
    pub probe_in: Vec<u32>,
}

impl LatticeTable {
    /// Of probes in the order of parts.
    pub fn of(parts: &[FieldPart]) -> Result<Self, Inconsistent> {
        let keys = || parts.iter().flat_map(|part| &part.probes).map(|probe| probe.key);
        let Some(first) = keys().next() else { return Ok(Self::default()) };
        let ends = [first.point(); 2];
        let [low, high] =
            keys().map(ProbeKey::point).fold(ends, |[low, high], at| [low.min(at), high.max(at)]);
        let size = high - low + 1;
        let points = size.to_array().iter().try_fold(1_usize, |all, &along| all.checked_mul(along as usize));
        let Some(points) = points.filter(|points| *points <= POINTS_MAX) else {
            let problem = format!("its probes span {size} points, at most {POINTS_MAX}");
            return Err(Inconsistent::new("field", problem));
        };
        let mut table =
            Self { low, size, probe_at: vec![NO_PROBE; points], probe_in: vec![NO_PROBE; points] };
        let mut number = 0;
        for (index, part) in parts.iter().enumerate() {
            for probe in &part.probes {
                let point = probe.key.point();
                let place = table.index_of(point).unwrap_or_default();
                let of = if probe.key.is_of_cell() { &mut table.probe_in } else { &mut table.probe_at };
                if std::mem::replace(&mut of[place], number) != NO_PROBE {
                    let problem = format!("it has a second probe at {point}");
                    return Err(Inconsistent::new(format!("field {index}"), problem));
                }
                number += 1;
            }
        }
        Ok(table)
    }

    pub(super) fn index_of(&self, point: IVec3) -> Option<usize> {
        let at = point - self.low;
        let is_there = at.cmpge(IVec3::ZERO).all() && at.cmplt(self.size).all();
        is_there.then(|| ((at.z * self.size.y + at.y) * self.size.x + at.x) as usize)
    }

    /// Probes around a place, in steps of the lattice, and products of tents along each axis: of so many steps about points, half a step
    /// less about the middles of cells. None beyond all lattices.
    pub(super) fn around(&self, at: Vec3, range: Range<i32>, reach: f32) -> Vec<(u32, f32)> {
        if !at.is_finite() || at.abs().max_element() > LATTICE_MAX as f32 {
            return Vec::new();
        }
        let cage = at.floor().as_ivec3();
        let mut found = Vec::new();
        for z in range.clone() {
            for y in range.clone() {
                for x in range.clone() {
                    let point = cage + IVec3::new(x, y, z);
                    let Some(index) = self.index_of(point) else { continue };
                    for (probe, half) in [(self.probe_at[index], 0.0), (self.probe_in[index], 0.5)] {
                        let away = (at - point.as_vec3() - half).abs();
                        let tent = (1.0 - away / (reach - half)).max(Vec3::ZERO).element_product();
                        if tent > 0.0 && probe != NO_PROBE {
                            found.push((probe, tent));
                        }
                    }
                }
            }
        }
        found
    }
}
