//! The lattice over a scene, and which of its points have probes.

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::grid::{FieldSettings, LATTICE_MAX, ProbeKey};
use rayon::prelude::*;

use super::Survey;
use super::cells::in_cells;
use super::standing::{is_inside, standing};
use crate::geometry::Geometry;
use crate::geometry::lattice::snapped_size_m;
use crate::task::{Cancelled, Progress, TaskError};

/// Most points of a lattice.
const POINTS_MAX: u64 = 1 << 20;
/// Depth within bounds from which on something is there to be lit, over the lattice's step.
const MARGIN: f32 = 0.05;
/// Share of a size below which the next finer one of {1, 1.5} × 2ⁿ is snapped to.
const FINER: f64 = 0.72;

/// A finding at a point of the lattice.
enum Found {
    /// A probe, and how far it was moved.
    Probe(ProbeKey, [i8; 3]),
    /// Geometry.
    Inside,
    /// Nothing that a probe could light.
    Idle,
}

/// Probes of a scene: at the points of the lattice within its near bounds and one step around them, but for those in geometry, and
/// those outside of the bounds that see no cell of theirs within.
pub fn survey(
    geometry: &Geometry,
    settings: &FieldSettings,
    progress: &Progress,
) -> Result<Survey, TaskError> {
    let bounds_m = geometry.near_bounds_m();
    let spacing_m = spacing_m(bounds_m, settings);
    let (low, size) = lattice(bounds_m, spacing_m);
    let count = points(size);
    let reach = low.abs().max((low + size).abs()).max_element();
    if count > POINTS_MAX || reach > LATTICE_MAX {
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
            let found = progress.casting(|| match settings.field_moves {
                0 => plain_at(geometry, point, spacing_m),
                _ => found_at(geometry, point, spacing_m, bounds_m),
            });
            progress.advance(1);
            Ok(found)
        })
        .collect::<Result<_, Cancelled>>()?;
    let mut survey = Survey { spacing_m, ..Survey::default() };
    // Points ascend as keys do.
    for found in found {
        match found {
            Found::Probe(key, moved) => survey.probes.push((key.0, moved)),
            Found::Inside => survey.inside += 1,
            Found::Idle => {}
        }
    }
    if settings.field_moves == 0 {
        return Ok(survey);
    }
    let cells = in_cells(geometry, &survey, (low, size), bounds_m, progress)?;
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
fn found_at(geometry: &Geometry, point: IVec3, spacing_m: f32, bounds_m: [Vec3; 2]) -> Found {
    let point_m = point.as_vec3() * spacing_m;
    let [low_m, high_m] = bounds_m;
    let is_of_use = |at_m: Vec3| {
        let is_within = at_m.cmpge(low_m).all() && at_m.cmple(high_m).all();
        is_within || sees_bounds(geometry, (at_m, point_m), spacing_m, bounds_m)
    };
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

/// Step of the lattice in metres: as set, or of {1, 1.5} × 2ⁿ the last from the scene's longest side down before
/// there are more points than `field_probes`.
fn spacing_m(bounds_m: [Vec3; 2], settings: &FieldSettings) -> f32 {
    if settings.field_spacing_m > 0.0 {
        return settings.field_spacing_m;
    }
    let [low_m, high_m] = bounds_m;
    let longest_m = (high_m - low_m).max_element().max(1e-6);
    let mut spacing_m = snapped_size_m(f64::from(longest_m)) as f32;
    let is_much = |spacing_m: f32| points(lattice(bounds_m, spacing_m).1) > u64::from(settings.field_probes);
    loop {
        let finer_m = snapped_size_m(f64::from(spacing_m) * FINER) as f32;
        if is_much(finer_m) {
            return spacing_m;
        }
        spacing_m = finer_m;
    }
}

/// Least point of the lattice, and the number of points along each axis.
fn lattice([low_m, high_m]: [Vec3; 2], spacing_m: f32) -> (IVec3, IVec3) {
    let low = (low_m / spacing_m).floor().as_ivec3();
    // A scene that ends on points of the lattice needs none beyond.
    let high = (high_m / spacing_m).ceil().as_ivec3();
    (low, high.saturating_sub(low).saturating_add(IVec3::ONE))
}

fn points(size: IVec3) -> u64 {
    size.to_array().iter().map(|&along| u64::from(along.unsigned_abs())).fold(1, u64::saturating_mul)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacing_is_the_finest_that_has_no_more_points_than_asked_for() {
        let bounds_m = [Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 2.0, 1.0)];
        let of = |field_probes: u32| FieldSettings { field_probes, field_spacing_m: 0.0, ..settings() };
        assert_eq!(spacing_m(bounds_m, &of(125)), 0.5);
        assert_eq!(spacing_m(bounds_m, &of(8)), 2.0);
        assert_eq!(points(lattice(bounds_m, 0.5).1), 125);
        let flat = [Vec3::ZERO, Vec3::new(4.0, 0.0, 4.0)];
        assert!(points(lattice(flat, spacing_m(flat, &of(100))).1) <= 100);
        assert_eq!(spacing_m(bounds_m, &FieldSettings { field_spacing_m: 0.3, ..settings() }), 0.3);
    }

    fn settings() -> FieldSettings {
        lightkiln_proto::kinds::grid::Settings::from_json(&serde_json::Value::Null).unwrap().field
    }
}
