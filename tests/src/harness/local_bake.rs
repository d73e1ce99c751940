//! A bake without server, queue or files.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use lightkiln_client::fetch::{CHUNKS_FOLDER, MANIFEST_FILE, chunk_path};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{MANIFEST_OUTPUT, REPORT_OUTPUT};
use lightkiln_proto::kinds::Kinds;
use lightkiln_proto::manifest::{ChunkRef, DIRECTORY, Manifest};
use lightkiln_worker::kinds::{BakeKinds, Runner};
use lightkiln_worker::lightmap::World;
use lightkiln_worker::rays::RayCount;
use lightkiln_worker::task::{ArtefactSource, LocalRun, Progress, TaskRunner};

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
    /// Writes the bake as a bundle into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        fs::create_dir_all(folder.join(CHUNKS_FOLDER))?;
        fs::write(folder.join(MANIFEST_FILE), &self.manifest_bytes)?;
        for chunk in self.manifest.chunks.values().flatten() {
            fs::write(chunk_path(folder, chunk.digest), self.chunk(chunk.digest)?)?;
        }
        Ok(())
    }

    /// Bytes of a chunk.
    pub fn chunk(&self, digest: Digest) -> Result<Vec<u8>> {
        Ok(self.artefacts.get(&digest).context("no task gave the chunk")?.as_ref().clone())
    }
}

/// Bakes one scene after the other, and keeps all results.
#[derive(Debug)]
pub struct Bakery<'p> {
    run: LocalRun<'p>,
    recipe: Recipe,
}

/// A bake after others.
#[derive(Clone, Debug)]
pub struct Rebaked {
    /// Manifest as written: it names all chunks by their digests.
    pub manifest_bytes: Vec<u8>,
    /// Label of each task that had to be looked at, and how it came by its result.
    pub notes: Vec<(String, String)>,
    /// Rays cast for it.
    pub rays: u64,
}

impl<'p> Bakery<'p> {
    /// Nothing baked yet.
    pub fn new(recipe: &Recipe, progress: &'p Progress) -> Self {
        Self { run: LocalRun::new(MEMORY_BYTES, progress), recipe: recipe.clone() }
    }

    /// Bakes a scene bundle, with the results of those before at hand.
    pub fn bake(&mut self, bundle: Vec<u8>) -> Result<Rebaked> {
        self.bake_by(&Runner::new(&BakeKinds::new()), bundle)
    }

    /// As [`Bakery::bake`], with tasks run by that runner.
    pub fn bake_by(&mut self, runner: &dyn TaskRunner, bundle: Vec<u8>) -> Result<Rebaked> {
        let (before, told) = (self.run.progress.rays().total(), self.run.notes.len());
        let scene = self.run.shelf.put(bundle);
        let plan = Kinds::new().first_tasks(self.recipe.kind, scene, &self.recipe.settings)?;
        self.run.run(runner, plan, |_| true, |_| ())?;
        let manifest = self.run.outputs_named(MANIFEST_OUTPUT).next().context("no task gave a manifest")?;
        Ok(Rebaked {
            manifest_bytes: self.run.shelf.get(manifest)?.as_ref().clone(),
            notes: self.run.notes[told..].iter().filter(|(_, note)| !note.is_empty()).cloned().collect(),
            rays: self.run.progress.rays().total() - before,
        })
    }
}

/// Bakes a scene bundle; also gives the world that it was baked in.
pub fn bake_in_world(bundle: Vec<u8>, recipe: &Recipe) -> Result<(LocalBake, Arc<World>)> {
    baked(bundle, recipe, |run| Ok(World::of_run(run)?))
}

/// Bakes a scene bundle; also gives what `of_run` finds among all outputs.
fn baked<T>(
    bundle: Vec<u8>,
    recipe: &Recipe,
    of_run: impl FnOnce(&LocalRun<'_>) -> Result<T>,
) -> Result<(LocalBake, T)> {
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
    let page = |chunk: &ChunkRef| Ok(run.shelf.get(chunk.digest)?.as_ref().clone());
    let pages: Vec<Vec<u8>> = manifest.chunks(DIRECTORY).iter().map(page).collect::<Result<_>>()?;
    let manifest = manifest.with_directory(&pages)?;
    Kinds::new().check(&manifest)?;
    let found = of_run(&run)?;
    let bake = LocalBake {
        manifest,
        manifest_bytes,
        report,
        scene,
        rays: progress.rays(),
        secs,
        artefacts: run.shelf.into_artefacts(),
    };
    Ok((bake, found))
}

/// Bakes a scene bundle.
pub fn bake(bundle: Vec<u8>, recipe: &Recipe) -> Result<LocalBake> {
    Ok(baked(bundle, recipe, |_| Ok(()))?.0)
}
