//! Bakes and evaluates through the built `kiln`, as a user would.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use super::{Axis, BASE, EVALUATION, Study};

/// The program, and a folder to work in.
#[derive(Debug)]
pub struct Kiln {
    program: PathBuf,
    folder: tempfile::TempDir,
}

/// One bake of a study.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Scene and line.
    pub line: String,
    /// Value of the setting that is varied.
    pub value: &'static str,
    /// Last line of `kiln bake --json`.
    pub bake: Value,
    /// Last line of `kiln evaluate --json`.
    pub evaluation: Value,
}

impl Kiln {
    /// Errs where there is no program.
    pub fn new(program: &Path) -> Result<Self> {
        ensure!(program.is_file(), "no kiln at {}: build it with cargo build --release", program.display());
        Ok(Self { program: program.to_owned(), folder: tempfile::tempdir().context("create a folder")? })
    }

    /// Runs a study, telling of each bake as it is done.
    pub fn run(&self, study: &Study, mut done: impl FnMut(&Measured)) -> Result<Vec<Measured>> {
        let mut all = Vec::new();
        for scene in study.scenes {
            for (label, settings) in study.lines {
                for value in study.values {
                    let line = format!("{scene}{}{label}", if label.is_empty() { "" } else { ", " });
                    let varied = format!("{}={value}", study.varied);
                    let settings: Vec<&str> =
                        [BASE, study.fixed, settings].concat().into_iter().chain([&varied[..]]).collect();
                    let (bake, evaluation) =
                        self.measure(scene, &settings).with_context(|| format!("{line}, {varied}"))?;
                    let measured = Measured { line, value, bake, evaluation };
                    done(&measured);
                    all.push(measured);
                }
            }
        }
        Ok(all)
    }

    fn measure(&self, scene: &str, settings: &[&str]) -> Result<(Value, Value)> {
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(scene).with_extension("glb");
        let [bundle, state] = ["study.kiln", "state"].map(|name| self.folder.path().join(name));
        if state.exists() {
            std::fs::remove_dir_all(&state).context("clear the state folder")?;
        }
        let mut bake = Command::new(&self.program);
        bake.arg("bake").arg(&scene).arg("--out").arg(&bundle).arg("--state").arg(&state).arg("--json");
        for setting in settings {
            match setting.strip_prefix("kind=") {
                Some(kind) => bake.args(["--kind", kind]),
                None => bake.args(["--set", setting]),
            };
        }
        let mut evaluate = Command::new(&self.program);
        evaluate.arg("evaluate").arg(&bundle).arg("--scene").arg(&scene).args(EVALUATION);
        Ok((last_json(bake)?, last_json(evaluate)?))
    }
}

/// Runs to the end and reads the JSON object that standard output ends with.
fn last_json(mut command: Command) -> Result<Value> {
    let output = command.output().context("start kiln")?;
    ensure!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).context("read kiln's output")?;
    serde_json::from_str(&text).with_context(|| format!("{command:?} printed no JSON object"))
}

impl Measured {
    fn number(of: &Value, key: &str) -> f64 {
        of[key].as_f64().unwrap_or(f64::NAN)
    }

    /// A figure of the bake.
    pub fn baked(&self, key: &str) -> f64 {
        Self::number(&self.bake, key)
    }

    /// A figure of the evaluation.
    pub fn evaluated(&self, key: &str) -> f64 {
        Self::number(&self.evaluation, key)
    }

    /// Error of a class.
    pub fn class(&self, key: &str) -> f64 {
        Self::number(&self.evaluation["classes"], key)
    }

    /// Place on a horizontal axis.
    pub fn along(&self, axis: Axis) -> f64 {
        match axis {
            Axis::Probes => self.baked("probes"),
            Axis::Receivers => self.baked("receivers"),
            Axis::Bytes => self.baked("bytes_per_receiver"),
            Axis::Megarays => {
                let kinds = ["rays_closest", "rays_occlusion", "rays_linking"];
                kinds.map(|kind| self.baked(kind)).iter().sum::<f64>() * 1e-6
            }
            Axis::Value => self.value.parse().unwrap_or(f64::NAN),
        }
    }
}
