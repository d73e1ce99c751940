//! Placement of a cloud's probes: evenly, by the error of transport between them, or as S2 has it (\[Sukys2014\]), by light.
//!
//! Placements differ in places alone: whatever put a probe where it is, it holds transport and is lit by any light.

pub mod contrast;
pub mod error;
pub mod even;
pub mod gradient;
pub mod leak_edges;
pub mod light;
pub mod spawn_merge;

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::cloud::{CloudSettings, Placement};
use lightkiln_proto::kinds::field::{FieldSettings, Probe, ProbeKey};

use crate::geometry::Geometry;
use crate::kinds::field::{Place, Volume, lattice, place, points, spacing_m};
use crate::task::{Cancelled, Progress, TaskError};

/// Steps between even places over the distance between probes.
const PLACES: i32 = 3;
/// Steps of the lattice over that of even places where probes stand anywhere: a twelfth of the distance between probes.
const FINER: i32 = 4;
/// The same where they stand at even places and at those of narrow space.
const EVEN: i32 = 2;
/// Steps between places of narrow space over the distance between probes.
const NARROW: i32 = 6;
/// Farthest place from the origin, in steps of the lattice: beyond it, tetrahedra are thinner than 32 bits tell.
const REACH_MAX: u64 = 1 << 16;
/// Most even places.
const PLACES_MAX: u64 = 1 << 23;
/// Even places from the outermost ones to the box around all probes.
const MARGIN: i32 = 3;
/// Nearest that a surface may be to a probe that light or an edge placed, over the distance between probes.
const CLEARANCE: f32 = 0.02;

/// Counts of a placement, by name.
pub type Account = Vec<(String, u64)>;

/// Volume of a scene, and the lattice that probes are points of.
pub struct Ground<'a> {
    /// Surfaces.
    pub geometry: &'a Geometry,
    /// Working volume.
    pub volume: Volume<'a>,
    /// Distance between probes h in metres.
    pub spacing_m: f32,
    /// Step of the lattice in metres.
    pub step_m: f32,
    /// Steps of the lattice between even places.
    pub stride: i32,
    /// Least even place, and their number along each axis.
    pub places: (IVec3, IVec3),
    /// Most probes of a placement by light, and with leak edges.
    pub probes_max: usize,
    /// Cancels.
    pub progress: &'a Progress,
}

impl<'a> Ground<'a> {
    /// Of a scene. Errors where there are too many places.
    pub fn of(
        geometry: &'a Geometry,
        (field, cloud): (&FieldSettings, &CloudSettings),
        progress: &'a Progress,
    ) -> Result<Self, TaskError> {
        let spacing_m = spacing_m(geometry.near_bounds_m(), field);
        let volume = Volume::of(geometry, spacing_m);
        let is_even = cloud.placement() == Placement::Even && cloud.field_leak_edges == 0;
        let stride = if is_even { EVEN } else { FINER };
        let place_m = spacing_m / PLACES as f32;
        let (low, size) = lattice(volume.outer_m(), place_m);
        let count = points(size);
        let ends = [low, low.saturating_add(size)].map(|end| end.to_array());
        let reach = ends.iter().flatten().map(|along| along.unsigned_abs()).max().unwrap_or_default();
        let reach = u64::from(reach) * u64::from(stride.unsigned_abs());
        if count > PLACES_MAX || reach > REACH_MAX {
            let which = match field.field_spacing_m {
                0.0 => format!("field_probes = {} are too many; lower it", field.field_probes),
                _ => format!("field_spacing_m = {spacing_m} is too fine; raise it"),
            };
            return Err(TaskError::bad_input(format!(
                "{which}: the scene has {count} places for probes, a third of their distance of {spacing_m} m apart, at most {PLACES_MAX} \
                 may be, and reaches {reach} steps of the lattice from the origin, at most {REACH_MAX} may be"
            )));
        }
        let step_m = place_m / stride as f32;
        let probes_max = cloud.field_probes_max as usize;
        Ok(Self { geometry, volume, spacing_m, step_m, stride, places: (low, size), probes_max, progress })
    }

    /// A point of the lattice in metres.
    pub fn position_m(&self, key: ProbeKey) -> Vec3 {
        Probe { key, moved: [0; 3] }.position_m(self.step_m)
    }

    /// Steps of the lattice over the distance between probes.
    pub fn steps(&self) -> i32 {
        PLACES * self.stride
    }

    /// Number of the places in narrow space, a sixth of the distance between probes apart, of the box that even places are in.
    pub fn narrow_places(&self) -> u64 {
        points(self.narrow())
    }

    /// Places of narrow space along each axis.
    fn narrow(&self) -> IVec3 {
        (self.places.1 - 1) * (NARROW / PLACES) + 1
    }

    /// A place of narrow space by its number.
    pub fn narrow_place(&self, index: u64) -> Option<ProbeKey> {
        let [x, y, _] = self.narrow().to_array().map(|along| along as u64);
        let at = IVec3::new((index % x) as i32, (index / x % y) as i32, (index / (x * y)) as i32);
        ProbeKey::of(self.places.0 * self.stride + at * self.narrow_step())
    }

    /// Steps of the lattice between places of narrow space.
    pub fn narrow_step(&self) -> i32 {
        self.steps() / NARROW
    }

    /// Corners of the box around all probes, in steps of the lattice.
    pub fn box_of_all(&self) -> [IVec3; 2] {
        let (low, size) = self.places;
        [(low - MARGIN) * self.stride, (low + size + MARGIN) * self.stride]
    }

    /// Whether a probe that light or an edge placed may stand at a point of the lattice.
    pub fn is_free(&self, key: ProbeKey) -> bool {
        let at_m = self.position_m(key);
        self.volume.holds(at_m) && place(self.geometry, at_m, CLEARANCE * self.spacing_m) == Place::Free
    }

    /// The nearest point of the lattice, of those around a place, that sees the place and where a probe may stand.
    pub fn snapped(&self, at_m: Vec3) -> Option<ProbeKey> {
        let low = (at_m / self.step_m).floor().as_ivec3();
        let corners = (0..8).map(|corner| low + IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2));
        let mut keys: Vec<(f32, ProbeKey)> = corners
            .filter_map(ProbeKey::of)
            .map(|key| (self.position_m(key).distance_squared(at_m), key))
            .collect();
        keys.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let may_stand = |key: &ProbeKey| {
            !self.geometry.tracer.is_occluded(at_m, self.position_m(*key)) && self.is_free(*key)
        };
        keys.into_iter().map(|(_, key)| key).find(may_stand)
    }

    /// Points of a grid as far apart as probes are to be, where these may stand, ascending by key: S2's first probes.
    ///
    /// Errors where there are too many.
    pub fn first_grid(&self) -> Result<Vec<ProbeKey>, TaskError> {
        use rayon::prelude::*;
        let (low, size) = self.places;
        // Points of the grid are every third even place.
        let first = (low + PLACES - 1).div_euclid(IVec3::splat(PLACES));
        let last = (low + size - 1).div_euclid(IVec3::splat(PLACES));
        let size = (last - first + 1).max(IVec3::ZERO);
        let [x, y] = [size.x as u64, size.y as u64];
        let point = |index: u64| {
            first + IVec3::new((index % x) as i32, (index / x % y) as i32, (index / (x * y)) as i32)
        };
        let free = |index: u64| {
            self.progress.check()?;
            let key = ProbeKey::of(point(index) * self.steps());
            Ok(key.filter(|key| self.progress.casting(|| self.is_free(*key))))
        };
        let all = (0..points(size)).into_par_iter().map(free).filter_map(Result::transpose);
        let mut keys: Vec<ProbeKey> = all.collect::<Result<_, Cancelled>>()?;
        keys.sort_unstable();
        if keys.len() > self.probes_max {
            return Err(TaskError::bad_input(format!(
                "placement by light starts from {} probes {} m apart, field_probes_max is {}; raise it or field_spacing_m, or take \
                 field_placement = 0 or 1",
                keys.len(),
                self.spacing_m,
                self.probes_max
            )));
        }
        Ok(keys)
    }
}
