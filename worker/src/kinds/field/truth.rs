//! Light by paths, at places and at the probes around them: what a field without other errors would have.

use std::collections::BTreeSet;

use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::field::{FieldTable, PROBE_ROWS, deringed};
use rayon::prelude::*;

use super::capture::{Capture, CaptureRays, Coefficients};
use super::readings::Reading;
use crate::factors::Threads;
use crate::geometry::Geometry;
use crate::rays::sampling::seed_of;
use crate::task::{Cancelled, Progress};

/// Rays of a place.
const AT_PLACES: CaptureRays = CaptureRays { rays: 512, paths: 1, emitter_rays: 64 };
/// Rays of a probe: several are read together.
const AT_PROBES: CaptureRays = CaptureRays { rays: 256, paths: 1, emitter_rays: 32 };

/// Coefficients of irradiance by normal, by paths.
pub struct Truth {
    /// At each place.
    pub own: Vec<[Vec4; PROBE_ROWS]>,
    /// At each probe, as a field's; 0 at probes that no place sees around it.
    pub rows: Vec<Vec4>,
}

impl Truth {
    /// At some places of a field.
    pub fn of(
        capture: &Capture<'_>,
        (field, geometry): (&FieldTable, &Geometry),
        points_m: &[Vec3],
        progress: &Progress,
    ) -> Result<Self, Cancelled> {
        let around = |&point_m: &Vec3| {
            let weights = Reading::Exact.weights(field, geometry, point_m);
            weights.into_iter().filter(|(_, weight)| *weight > 0.0).map(|(probe, _)| probe).collect()
        };
        let around: Vec<Vec<u32>> = points_m.par_iter().map(around).collect();
        let probes: BTreeSet<u32> = around.into_iter().flatten().collect();
        let probes: Vec<u32> = probes.into_iter().collect();
        let places_m: Vec<(Vec3, CaptureRays)> = points_m
            .iter()
            .map(|&point_m| (point_m, AT_PLACES))
            .chain(probes.iter().map(|&probe| (field.position_m[probe as usize].truncate(), AT_PROBES)))
            .collect();
        let light = |&(place_m, rays): &(Vec3, CaptureRays)| {
            progress.check()?;
            let [x, y, z] = place_m.to_array().map(|at| u64::from(at.to_bits()));
            let seed = seed_of(&[x, y, z, 43]);
            Ok(progress.casting(|| wide(&capture.at(place_m, seed, rays))))
        };
        let mut own: Vec<[Vec4; PROBE_ROWS]> =
            places_m.par_iter().map(light).collect::<Result<_, Cancelled>>()?;
        let of_probes = own.split_off(points_m.len());
        let mut rows = vec![Vec4::ZERO; PROBE_ROWS * field.len()];
        for (probe, of) in probes.into_iter().zip(of_probes) {
            rows[PROBE_ROWS * probe as usize..][..PROBE_ROWS].copy_from_slice(&of);
        }
        // As those of a field are.
        let rows = deringed(&Threads, &rows);
        Ok(Self { own, rows })
    }
}

fn wide(of: &Coefficients) -> [Vec4; PROBE_ROWS] {
    of.map(|[r, g, b]| Vec4::new(r, g, b, 0.0))
}
