//! Light in free space, of a kind that has it: probes, each with nine coefficients of irradiance by normal.

use std::fmt::Debug;

use glam::{IVec3, Vec3, Vec4};

/// Coefficients of a probe: over spherical harmonics of bands 0 to 2.
pub const PROBE_COEFFICIENTS: usize = 9;
/// A point of the lattice without a probe.
pub const NO_PROBE: u32 = u32::MAX;

/// Points that probes belong to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice<'a> {
    /// Distance between neighbours in metres.
    pub spacing_m: f32,
    /// Least point; its place is `spacing_m` times it.
    pub low: IVec3,
    /// Points along each axis.
    pub size: IVec3,
    /// Probe of each point, x fastest, or [`NO_PROBE`]; all below the number of probes.
    pub probe_at: &'a [u32],
}

impl Lattice<'_> {
    /// The point of an index.
    pub fn point(&self, index: usize) -> IVec3 {
        let [x, y, _] = self.size.to_array().map(|along| along as usize);
        self.low + IVec3::from([index % x, index / x % y, index / (x * y)].map(|at| at as i32))
    }
}

/// Tetrahedra between probes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tetrahedra<'a> {
    /// Places of vertices in metres: probes, then corners of the box around them, which have no light.
    pub places_m: &'a [Vec4],
    /// Vertices of each.
    pub vertices: &'a [[u32; 4]],
}

/// The probes.
pub trait FreeSpace: Debug + Sync {
    /// Distance between neighbours in metres, about.
    fn spacing_m(&self) -> f32;

    /// Their lattice, if they stand on one.
    fn lattice(&self) -> Option<Lattice<'_>>;

    /// The tetrahedra between them, if that is what they have.
    fn tetrahedra(&self) -> Option<Tetrahedra<'_>>;

    /// Places in metres, also of probes that belong to no point.
    fn positions_m(&self) -> &[Vec4];

    /// Distance in metres of the nearest surface that a probe sees in a direction of length 1; infinite where there is none.
    fn distance_m(&self, probe: u32, direction: Vec3) -> f32;
}
