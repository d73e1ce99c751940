//! A part of a field, decoded: some probes, their depth maps and their factorised transport.

use glam::{IVec3, Vec3};

use super::octahedron::MAP_POINTS;
use crate::content::{EmitterIrradiance, TransportFactors};

/// Rows of a probe: coefficients of irradiance by normal, over spherical harmonics of bands 0 to 2.
pub const PROBE_ROWS: usize = 9;

/// Farthest point of the lattice from the world's origin, in steps along an axis.
pub const LATTICE_MAX: i32 = (1 << 20) - 1;
/// Steps along each axis and either way to which a probe may be moved from its point of the lattice.
pub const MOVES_MAX: i8 = 3;
/// Such a step over the lattice's.
pub const MOVE_SHARE: f32 = 0.15;

/// Identity of a probe: its point of the lattice, or the cell between eight points for one that stands where these see nothing.
/// Keys ascend by z, then y, then x, those of cells last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ProbeKey(pub u64);

impl ProbeKey {
    /// Bits of an axis.
    const BITS: u32 = 21;
    /// Set in keys of cells.
    const CELL: u64 = 1 << 63;

    /// Of a point of the lattice; `None` beyond [`LATTICE_MAX`].
    pub fn of(point: IVec3) -> Option<Self> {
        let is_near = point.to_array().iter().all(|at| (-LATTICE_MAX..=LATTICE_MAX).contains(at));
        let bits = point.to_array().map(|at| (at + LATTICE_MAX + 1) as u64);
        is_near.then(|| Self(bits[2] << (2 * Self::BITS) | bits[1] << Self::BITS | bits[0]))
    }

    /// Of the cell whose least corner is a point of the lattice.
    pub fn of_cell(point: IVec3) -> Option<Self> {
        Self::of(point).map(|key| Self(key.0 | Self::CELL))
    }

    /// Whether it is that of a cell.
    pub fn is_of_cell(self) -> bool {
        self.0 & Self::CELL != 0
    }

    /// Its point of the lattice, or its cell's least corner.
    pub fn point(self) -> IVec3 {
        let of = |axis: u32| {
            let bits = self.0 >> (axis * Self::BITS) & ((1 << Self::BITS) - 1);
            bits as i32 - LATTICE_MAX - 1
        };
        IVec3::new(of(0), of(1), of(2))
    }
}

/// A probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Probe {
    /// Identity.
    pub key: ProbeKey,
    /// Steps by which it was moved out of geometry, or to where it is of use.
    pub moved: [i8; 3],
}

impl Probe {
    /// Its place in metres: `h (l + 0.15 k)`, and half a step more along each axis of a cell's.
    pub fn position_m(&self, spacing_m: f32) -> Vec3 {
        let half = if self.key.is_of_cell() { 0.5 } else { 0.0 };
        (self.key.point().as_vec3() + half + Vec3::from(self.moved.map(f32::from)) * MOVE_SHARE) * spacing_m
    }
}

/// Some probes of a field.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldPart {
    /// Step of the lattice h in metres.
    pub spacing_m: f32,
    /// Probes, ascending by key.
    pub probes: Vec<Probe>,
    /// Depth maps, [`MAP_POINTS`] codes a probe: see [`depth_code`].
    pub depths: Vec<u16>,
    /// Transport, [`PROBE_ROWS`] rows a probe.
    pub factors: TransportFactors,
    /// Coefficients straight from emitters at scale 1, in W·m⁻², of those that reach any probe: [`PROBE_ROWS`] a probe, of either sign.
    pub emitters: Vec<EmitterIrradiance>,
}

/// Reciprocal octahedral distance of the nearest depth that a map tells, in steps of the lattice. Probes keep farther off surfaces: what a map told
/// farther away than it is would let light through.
const NEAREST: f32 = 40.0;

/// Code of a depth: `round(65535 · min(s h, 40) / 40)` of the reciprocal s of an octahedral distance, 0 for the sky.
pub fn depth_code(reciprocal: f32, spacing_m: f32) -> u16 {
    ((reciprocal * spacing_m / NEAREST).clamp(0.0, 1.0) * 65_535.0).round() as u16
}

/// s h of a code.
pub fn depth_of(code: u16) -> f32 {
    f32::from(code) * (NEAREST / 65_535.0)
}

impl FieldPart {
    /// The depth map of a probe.
    pub fn depths_of(&self, probe: usize) -> &[u16] {
        &self.depths[probe * MAP_POINTS..][..MAP_POINTS]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_name_points_and_ascend_by_height_first() {
        let points =
            [IVec3::ZERO, IVec3::new(-3, 7, 1), IVec3::splat(LATTICE_MAX), IVec3::splat(-LATTICE_MAX)];
        for point in points {
            let [key, of_cell] = [ProbeKey::of(point).unwrap(), ProbeKey::of_cell(point).unwrap()];
            assert_eq!((key.point(), of_cell.point()), (point, point));
            assert!(!key.is_of_cell() && of_cell.is_of_cell() && key < of_cell);
        }
        assert_eq!(ProbeKey::of(IVec3::new(0, LATTICE_MAX + 1, 0)), None);
        assert!(ProbeKey::of(IVec3::new(9, 9, 0)) < ProbeKey::of(IVec3::new(0, 0, 1)));
    }

    #[test]
    fn depths_keep_their_distance_and_the_sky_is_none() {
        assert_eq!((depth_code(0.0, 0.5), depth_of(0)), (0, 0.0));
        for distance in [0.06_f32, 0.3, 2.0] {
            let read = 0.5 / depth_of(depth_code(1.0 / distance, 0.5));
            assert!((read / distance - 1.0).abs() < 4e-4 * distance / 0.5 + 1e-4, "{read} for {distance}");
        }
    }
}
