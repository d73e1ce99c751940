//! Task `sh.relight`: hits of the relight rays of a batch of probes (METHOD.md §2.11).

use glam::Vec3;
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::sh::{Probe, ProbeBatch, RelightHit, encode_probe_batch};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::ProbeSet;
use crate::lightmap::{Numbering, Surface, World};
use crate::task::{Context, TaskError, TaskOutput, params};

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// First probe of the plan.
    pub first: usize,
    /// Count of probes.
    pub count: usize,
    /// K.
    pub relight_rays: u32,
}

/// Runs the task: inputs of [`World::of`] and `probes`; output `chunk`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let params: Params = params(task)?;
    let world = World::of(context)?;
    let all = ProbeSet::of(context)?;
    let probes = params
        .first
        .checked_add(params.count)
        .and_then(|end| all.probes.get(params.first..end))
        .ok_or_else(|| TaskError::bad_input("the task names probes that the plan does not have"))?;
    if !params.relight_rays.is_power_of_two() {
        return Err(TaskError::bad_input("relight_rays is not a power of two"));
    }
    context.progress.begin(0.0, 1.0, probes.len() as u64);
    let met: Vec<Vec<Option<Surface>>> = probes
        .par_iter()
        .map(|probe| {
            context.progress.check()?;
            let hits = context.progress.casting(|| hits_of(&world, probe, params.relight_rays));
            context.progress.advance(1);
            Ok(hits)
        })
        .collect::<Result<_, TaskError>>()?;
    let batch = batch_of(&world, probes, params.relight_rays, &met);
    let bytes = encode_probe_batch(&batch)
        .map_err(|error| TaskError::bad_input_from("the probes cannot be stored", error))?;
    Ok(TaskOutput { artefacts: vec![("chunk".into(), bytes)], ..TaskOutput::default() })
}

/// `y_pk` for all k; `None` is the sky.
fn hits_of(world: &World, probe: &Probe, rays: u32) -> Vec<Option<Surface>> {
    let position_m = Vec3::from_array(probe.position_m);
    (0..rays)
        .map(|ray| {
            let direction = relight_direction(ray, rays);
            let hit = world.geometry.tracer.met(position_m, direction, f32::INFINITY)?;
            Some(world.linked_surface_at(&hit, position_m + direction * hit.t))
        })
        .collect()
}

/// Names receivers by block and texel.
fn batch_of(world: &World, probes: &[Probe], relight_rays: u32, met: &[Vec<Option<Surface>>]) -> ProbeBatch {
    let lightmap = &world.lightmap;
    let receivers = met.iter().flatten().filter_map(|surface| match surface {
        Some(Surface::Receiver(receiver)) => Some(lightmap.block_key(*receiver)),
        Some(Surface::Dark) | None => None,
    });
    let blocks = Numbering::of(receivers);
    let name = |surface: &Option<Surface>| match surface {
        None => RelightHit::Sky,
        Some(Surface::Dark) => RelightHit::Dark,
        Some(Surface::Receiver(receiver)) => {
            let (block, texel) = lightmap.name_of(*receiver);
            RelightHit::Receiver { block: blocks.place_u16(block), texel }
        }
    };
    ProbeBatch {
        probes: probes.to_vec(),
        relight_rays,
        hits: met.iter().flatten().map(name).collect(),
        blocks: blocks.into_values(),
    }
}
