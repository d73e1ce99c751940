//! Task `sh.plan`: probes, cluster cells, a relight task for each batch of probes, a transport task for each cell, and
//! assemble.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::kinds::sh::tasks;
use serde_json::json;

use super::{BakeParams, PROBES_ARTEFACT, ProbeSet, TransportParams, coverage, probes, relight};
use crate::factors::{CELLS_ARTEFACT, cells, encoded_cells};
use crate::lightmap::World;
use crate::task::{Context, TaskError, TaskOutput, params, results_of};

/// Probes in a relight task at most.
const RELIGHT_BATCH: usize = 64;
/// Rays in a relight task at most: a chunk names blocks by 16 bits, and each ray may meet another one.
const RELIGHT_RAYS: usize = 1 << 16;

/// Runs the task: inputs are the outputs of the scene tasks; outputs `cells`, `probes`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let bake: BakeParams = params(task)?;
    let settings = &bake.settings;
    let world = World::of(context)?;
    let spacing_m = probes::spacing_m(&world, &settings.probes);
    let placed = probes::place(&world, &settings.probes, spacing_m, context.progress)?;
    let by_density = placed.len();
    let probes = coverage::complete(&world, &settings.probes, spacing_m, placed, context.progress)?;
    let cells = cells(&world.lightmap.positions_m(), settings.factors.cluster_receivers);
    let artefacts = vec![
        (CELLS_ARTEFACT.to_owned(), encoded_cells(&cells)?),
        (PROBES_ARTEFACT.to_owned(), ProbeSet { spacing_m, probes: probes.clone() }.encoded()?),
    ];
    let own = |which: usize| {
        let (name, bytes): &(String, Vec<u8>) = &artefacts[which];
        TaskInput::Artefact { name: name.clone(), digest: Digest::of(bytes) }
    };
    let of_world = || {
        context.as_inputs(|name| ["import/scene", "unwrap/", "place/"].iter().any(|it| name.starts_with(it)))
    };

    let mut plan = Vec::new();
    let relight_rays = settings.probes.relight_rays;
    let batch_probes = (RELIGHT_RAYS / relight_rays as usize).clamp(1, RELIGHT_BATCH);
    for (batch, first) in (0..probes.len()).step_by(batch_probes).enumerate() {
        let count = batch_probes.min(probes.len() - first);
        let of_batch = json!(relight::Params { first, count, relight_rays });
        let inputs = [of_world(), vec![own(1)]].concat();
        let cost = count as u64 * u64::from(relight_rays) / 1000;
        plan.push(tasks::RELIGHT.task(format!("probes {batch}"), of_batch, inputs, cost));
    }
    for (cluster, cell) in cells.iter().enumerate() {
        let rays = cell.receivers.len() as u64 * u64::from(settings.transport.transport_rays);
        let of_cell = json!(TransportParams { cluster, settings: settings.into() });
        let inputs = [of_world(), vec![own(0), own(1)]].concat();
        let cost = rays * u64::from(settings.probes.n_overlaps) / 1000;
        plan.push(tasks::TRANSPORT.task(format!("cluster {cluster}"), of_cell, inputs, cost));
    }
    let inputs = [context.as_inputs(|_| true), vec![own(1)], results_of(&plan)].concat();
    plan.push(tasks::ASSEMBLE.task("bundle", json!(bake), inputs, 1));
    let counters = [("probes_by_density", by_density), ("probes_total", probes.len())];
    let counters = counters.map(|(name, count)| (name.to_owned(), count as f64)).into();
    Ok(TaskOutput { artefacts, plan, counters, ..TaskOutput::default() })
}
