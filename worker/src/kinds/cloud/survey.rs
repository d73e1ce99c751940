//! Probes of a cloud: where their placement has them; then some more where none at the corners of a tetrahedron sees into it, or along edges
//! that leak; and the tetrahedra between them.

use std::collections::HashSet;

use glam::IVec3;
use lightkiln_proto::kinds::cloud::{CloudSettings, Placement};
use lightkiln_proto::kinds::field::{FieldPart, FieldSettings, ProbeKey, TetrahedraTable};
use rayon::prelude::*;

use super::delaunay::tetrahedra;
use super::placement::even::{self, Stand, clearance_m, thin};
use super::placement::{Account, Ground, error, gradient, leak_edges, light::Light, spawn_merge};
use crate::geometry::{Bits, Geometry};
use crate::kinds::field::{Place, Survey, Tessellation, is_free, narrow_clearance_m, place};
use crate::rays::sampling::seed_of;
use crate::task::{Cancelled, Progress, TaskError};

/// Rounds in which places that see no probe of their tetrahedron get some.
const ROUNDS: u32 = 4;
/// Share of the survey that is done when probes stand where their placement has them.
const FIRST: f32 = 0.3;
/// Places beside a place that see no probe either, at least, for it to be worth one: cracks have fewer.
const BESIDE: usize = 3;

/// Probes of a scene in its volume, and the tetrahedra between them and the corners of a box around these.
pub fn survey(
    geometry: &Geometry,
    (field, cloud): (&FieldSettings, &CloudSettings),
    progress: &Progress,
) -> Result<Survey, TaskError> {
    let ground = Ground::of(geometry, (field, cloud), progress)?;
    let Ground { spacing_m, step_m, .. } = ground;
    let mut survey = Survey { spacing_m, step_m, ..Survey::default() };
    progress.casting(|| {
        placed(&ground, cloud.placement(), &mut survey)?;
        survey.tessellation = Some(tessellation(&ground, &survey)?);
        if cloud.field_leak_edges == 1 {
            return leak_edges::added(&ground, &mut survey, |survey| tessellation(&ground, survey));
        }
        seen(&ground, &mut survey)
    })?;
    Ok(survey)
}

/// Adds probes where their placement has them.
fn placed(ground: &Ground<'_>, placement: Placement, survey: &mut Survey) -> Result<(), TaskError> {
    let places = match placement {
        Placement::Even => even::places(ground)?,
        Placement::Error => error::places(ground, &mut survey.account)?,
        Placement::SpawnMerge => return by_light(ground, spawn_merge::probes, survey),
        Placement::Gradient => return by_light(ground, gradient::probes, survey),
    };
    ground.progress.begin(0.0, FIRST, places.len() as u64);
    let mut inside = 0;
    let may_stand = |stand: &Stand, at_m| {
        let found = place(ground.geometry, at_m, clearance_m(ground, stand));
        inside += u64::from(found == Place::Inside);
        found == Place::Free
    };
    thin(ground, survey, &places, may_stand)?;
    survey.inside = inside;
    Ok(())
}

/// Probes of a placement from those of a grid.
type ByLight = fn(&Ground<'_>, &Light<'_>, &[ProbeKey], &mut Account) -> Result<Vec<ProbeKey>, Cancelled>;

/// Adds probes where light has them.
fn by_light(ground: &Ground<'_>, probes: ByLight, survey: &mut Survey) -> Result<(), TaskError> {
    let first = ground.first_grid()?;
    survey.account.push(("probes_first".to_owned(), first.len() as u64));
    let light = Light::of(ground.geometry, ground.progress)?;
    let probes = probes(ground, &light, &first, &mut survey.account)?;
    survey.probes = probes.into_iter().map(|key| (key.0, [0; 3])).collect();
    Ok(())
}

/// Adds probes at places that see no probe of their tetrahedron.
fn seen(ground: &Ground<'_>, survey: &mut Survey) -> Result<(), TaskError> {
    ground.progress.begin(FIRST, 1.0, u64::from(ROUNDS) * ground.narrow_places());
    let shut = Bits::new(ground.narrow_places() as usize);
    for _ in 0..ROUNDS {
        let unseen = unseen(ground, survey, &shut)?;
        if thin(ground, survey, &unseen, |_, _| true)? == 0 {
            return Ok(());
        }
        survey.tessellation = Some(tessellation(ground, survey)?);
    }
    Ok(())
}

/// Free places, narrow ones too, that see no probe at the corners of their tetrahedron, in the order in which they become probes. Those that
/// are `shut` are not free, and others that turn out not to be are added to them.
fn unseen(ground: &Ground<'_>, survey: &Survey, shut: &Bits) -> Result<Vec<Stand>, TaskError> {
    let probes = (0..survey.probes.len()).map(|index| survey.probe(index)).collect();
    let part = FieldPart { spacing_m: survey.step_m, probes, ..FieldPart::default() };
    let Some(set) = survey.tetrahedra() else { return Ok(Vec::new()) };
    let table = TetrahedraTable::of(&[part], &set)
        .map_err(|error| TaskError::bad_input_from("the tetrahedra contradict their probes", error))?;
    let Ground { geometry, spacing_m, .. } = *ground;
    let is_unseen = |key: ProbeKey, index: usize| {
        if survey.probes.binary_search_by_key(&key.0, |probe| probe.0).is_ok() {
            return false;
        }
        let at_m = ground.position_m(key);
        let mut probes_m =
            table.around(at_m).into_iter().map(|(probe, _)| table.places_m[probe as usize].truncate());
        if probes_m.any(|probe_m| !geometry.tracer.is_occluded(probe_m, at_m)) {
            return false;
        }
        let is_open = ground.volume.holds(at_m) && is_free(geometry, at_m, narrow_clearance_m(spacing_m));
        if !is_open {
            shut.add(index);
        }
        is_open
    };
    let found = (0..ground.narrow_places()).into_par_iter().map(|index| {
        ground.progress.check()?;
        ground.progress.advance(1);
        let (key, index) = (ground.narrow_place(index), index as usize);
        let key = key.filter(|_| !shut.has(index));
        Ok(key.filter(|key| ground.progress.casting(|| is_unseen(*key, index))))
    });
    let found: HashSet<ProbeKey> = found.filter_map(Result::transpose).collect::<Result<_, Cancelled>>()?;
    let step = ground.narrow_step();
    let is_one_of_some = |key: &&ProbeKey| {
        let around =
            (0..27).filter(|way| *way != 13).map(|way| IVec3::new(way % 3, way / 3 % 3, way / 9) - 1);
        let beside = around.filter_map(|way| ProbeKey::of(key.point() + step * way));
        beside.filter(|beside| found.contains(beside)).count() >= BESIDE
    };
    let found = found.par_iter().filter(is_one_of_some);
    Ok(even::ordered(ground, found.map(|&key| Stand { key, spacing_m }))?)
}

/// Tetrahedra between the probes and the corners of a box around the bounds, in steps of the lattice, as whole numbers have no rounding.
fn tessellation(ground: &Ground<'_>, survey: &Survey) -> Result<Tessellation, TaskError> {
    let of_box = ground.box_of_all();
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

#[cfg(test)]
mod tests;
