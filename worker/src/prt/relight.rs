//! Relight task: what each relight ray of a batch of probes meets (METHOD.md §2 "Relight").

use std::collections::BTreeMap;

use glam::Vec3;
use lightkiln_proto::chunk::encode_probe_batch;
use lightkiln_proto::prt::{Probe, ProbeBatch, RelightHit};
use lightkiln_proto::sh::relight_direction;
use rayon::prelude::*;
use serde::Deserialize;

use super::runner::Context;
use super::world::{Surface, World};
use crate::task::{TaskError, TaskOutput};

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// First probe of the stage.
    first: usize,
    /// How many.
    count: usize,
    /// K.
    relight_rays: u32,
}

/// Runs the task: inputs `scene`, `stage`; output `chunk`.
pub fn run(context: &Context, params: &Params) -> Result<TaskOutput, TaskError> {
    let world = context.world()?;
    let probes = params
        .first
        .checked_add(params.count)
        .and_then(|end| world.stage.probes.get(params.first..end))
        .ok_or_else(|| TaskError::bad_input("the task names probes that the stage does not have"))?;
    if !params.relight_rays.is_power_of_two() {
        return Err(TaskError::bad_input("relight_rays is not a power of two"));
    }
    context.progress.begin(0.0, 1.0, probes.len() as u64);
    let met: Vec<Vec<Option<Surface>>> = probes
        .par_iter()
        .map(|probe| {
            context.progress.check()?;
            let hits = hits_of(&world, probe, params.relight_rays);
            context.progress.add_rays_closest(u64::from(params.relight_rays));
            context.progress.add_rays_occlusion(u64::from(params.relight_rays));
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
            let hit = world.geometry.tracer.closest(position_m, direction, f32::INFINITY)?;
            Some(world.linked_surface_at(&hit, position_m + direction * hit.t))
        })
        .collect()
}

/// Names receivers by block and texel.
fn batch_of(world: &World, probes: &[Probe], relight_rays: u32, met: &[Vec<Option<Surface>>]) -> ProbeBatch {
    let block_of = |receiver: u32| world.stage.receivers[receiver as usize].block;
    let mut blocks: BTreeMap<u64, u16> = BTreeMap::new();
    for surface in met.iter().flatten().flatten() {
        if let Surface::Receiver(receiver) = surface {
            blocks.insert(world.stage.blocks[block_of(*receiver) as usize].key, 0);
        }
    }
    for (index, slot) in blocks.values_mut().enumerate() {
        *slot = index as u16;
    }
    let name = |surface: &Option<Surface>| match surface {
        None => RelightHit::Sky,
        Some(Surface::Dark) => RelightHit::Dark,
        Some(Surface::Receiver(receiver)) => RelightHit::Receiver {
            block: blocks[&world.stage.blocks[block_of(*receiver) as usize].key],
            texel: world.stage.receivers[*receiver as usize].texel,
        },
    };
    ProbeBatch {
        probes: probes.to_vec(),
        relight_rays,
        hits: met.iter().flatten().map(name).collect(),
        blocks: blocks.into_keys().collect(),
    }
}
