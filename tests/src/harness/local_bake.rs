//! A bake without server, queue or files.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{MANIFEST_OUTPUT, REPORT_OUTPUT};
use lightkiln_proto::kinds::Kinds;
use lightkiln_proto::manifest::Manifest;
use lightkiln_worker::kinds::{BakeKinds, Runner};
use lightkiln_worker::lightmap::World;
use lightkiln_worker::rays::RayCount;
use lightkiln_worker::task::{ArtefactSource, LocalRun, Progress};

/// Bytes of decoded values that tasks may share.
const MEMORY_BYTES: usize = 4 << 30;

/// A kind of bake and its settings.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Name of the kind.
    pub kind: &'static str,
    /// Settings as a request gives them.
    pub settings: serde_json::Value,
}

impl Recipe {
    /// The recipe with one setting more.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<serde_json::Value>) -> Self {
        self.settings[name] = value.into();
        self
    }
}

/// A finished bake with all its bytes.
#[derive(Debug)]
pub struct LocalBake {
    /// Manifest as decoded.
    pub manifest: Manifest,
    /// Manifest as written.
    pub manifest_bytes: Vec<u8>,
    /// Report.
    pub report: serde_json::Value,
    /// Digest of the scene's bundle.
    pub scene: Digest,
    /// Every artefact by digest, chunks among them.
    pub artefacts: BTreeMap<Digest, Arc<Vec<u8>>>,
    /// Rays cast.
    pub rays: RayCount,
    /// Seconds per task kind.
    pub secs: BTreeMap<String, f64>,
}

impl LocalBake {
    /// Bytes of a chunk.
    pub fn chunk(&self, digest: Digest) -> Result<Vec<u8>> {
        Ok(self.artefacts.get(&digest).context("no task gave the chunk")?.as_ref().clone())
    }
}

/// Bakes a scene bundle; also gives the world that it was baked in.
pub fn bake_in_world(bundle: Vec<u8>, recipe: &Recipe) -> Result<(LocalBake, Arc<World>)> {
    let progress = Progress::new();
    let mut run = LocalRun::new(MEMORY_BYTES, &progress);
    let scene = run.shelf.put(bundle);
    let plan = Kinds::new().first_tasks(recipe.kind, scene, &recipe.settings)?;
    let mut secs: BTreeMap<String, f64> = BTreeMap::new();
    let mut last = Instant::now();
    let ended = |task: &lightkiln_proto::jobs::TaskSpec| {
        *secs.entry(task.kind.clone()).or_default() += last.elapsed().as_secs_f64();
        last = Instant::now();
    };
    run.run(&Runner::new(&BakeKinds::new()), plan, |_| true, ended)?;
    let bytes_of = |name: &str| -> Result<Arc<Vec<u8>>> {
        Ok(run
            .shelf
            .get(run.outputs_named(name).next().with_context(|| format!("no task gave '{name}'"))?)?)
    };
    let manifest_bytes = bytes_of(MANIFEST_OUTPUT)?.as_ref().clone();
    let report = serde_json::from_slice(&bytes_of(REPORT_OUTPUT)?)?;
    let manifest = Manifest::from_json(&manifest_bytes)?;
    Kinds::new().check(&manifest)?;
    let world = World::of_run(&run)?;
    let bake = LocalBake {
        manifest,
        manifest_bytes,
        report,
        scene,
        rays: progress.rays(),
        secs,
        artefacts: run.shelf.into_artefacts(),
    };
    Ok((bake, world))
}

/// Bakes a scene bundle.
pub fn bake(bundle: Vec<u8>, recipe: &Recipe) -> Result<LocalBake> {
    Ok(bake_in_world(bundle, recipe)?.0)
}
