//! Summary of a finished bake: the object of `bake --json`, the figures for people, and the bundle's report.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use lightkiln_client::ClientError;
use lightkiln_client::fetch::{REPORT_FILE, write_atomically};
use lightkiln_client::lights::quoted;
use lightkiln_proto::api::Bake;
use lightkiln_proto::kinds::{Figures, Kinds, Warning};
use lightkiln_proto::manifest::{Manifest, ManifestError};
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::evaluation::{Evaluation, NotedScene};
use crate::failure::{Exit, Failure, Result};

/// The one JSON object at the end of `bake --json`: its keys are a contract.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Bake id on its server.
    pub bake: String,
    /// Scene as given.
    pub scene: String,
    /// Bundle written.
    pub out: String,
    /// Kind of bake.
    pub kind: &'static str,
    /// Figures of its kind.
    #[serde(flatten)]
    pub figures: Map<String, Value>,
    /// The same in lines for people.
    #[serde(skip)]
    figure_words: String,
    /// Tasks run for this bake.
    pub tasks_run: u64,
    /// Tasks whose result was there already.
    pub tasks_reused: u64,
    /// Closest-hit rays cast for this bake; those of reused tasks are not in it.
    pub rays_closest: u64,
    /// Occlusion rays cast for this bake.
    pub rays_occlusion: u64,
    /// Rays of either sort that looked for walls between hits and the receivers around them; in no other count.
    pub rays_linking: u64,
    /// Bytes of all chunks.
    pub bytes_total: u64,
    /// Seconds from the command's start to the written bundle.
    pub elapsed_secs: f64,
    /// Seconds from the first claim to the last commit of each stage.
    pub stages: BTreeMap<String, f64>,
    /// Warnings of the scene's import, and of a bake that came out worse than its settings ask for.
    pub warnings: Vec<Warning>,
    /// Bakes of the objects that move through it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub movers: Vec<MoverSummary>,
    /// The bake held against the path tracer, if that was wanted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evaluation: Option<Evaluation>,
}

impl Summary {
    /// Sums a finished bake up.
    ///
    /// Errors when the manifest's kind is not in the table.
    pub fn new(
        kinds: &Kinds,
        bake: &Bake,
        manifest: &Manifest,
        scene: &str,
        out: &Path,
        elapsed: Duration,
    ) -> std::result::Result<Self, ManifestError> {
        let kind = kinds.check(manifest)?;
        let Figures { json: figures, words: figure_words } = kind.summary(manifest)?;
        let counter = |name: &str| bake.counters.get(name).map_or(0, |value| *value as u64);
        let stages = bake.stages.iter();
        Ok(Self {
            bake: bake.id.clone(),
            scene: scene.to_owned(),
            out: out.display().to_string(),
            kind: kind.name(),
            figures,
            figure_words,
            tasks_run: bake.tasks_run,
            tasks_reused: bake.tasks_reused,
            rays_closest: counter("rays_closest"),
            rays_occlusion: counter("rays_occlusion"),
            rays_linking: counter("rays_linking"),
            bytes_total: manifest.bytes(),
            elapsed_secs: elapsed.as_secs_f64(),
            stages: stages.map(|stage| (stage_name(&stage.kind), stage.elapsed_ms as f64 / 1e3)).collect(),
            warnings: kind.warnings(manifest)?,
            movers: Vec::new(),
            evaluation: None,
        })
    }

    /// A few lines for people.
    pub fn words(&self) -> String {
        let mut words = format!("{}{} bytes in all\n", self.figure_words, self.bytes_total);
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

/// A mover's bake in the object of `bake --json`: its keys are a contract.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MoverSummary {
    /// Name of the node.
    pub node: String,
    /// Bake id on its server.
    pub bake: String,
    /// Bundle written.
    pub out: String,
    /// Words of `--object` that put it where the scene has it.
    pub object: String,
    /// Tasks run for this bake.
    pub tasks_run: u64,
    /// Tasks whose result was there already.
    pub tasks_reused: u64,
    /// Bytes of all chunks.
    pub bytes_total: u64,
}

impl MoverSummary {
    /// That of a node's finished bake, which words of `--object` put where the scene has it.
    pub fn of(node: &str, object: String, done: &Summary) -> Self {
        Self {
            node: node.to_owned(),
            bake: done.bake.clone(),
            out: done.out.clone(),
            object,
            tasks_run: done.tasks_run,
            tasks_reused: done.tasks_reused,
            bytes_total: done.bytes_total,
        }
    }

    /// A line for people.
    pub fn words(&self) -> String {
        let Self { node, object, tasks_run, tasks_reused, bytes_total, .. } = self;
        let done = match (tasks_run, tasks_reused) {
            (0, all) => format!("all {all} tasks were done before"),
            (run, 0) => format!("{run} tasks run"),
            (run, reused) => format!("{run} tasks run, {reused} were done before"),
        };
        format!("mover {node}: {bytes_total} bytes, {done}\n  --object {}\n", quoted(object))
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

/// Adds to `report.json` where the bundle's scene is, and this run's summary as it is now.
pub fn complete_report(out: &Path, scene: &NotedScene, summary: &Summary) -> Result<()> {
    let path = out.join(REPORT_FILE);
    let bytes = fs::read(&path).map_err(|error| {
        Failure::new(Exit::Failed, format!("cannot read {}", path.display())).caused_by(&error)
    })?;
    let place = path.display().to_string();
    let mut whole: Value =
        serde_json::from_slice(&bytes).map_err(|source| ClientError::Json { place, source })?;
    for (name, way) in json!(scene).as_object().into_iter().flatten() {
        whole[name.as_str()] = way.clone();
    }
    whole["run"] = json!(summary);
    Ok(write_atomically(&path, format!("{whole:#}\n").as_bytes())?)
}

/// Warnings of the scene's import, from a bake's report.
pub fn import_warnings(report: &Value) -> Vec<Warning> {
    let warnings = report["import"]["warnings"].as_array().cloned().unwrap_or_default();
    let read = |warning: Value| {
        serde_json::from_value(warning.clone()).unwrap_or_else(|_| Warning {
            code: "import".into(),
            message: warning.to_string(),
            try_setting: None,
        })
    };
    warnings.into_iter().map(read).collect()
}
