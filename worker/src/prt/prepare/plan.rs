//! The plan: a relight task per batch of probes, a transport task per cluster cell, and assemble.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::prt::{BasisKind, TaskKind};
use serde_json::json;

use super::Params;
use super::drawing::Drawn;
use crate::prt::runner::Context;
use crate::prt::stage::Stage;
use crate::task::TaskError;

/// Probes in a relight task at most.
const RELIGHT_BATCH: usize = 64;
/// Rays in a relight task at most: a chunk names blocks by 16 bits, and each ray may meet another one.
const RELIGHT_RAYS: usize = 1 << 16;

/// Rays of a probe that lights nothing.
const VANTAGE_RAYS: u32 = 128;

/// All tasks that follow prepare.
pub fn tasks(
    stage: &Stage,
    stage_digest: Digest,
    context: &Context,
    params: &Params,
    drawn: &Drawn,
    patches: Option<&[u8]>,
) -> Result<Vec<TaskSpec>, TaskError> {
    let settings = &params.settings;
    let shared = || {
        vec![
            TaskInput::Artefact { name: "scene".into(), digest: stage.scene },
            TaskInput::Artefact { name: "stage".into(), digest: stage_digest },
        ]
    };
    let mut plan = Vec::new();
    let relight_rays = match settings.basis {
        BasisKind::Sh => settings.relight_rays,
        BasisKind::Patches => VANTAGE_RAYS,
    };
    let batch_probes = (RELIGHT_RAYS / relight_rays as usize).clamp(1, RELIGHT_BATCH);
    for (batch, first) in (0..stage.probes.len()).step_by(batch_probes).enumerate() {
        let count = batch_probes.min(stage.probes.len() - first);
        let task_params = json!({ "first": first, "count": count, "relight_rays": relight_rays });
        let cost = count as u64 * u64::from(relight_rays) / 1000;
        plan.push(TaskKind::Relight.task(format!("probes {batch}"), task_params, shared(), cost));
    }
    for (index, cell) in stage.clusters.iter().enumerate() {
        let task_params = json!({ "cluster": index, "settings": settings });
        let rays = cell.receivers.len() as u64 * u64::from(settings.transport_rays);
        let rays_per_ray = match settings.basis {
            BasisKind::Sh => u64::from(settings.n_overlaps),
            BasisKind::Patches => 2,
        };
        let cost = rays * rays_per_ray / 1000;
        plan.push(TaskKind::Transport.task(format!("cluster {index}"), task_params, shared(), cost));
    }
    let mut inputs = shared();
    inputs.push(TaskInput::Artefact { name: "warnings".into(), digest: context.digest("import/warnings")? });
    inputs.extend(drawn.inputs());
    inputs.extend(
        patches.map(|chunk| TaskInput::Artefact { name: "patches/0".into(), digest: Digest::of(chunk) }),
    );
    for task in &plan {
        inputs.push(TaskInput::Task { name: task.label.replace(' ', "/"), key: task.key });
    }
    plan.push(TaskKind::Assemble.task(
        "bundle",
        json!({ "settings": settings, "scene": params.scene }),
        inputs,
        1,
    ));
    Ok(plan)
}
