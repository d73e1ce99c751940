//! The lattice over a scene, and which of its points have probes.

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::{FieldSettings, LATTICE_MAX, ProbeKey};
use lightkiln_proto::kinds::grid::LatticeSettings;
use rayon::prelude::*;

use super::cells::in_cells;
use super::standing::standing;
use crate::geometry::Geometry;
use crate::kinds::field::{Survey, Volume, is_inside, lattice, points, spacing_m};
use crate::task::{Cancelled, Progress, TaskError};

/// Most points of a lattice.
const POINTS_MAX: u64 = 1 << 20;
/// Depth within bounds from which on something is there to be lit, over the lattice's step.
const MARGIN: f32 = 0.05;

/// A finding at a point of the lattice.
enum Found {
    /// A probe, and how far it was moved.
    Probe(ProbeKey, [i8; 3]),
    /// Geometry.
    Inside,
    /// Nothing that a probe could light.
    Idle,
}

/// Probes of a scene: at the points of the lattice in its volume, and those around it that see a cell of theirs within bounds, but for those
/// in geometry.
pub fn survey(
    geometry: &Geometry,
    (field, of_lattice): (&FieldSettings, &LatticeSettings),
    progress: &Progress,
) -> Result<Survey, TaskError> {
    let spacing_m = spacing_m(geometry.near_bounds_m(), field);
    let volume = Volume::of(geometry, spacing_m);
    let (low, size) = match of_lattice.field_moves {
        0 => lattice(volume.bounds_m, spacing_m),
        _ => lattice(volume.outer_m(), spacing_m),
    };
    let count = points(size);
    let ends = [low, low.saturating_add(size)].map(|end| end.to_array());
    let reach = ends.iter().flatten().map(|along| along.unsigned_abs()).max().unwrap_or_default();
    if count > POINTS_MAX || reach > LATTICE_MAX.unsigned_abs() {
        return Err(TaskError::bad_input(format!(
            "field_spacing_m = {spacing_m} is too fine: the scene has {count} points of such a lattice, at most \
             {POINTS_MAX} may be, and reaches {reach} steps from the origin, at most {LATTICE_MAX} may be; raise it"
        )));
    }
    progress.begin(0.0, 1.0, count);
    let point = |index: u64| {
        let [x, y] = [size.x as u64, size.y as u64];
        low + IVec3::new((index % x) as i32, (index / x % y) as i32, (index / (x * y)) as i32)
    };
    let found: Vec<Found> = (0..count)
        .into_par_iter()
        .map(|index| {
            progress.check()?;
            let point = point(index);
            let found = progress.casting(|| match of_lattice.field_moves {
                0 => plain_at(geometry, point, spacing_m),
                _ => found_at(geometry, point, spacing_m, &volume),
            });
            progress.advance(1);
            Ok(found)
        })
        .collect::<Result<_, Cancelled>>()?;
    let mut survey = Survey { spacing_m, step_m: spacing_m, ..Survey::default() };
    // Points ascend as keys do.
    for found in found {
        match found {
            Found::Probe(key, moved) => survey.probes.push((key.0, moved)),
            Found::Inside => survey.inside += 1,
            Found::Idle => {}
        }
    }
    if of_lattice.field_moves == 0 {
        return Ok(survey);
    }
    let cells = in_cells(geometry, &survey, (low, size), volume.bounds_m, progress)?;
    survey.in_cells = cells.len() as u64;
    survey.probes.extend(cells);
    Ok(survey)
}

/// A point of the lattice whose probe stays there, unless it is in geometry.
fn plain_at(geometry: &Geometry, point: IVec3, spacing_m: f32) -> Found {
    let key = ProbeKey::of(point).filter(|_| !is_inside(geometry, point.as_vec3() * spacing_m));
    key.map_or(Found::Inside, |key| Found::Probe(key, [0; 3]))
}

/// A point of the lattice.
fn found_at(geometry: &Geometry, point: IVec3, spacing_m: f32, volume: &Volume<'_>) -> Found {
    let point_m = point.as_vec3() * spacing_m;
    let is_of_use =
        |at_m: Vec3| volume.holds(at_m) || sees_bounds(geometry, (at_m, point_m), spacing_m, volume.bounds_m);
    if !is_of_use(point_m) {
        return Found::Idle;
    }
    match (standing(geometry, point, spacing_m, is_of_use), ProbeKey::of(point)) {
        (Some(moved), Some(key)) => Found::Probe(key, moved),
        _ => Found::Inside,
    }
}

/// A place outside of bounds sees the middle of one of its point's cells at least, as far as that is within.
fn sees_bounds(
    geometry: &Geometry,
    (at_m, point_m): (Vec3, Vec3),
    spacing_m: f32,
    [low_m, high_m]: [Vec3; 2],
) -> bool {
    (0..8).any(|corner: u32| {
        let side = |axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
        let middle_m = point_m + spacing_m * Vec3::new(side(0), side(1), side(2));
        // Clear of walls that lie in the bounds' own sides.
        let margin_m = (MARGIN * spacing_m).min(0.25 * (high_m - low_m).min_element());
        let within_m = middle_m.clamp(low_m + margin_m, high_m - margin_m);
        within_m.distance(middle_m) < spacing_m && !geometry.tracer.is_occluded(at_m, within_m)
    })
}
