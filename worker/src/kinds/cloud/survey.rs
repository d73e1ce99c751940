//! Probes of a cloud: where their placement has them; then some more where none at the corners of a tetrahedron sees into it, or along edges
//! that leak; and the tetrahedra between them.

use glam::IVec3;
use lightkiln_proto::kinds::cloud::{CloudSettings, Placement};
use lightkiln_proto::kinds::field::{FieldPart, FieldSettings, ProbeKey, TetrahedraTable};
use rayon::prelude::*;

use super::delaunay::tetrahedra;
use super::placement::even::{self, Stand, thin};
use super::placement::{Account, Ground, error, gradient, leak_edges, light::Light, spawn_merge};
use crate::geometry::Geometry;
use crate::kinds::field::{Survey, Tessellation};
use crate::rays::sampling::seed_of;
use crate::task::{Cancelled, Progress, TaskError};

/// Rounds in which places that see no probe of their tetrahedron get some.
const ROUNDS: u32 = 4;

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
        let mut places = placed(&ground, cloud.placement(), &mut survey)?;
        survey.tessellation = Some(tessellation(&ground, &survey)?);
        if cloud.field_leak_edges == 1 {
            return leak_edges::added(&ground, &mut survey, |survey| tessellation(&ground, survey));
        }
        seen(&ground, &mut survey, &mut places)
    })?;
    Ok(survey)
}

/// Adds probes where their placement has them; gives places that more may stand at.
fn placed(ground: &Ground<'_>, placement: Placement, survey: &mut Survey) -> Result<Vec<Stand>, TaskError> {
    let mut places = match placement {
        Placement::Even => even::places(ground)?,
        Placement::Error => error::places(ground, &mut survey.account)?,
        Placement::SpawnMerge => return by_light(ground, spawn_merge::probes, survey),
        Placement::Gradient => return by_light(ground, gradient::probes, survey),
    };
    ground.progress.begin(0.0, 1.0, (1 + u64::from(ROUNDS)) * places.len() as u64);
    thin(ground, survey, &mut places)?;
    Ok(places)
}

/// Probes of a placement from those of a grid.
type ByLight = fn(&Ground<'_>, &Light<'_>, &[ProbeKey], &mut Account) -> Result<Vec<ProbeKey>, Cancelled>;

/// Adds probes where light has them; gives even places.
fn by_light(ground: &Ground<'_>, probes: ByLight, survey: &mut Survey) -> Result<Vec<Stand>, TaskError> {
    let first = ground.first_grid()?;
    survey.account.push(("probes_first".to_owned(), first.len() as u64));
    let light = Light::of(ground.geometry, ground.progress)?;
    let probes = probes(ground, &light, &first, &mut survey.account)?;
    survey.probes = probes.into_iter().map(|key| (key.0, [0; 3])).collect();
    Ok(even::places(ground)?)
}

/// Adds probes at places that see no probe of their tetrahedron.
fn seen(ground: &Ground<'_>, survey: &mut Survey, places: &mut [Stand]) -> Result<(), TaskError> {
    for _ in 0..ROUNDS {
        let mut unseen = unseen(ground, survey, places)?;
        if thin(ground, survey, &mut unseen)? == 0 {
            return Ok(());
        }
        survey.tessellation = Some(tessellation(ground, survey)?);
    }
    Ok(())
}

/// Places that see no probe at the corners of their tetrahedron, in their order.
fn unseen(ground: &Ground<'_>, survey: &Survey, places: &[Stand]) -> Result<Vec<Stand>, TaskError> {
    let probes = (0..survey.probes.len()).map(|index| survey.probe(index)).collect();
    let part = FieldPart { spacing_m: survey.step_m, probes, ..FieldPart::default() };
    let Some(set) = survey.tetrahedra() else { return Ok(Vec::new()) };
    let table = TetrahedraTable::of(&[part], &set)
        .map_err(|error| TaskError::bad_input_from("the tetrahedra contradict their probes", error))?;
    let is_unseen = |stand: &&Stand| {
        if survey.probes.binary_search_by_key(&stand.key.0, |probe| probe.0).is_ok() {
            return false;
        }
        let at_m = ground.position_m(stand.key);
        let probes_m =
            table.around(at_m).into_iter().map(|(probe, _)| table.places_m[probe as usize].truncate());
        !probes_m.into_iter().any(|probe_m| !ground.geometry.tracer.is_occluded(probe_m, at_m))
    };
    let found =
        places.par_iter().map(|stand| ground.progress.check().map(|()| is_unseen(&stand).then_some(*stand)));
    Ok(found.filter_map(Result::transpose).collect::<Result<_, Cancelled>>()?)
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
