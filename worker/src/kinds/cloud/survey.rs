//! Probes of a cloud: places of free space in the order of their identities, those beside surfaces first, each left out where one before
//! it is near and sees it; then some more where none at the corners of a tetrahedron sees into it; and the tetrahedra between them.

use std::collections::{HashMap, HashSet};

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::{FieldPart, FieldSettings, Probe, ProbeKey, TetrahedraTable};
use rayon::prelude::*;

use super::delaunay::tetrahedra;
use crate::geometry::Geometry;
use crate::kinds::field::{Place, Survey, Tessellation, Volume, lattice, place, points, spacing_m};
use crate::rays::sampling::seed_of;
use crate::task::{Cancelled, Progress, TaskError};

/// Steps of the lattice of places over the distance between probes.
const STEPS: f32 = 3.0;
/// Nearest that a probe that it sees may be, over that distance: so that there is about one probe in each cube of its edge.
const NEAREST: f32 = 0.9;
/// Nearest that a surface may be, likewise.
const CLEARANCE: f32 = 0.1;
/// How near a surface is to places beside one, in steps of the lattice.
const BESIDE: f32 = 1.4;
/// Rounds in which places that see no probe of their tetrahedron get some.
const ROUNDS: u32 = 4;
/// Farthest place from the origin, in steps of their lattice: beyond it, tetrahedra are thinner than 32 bits tell.
const REACH_MAX: u32 = 1 << 16;
/// Most places.
const PLACES_MAX: u64 = 1 << 23;
/// Steps from the outermost places to the box around all probes.
const MARGIN: i32 = 3;

/// Probes of a scene in its volume, and the tetrahedra between them and the corners of a box around these.
pub fn survey(
    geometry: &Geometry,
    settings: &FieldSettings,
    progress: &Progress,
) -> Result<Survey, TaskError> {
    let spacing_m = spacing_m(geometry.near_bounds_m(), settings);
    let volume = Volume::of(geometry, spacing_m);
    let step_m = spacing_m / STEPS;
    let (low, size) = lattice(volume.outer_m(), step_m);
    let count = points(size);
    let ends = [low, low.saturating_add(size)].map(|end| end.to_array());
    let reach = ends.iter().flatten().map(|along| along.unsigned_abs()).max().unwrap_or_default();
    if count > PLACES_MAX || reach > REACH_MAX {
        let which = match settings.field_spacing_m {
            0.0 => format!("field_probes = {} are too many; lower it", settings.field_probes),
            _ => format!("field_spacing_m = {spacing_m} is too fine; raise it"),
        };
        return Err(TaskError::bad_input(format!(
            "{which}: the scene has {count} places for probes, a third of their distance of {spacing_m} m apart, at most {PLACES_MAX} \
             may be, and reaches {reach} of these steps from the origin, at most {REACH_MAX} may be"
        )));
    }
    let mut survey = Survey { spacing_m, step_m, ..Survey::default() };
    progress.casting(|| {
        let mut places = places(geometry, &volume, step_m, (low, size), progress)?;
        progress.begin(0.0, 1.0, (1 + u64::from(ROUNDS)) * places.len() as u64);
        thin(geometry, &mut survey, &mut places, progress)?;
        for _ in 0..ROUNDS {
            survey.tessellation = Some(tessellation(&survey, (low, size))?);
            let mut unseen = unseen(geometry, &survey, &places, progress)?;
            if thin(geometry, &mut survey, &mut unseen, progress)? == 0 {
                return Ok(());
            }
        }
        survey.tessellation = Some(tessellation(&survey, (low, size))?);
        Ok::<_, TaskError>(())
    })?;
    Ok(survey)
}

/// Places of the volume, those beside surfaces first, each group in the order of hashes: between probes beside surfaces light is told,
/// beyond the outermost it is guessed.
fn places(
    geometry: &Geometry,
    volume: &Volume<'_>,
    step_m: f32,
    (low, size): (IVec3, IVec3),
    progress: &Progress,
) -> Result<Vec<ProbeKey>, Cancelled> {
    let [x, y] = [size.x as u64, size.y as u64];
    let point =
        |index: u64| low + IVec3::new((index % x) as i32, (index / x % y) as i32, (index / (x * y)) as i32);
    let placed = |index: u64| {
        progress.check()?;
        let Some(key) = ProbeKey::of(point(index)) else { return Ok(None) };
        let at_m = position_m(key, step_m);
        let order = || (!is_beside(geometry, at_m, BESIDE * step_m), seed_of(&[key.0, 13]), key);
        Ok(volume.holds(at_m).then(order))
    };
    let all = (0..points(size)).into_par_iter().map(placed).filter_map(Result::transpose);
    let mut order: Vec<(bool, u64, ProbeKey)> = all.collect::<Result<_, Cancelled>>()?;
    order.par_sort_unstable();
    Ok(order.into_iter().map(|(.., key)| key).collect())
}

fn position_m(key: ProbeKey, step_m: f32) -> Vec3 {
    Probe { key, moved: [0; 3] }.position_m(step_m)
}

/// Adds probes at places, in their order, that no probe of this call is near and sees; says how many, and takes places away that are not free.
fn thin(
    geometry: &Geometry,
    survey: &mut Survey,
    places: &mut Vec<ProbeKey>,
    progress: &Progress,
) -> Result<usize, Cancelled> {
    let (step_m, spacing_m) = (survey.step_m, survey.spacing_m);
    let before = survey.probes.len();
    let is_first = survey.tessellation.is_none();
    // Probes of this call, by cubes of the distance between them.
    let mut kept: HashMap<IVec3, Vec<Vec3>> = HashMap::new();
    let mut shut = HashSet::new();
    for &key in &*places {
        progress.check()?;
        progress.advance(1);
        let at_m = position_m(key, step_m);
        let cell = (at_m / spacing_m).floor().as_ivec3();
        let around =
            (-1..2).flat_map(|z| (-1..2).flat_map(move |y| (-1..2).map(move |x| IVec3::new(x, y, z))));
        let near = around.filter_map(|by| kept.get(&(cell + by))).flatten();
        let is_near = |other: &&Vec3| other.distance_squared(at_m) < (NEAREST * spacing_m).powi(2);
        if near.filter(is_near).any(|&other_m| !geometry.tracer.is_occluded(other_m, at_m)) {
            continue;
        }
        match place(geometry, at_m, CLEARANCE * spacing_m) {
            Place::Free => {
                kept.entry(cell).or_default().push(at_m);
                survey.probes.push((key.0, [0; 3]));
            }
            not_free => {
                survey.inside += u64::from(is_first && not_free == Place::Inside);
                shut.insert(key);
            }
        }
    }
    survey.probes.sort_unstable();
    places.retain(|key| !shut.contains(key));
    Ok(survey.probes.len() - before)
}

/// Places that see no probe at the corners of their tetrahedron, in their order.
fn unseen(
    geometry: &Geometry,
    survey: &Survey,
    places: &[ProbeKey],
    progress: &Progress,
) -> Result<Vec<ProbeKey>, TaskError> {
    let probes = (0..survey.probes.len()).map(|index| survey.probe(index)).collect();
    let part = FieldPart { spacing_m: survey.step_m, probes, ..FieldPart::default() };
    let Some(set) = survey.tetrahedra() else { return Ok(Vec::new()) };
    let table = TetrahedraTable::of(&[part], &set)
        .map_err(|error| TaskError::bad_input_from("the tetrahedra contradict their probes", error))?;
    let is_unseen = |key: &&ProbeKey| {
        if survey.probes.binary_search_by_key(&key.0, |probe| probe.0).is_ok() {
            return false;
        }
        let at_m = position_m(**key, survey.step_m);
        let probes_m =
            table.around(at_m).into_iter().map(|(probe, _)| table.places_m[probe as usize].truncate());
        !probes_m.into_iter().any(|probe_m| !geometry.tracer.is_occluded(probe_m, at_m))
    };
    let found = places.par_iter().map(|key| progress.check().map(|()| is_unseen(&key).then_some(*key)));
    Ok(found.filter_map(Result::transpose).collect::<Result<_, Cancelled>>()?)
}

/// A surface is nearer than so much along an axis or a diagonal.
fn is_beside(geometry: &Geometry, at_m: Vec3, reach_m: f32) -> bool {
    (0..27).filter(|way| *way != 13).any(|way: i32| {
        let way = IVec3::new(way % 3, way / 3 % 3, way / 9) - 1;
        geometry.tracer.is_occluded(at_m, at_m + reach_m * way.as_vec3().normalize())
    })
}

/// Tetrahedra between the probes and the corners of a box around the bounds, in steps of the lattice, as whole numbers have no rounding.
fn tessellation(survey: &Survey, (low, size): (IVec3, IVec3)) -> Result<Tessellation, TaskError> {
    let of_box = [low - MARGIN, low + size + MARGIN];
    let box_m = of_box.map(|corner| (corner.as_vec3() * survey.step_m).to_array());
    if survey.probes.is_empty() {
        return Ok(Tessellation { box_m, tetrahedra: Vec::new() });
    }
    let points: Vec<(IVec3, u64)> =
        survey.probes.iter().map(|&(key, _)| (ProbeKey(key).point(), seed_of(&[key, 14]))).collect();
    let tetrahedra = tetrahedra(of_box, &points)
        .map_err(|error| TaskError::bad_input_from("there are no tetrahedra between the probes", error))?;
    Ok(Tessellation { box_m, tetrahedra })
}
