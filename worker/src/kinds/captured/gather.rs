//! Task `captured.gather`: light at the probes of a cell, and their depth maps.

use glam::Vec3;
use lightkiln_proto::content::EmitterIrradiance;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::captured::CaptureSettings;
use lightkiln_proto::kinds::field::{FieldPart, FieldSettings, encode_field};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::emitters::EmitterSet;
use crate::factors::cell_of_task;
use crate::geometry::Geometry;
use crate::kinds::field::{
    Account, Around, Capture, CaptureRays, Coefficients, RAYS_OF_PLACE, Survey, depths, fit_places,
    fit_shares, fitted_emitters,
};
use crate::rays::sampling::seed_of;
use crate::reference::Reference;
use crate::task::{Cancelled, Context, TaskError, TaskOutput, params};

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// Index of the cell.
    pub cell: usize,
    /// Settings of probes.
    pub field: FieldSettings,
    /// Settings of their light.
    pub capture: CaptureSettings,
}

/// A point that rays leave.
struct Start {
    position_m: Vec3,
    seed: u64,
    rays: u32,
}

/// Runs the task: inputs `import/scene…`, `probes`, `cells`; outputs `chunk/0` and `account`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let params: Params = params(task)?;
    let survey = Survey::of(context)?;
    let mut cell = cell_of_task(context, params.cell)?;
    if cell.receivers.iter().any(|&probe| probe as usize >= survey.probes.len()) {
        return Err(TaskError::bad_input("the task names probes that the plan does not have"));
    }
    // Probes ascend in a chunk.
    cell.receivers.sort_unstable();
    let geometry = Geometry::of(context)?;
    let lighting = super::lighting(&geometry)?;
    let reference = Reference::new(&geometry, &lighting)
        .map_err(|error| TaskError::bad_input_from("a light of the scene file cannot light probes", error))?;
    let emitters = EmitterSet::of(context, &geometry)?;
    let capture = Capture::new(&geometry, &emitters, &reference, 1.0);
    let around = Around::of(&survey, &cell.receivers, params.capture.field_fit == 1);
    let depths = |&probe: &u32| {
        context.progress.check()?;
        let position_m = survey.probe(probe as usize).position_m(survey.step_m);
        let depths = || depths(&geometry, position_m, survey.step_m, &capture.trail());
        Ok(context.progress.casting(depths))
    };
    let maps: Vec<Vec<u16>> = around.probes.par_iter().map(depths).collect::<Result<_, Cancelled>>()?;
    let trail = capture.trail();
    let places = || fit_places(&geometry, &survey, &around, maps.concat(), &trail);
    let places = context.progress.casting(places);
    let places =
        places.map_err(|error| TaskError::bad_input_from("the probes contradict each other", error))?;
    let rays = params.field.probe_rays;
    let of_probe = |&probe: &u32| {
        let probe = survey.probe(probe as usize);
        Start { position_m: probe.position_m(survey.step_m), seed: seed_of(&[probe.key.0, 8]), rays }
    };
    let mut starts: Vec<Start> = around.probes.iter().map(of_probe).collect();
    starts.extend(places.iter().map(|place| Start {
        position_m: place.position_m,
        seed: place.seed,
        rays: rays / RAYS_OF_PLACE,
    }));
    let light = light(&capture, &starts, &params, context)?;
    let own = cell.receivers.len();
    let rows: Vec<Coefficients> = if places.is_empty() {
        light.into_iter().take(own).flatten().collect()
    } else {
        let shares = fit_shares(around.probes.len(), own, &places);
        shares.iter().flat_map(|of| fitted_emitters(of, &light)).collect()
    };
    let account = Account { probes: own as u64, ranks: 0 };
    let irradiance = rows.as_flattened().iter().map(|light| light.map(rounded)).collect();
    let part = FieldPart {
        spacing_m: survey.step_m,
        probes: cell.receivers.iter().map(|&probe| survey.probe(probe as usize)).collect(),
        depths: maps.into_iter().take(own).flatten().collect(),
        emitters: vec![EmitterIrradiance { emitter: 0, irradiance }],
        ..FieldPart::default()
    };
    // There is no transport whose numbers could err.
    let encoded = encode_field(&part, 0.5)
        .map_err(|error| TaskError::bad_input_from("the probes cannot be stored", error))?;
    let account = serde_json::to_vec(&account)
        .map_err(|error| TaskError::bad_input_from("the account of probes cannot be written", error))?;
    let artefacts = vec![("chunk/0".to_owned(), encoded.bytes), ("account".to_owned(), account)];
    Ok(TaskOutput { artefacts, ..TaskOutput::default() })
}

/// Light at points, one set of coefficients each.
fn light(
    capture: &Capture<'_>,
    starts: &[Start],
    params: &Params,
    context: &Context,
) -> Result<Vec<Vec<Coefficients>>, Cancelled> {
    let CaptureSettings { field_paths: paths, field_emitter_rays, .. } = params.capture;
    context.progress.begin(0.0, 0.9, starts.len() as u64);
    let at = |&Start { position_m, seed, rays }: &Start| {
        context.progress.check()?;
        let of_ray = params.field.probe_rays / rays;
        let rays = CaptureRays { rays, paths, emitter_rays: (field_emitter_rays / of_ray).max(1) };
        let light = context.progress.casting(|| capture.at(position_m, seed, rays));
        context.progress.advance(1);
        Ok(vec![light])
    };
    starts.par_iter().map(at).collect()
}

/// The nearest number of 11 significant bits: the others are noise, and would take as many bytes again.
fn rounded(light: f32) -> f32 {
    const DROPPED: u32 = 13;
    let half = 1 << (DROPPED - 1);
    let near = f32::from_bits((light.to_bits() + half) & !((1 << DROPPED) - 1));
    if near.is_finite() { near } else { light }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_keeps_eleven_bits_however_dim_it_is() {
        for light in [0.0, 1.0, -3.5, 0.1, 1e-12, -7.7e8, f32::MAX] {
            let near = rounded(light);
            assert!((near - light).abs() <= light.abs() / 2048.0, "{near} for {light}");
        }
        assert_eq!(rounded(0.1).to_bits() & 0x1fff, 0);
    }
}
