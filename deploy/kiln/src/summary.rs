//! What a finished bake was: the object of `bake --json`, the figures for people, and the bundle's report.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use lightkiln_client::ClientError;
use lightkiln_client::fetch::write_atomically;
use lightkiln_proto::api::Bake;
use lightkiln_proto::manifest::Manifest;
use serde::Serialize;
use serde_json::{Value, json};

use crate::evaluation::Evaluation;
use crate::failure::{Exit, Failure, Result};

/// Name of the report in a bundle; the only file in it that is not a pure function of scene and settings.
pub const REPORT_FILE: &str = "report.json";

/// The one JSON object at the end of `bake --json`: its keys are a contract.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Bake id on its server.
    pub bake: String,
    /// Scene as given.
    pub scene: String,
    /// Bundle written.
    pub out: String,
    /// Receivers.
    pub receivers: u64,
    /// Probes.
    pub probes: u64,
    /// Surface patches; 0 unless the basis is patches.
    pub patches: u64,
    /// Clusters.
    pub clusters: u64,
    /// Tasks run for this bake.
    pub tasks_run: u64,
    /// Tasks whose result was there already.
    pub tasks_reused: u64,
    /// Mean rank, weighted by receivers.
    pub mean_rank: f64,
    /// Highest rank.
    pub rank_max: u32,
    /// Closest-hit rays cast for this bake; those of reused tasks are not in it.
    pub rays_closest: u64,
    /// Occlusion rays cast for this bake.
    pub rays_occlusion: u64,
    /// Share of transported energy that no probe sees.
    pub uncovered_fraction: f64,
    /// Bytes of all chunks.
    pub bytes_total: u64,
    /// Bytes of the chunks that relighting needs (probes and clusters), by receiver.
    pub bytes_per_receiver: f64,
    /// Seconds from the command's start to the written bundle.
    pub elapsed_secs: f64,
    /// Seconds from the first claim to the last commit of each stage.
    pub stages: BTreeMap<String, f64>,
    /// The bake held against the path tracer, if that was wanted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evaluation: Option<Evaluation>,
}

impl Summary {
    /// Sums a finished bake up.
    pub fn new(bake: &Bake, manifest: &Manifest, scene: &str, out: &Path, elapsed: Duration) -> Self {
        let totals = &manifest.totals;
        let counter = |name: &str| bake.counters.get(name).map_or(0, |value| *value as u64);
        let stages = bake.stages.iter();
        Self {
            bake: bake.id.clone(),
            scene: scene.to_owned(),
            out: out.display().to_string(),
            receivers: totals.receivers,
            probes: totals.probes,
            patches: totals.patches,
            clusters: totals.clusters,
            tasks_run: bake.tasks_run,
            tasks_reused: bake.tasks_reused,
            mean_rank: totals.mean_rank,
            rank_max: totals.rank_max,
            rays_closest: counter("rays_closest"),
            rays_occlusion: counter("rays_occlusion"),
            uncovered_fraction: totals.uncovered_fraction,
            bytes_total: totals.bytes,
            bytes_per_receiver: totals.bytes_light as f64 / totals.receivers.max(1) as f64,
            elapsed_secs: elapsed.as_secs_f64(),
            stages: stages.map(|stage| (stage_name(&stage.kind), stage.elapsed_ms as f64 / 1e3)).collect(),
            evaluation: None,
        }
    }

    /// A few lines for people.
    pub fn words(&self) -> String {
        let carriers = match self.patches {
            0 => format!("{} probes", self.probes),
            patches => format!("{patches} patches"),
        };
        let mut words = format!(
            "{} receivers, {}, {} clusters (mean rank {:.1}, highest {})\n\
             {} bytes, {:.0} a receiver for light; {:.2} % of the light reaches no probe\n",
            self.receivers,
            carriers,
            self.clusters,
            self.mean_rank,
            self.rank_max,
            self.bytes_total,
            self.bytes_per_receiver,
            100.0 * self.uncovered_fraction,
        );
        let total = self.tasks_run + self.tasks_reused;
        words += &match (self.tasks_run, self.tasks_reused) {
            (0, _) => format!("nothing to do: all {total} tasks were done before\n"),
            (run, 0) => format!("{run} tasks run in {:.1} s\n", self.elapsed_secs),
            (run, reused) => {
                format!("{run} tasks run in {:.1} s, {reused} were done before\n", self.elapsed_secs)
            }
        };
        words
    }
}

/// A task kind as people read it: without the kind of bake.
pub fn stage_name(kind: &str) -> String {
    kind.rsplit('.').next().unwrap_or(kind).to_owned()
}

/// Writes `report.json`: the bake's own report (warnings, figures), and this run's summary.
pub fn write_report(out: &Path, report: &Value, summary: &Summary) -> Result<()> {
    let whole = json!({ "bake": report, "run": summary });
    Ok(write_atomically(&out.join(REPORT_FILE), format!("{whole:#}\n").as_bytes())?)
}

/// Adds to `report.json` the way from the bundle to its scene, and this run's summary as it is now.
pub fn complete_report(out: &Path, scene_path: Option<String>, summary: &Summary) -> Result<()> {
    let path = out.join(REPORT_FILE);
    let bytes = fs::read(&path).map_err(|error| {
        Failure::new(Exit::Failed, format!("cannot read {}", path.display())).caused_by(&error)
    })?;
    let place = path.display().to_string();
    let mut whole: Value =
        serde_json::from_slice(&bytes).map_err(|source| ClientError::Json { place, source })?;
    whole["scene_path"] = json!(scene_path);
    whole["run"] = json!(summary);
    Ok(write_atomically(&path, format!("{whole:#}\n").as_bytes())?)
}

/// What the import of the scene could not honour, from a bake's report, as lines.
pub fn warnings(report: &Value) -> Vec<String> {
    let warnings = report["import"]["warnings"].as_array().cloned().unwrap_or_default();
    let line = |warning: Value| match (warning["code"].as_str(), warning["message"].as_str()) {
        (Some(code), Some(message)) => format!("{code}: {message}"),
        _ => warning.to_string(),
    };
    warnings.into_iter().map(line).collect()
}
