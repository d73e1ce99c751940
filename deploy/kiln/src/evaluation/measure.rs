//! The measurement itself: bundle and scene in, figures and everything that pictures need out.

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{ChunkRef, Manifest};
use lightkiln_worker::evaluate::{
    Chosen, EvaluationError, Evaluator, LightResult, Options, TestLight, cluster_errors, default_lights,
    panorama_light, usable_lights,
};
use lightkiln_worker::geometry::Geometry;
use lightkiln_worker::reference::Precision;
use lightkiln_worker::task::Progress;

use super::arguments::{EvaluationArguments, Where, not_relightable, without_space, without_voxels};
use super::shadows::ClientBake;
use super::table::{Evaluation, LightRow, over_lights};
use crate::console::say;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::submission::PackedScene;

/// Worst clusters that are named.
const WORST: usize = 12;

/// A finished measurement.
pub struct Measured {
    /// The bake and its world.
    pub evaluator: Evaluator,
    /// Light by light.
    pub results: Vec<LightResult>,
    /// All figures.
    pub evaluation: Evaluation,
}

/// Measures a bundle against its scene. Says on standard error what it does.
pub fn measure(
    kinds: &KindTables,
    source: &Source,
    scene: PackedScene,
    (wanted, lighting): (&EvaluationArguments, &LightArguments),
    interrupt: &Interrupt,
) -> Result<Measured> {
    let own = wanted.own_lights()?;
    let panorama = lighting.panorama()?.map(panorama_light);
    let name = scene.name.clone();
    let (_, manifest) = source.manifest()?;
    kinds
        .contract
        .check(&manifest)
        .map_err(|error| Failure::bad_input("the bundle cannot be read").caused_by(&error))?;
    wanted.check_place(&kinds.worker, &manifest.kind)?;
    let progress = Progress::new();
    say!("preparing the scene anew, and what {} places need", wanted.receivers);
    let bytes = |digest| chunk(source, &manifest, digest);
    let bake = kinds.worker.evaluated(&manifest, scene.into_bytes(), &bytes, &progress).map_err(failure)?;
    let bake = match wanted.place {
        Where::Surfaces => bake,
        Where::Space => bake.in_space().ok_or_else(|| without_space(&manifest.kind))?,
        Where::Walks => bake.by_walks().ok_or_else(without_voxels)?,
    };
    // Pixels are read through a lightmap.
    let pixels = if bake.lightmap().is_some() { wanted.pixels() } else { 0 };
    let precision = Precision { rel_error: wanted.rel_error, ..Precision::default() };
    let options = Options { receivers: wanted.receivers, precision, pixels, ..Options::default() };
    let chosen = match (bake.own_light(), own) {
        (Some(_), Some(_)) => return Err(not_relightable(&manifest.kind)),
        (Some(light), None) => {
            let lights = lighting.rest_of_tests(vec![light.clone()]);
            if panorama.is_some() || lights != [light] {
                return Err(not_relightable(&manifest.kind));
            }
            Chosen { lights, notes: Vec::new() }
        }
        (None, own) => lights_to_measure(bake.geometry(), own, panorama, lighting)?,
    };
    for note in &chosen.notes {
        say!("note: {note}");
    }
    let mut evaluator = Evaluator::new(bake, &chosen.lights, options, &progress).map_err(failure)?;
    if pixels > 0 {
        let client = LoadedBake::load(source, &kinds.client)?;
        evaluator = evaluator.with_client(Box::new(ClientBake(client)));
    }
    let mut results = Vec::new();
    for light in &chosen.lights {
        if interrupt.is_raised() {
            return Err(Failure::new(Exit::Interrupted, "the evaluation was interrupted"));
        }
        say!("{}: {}", light.name, light.words);
        results.push(evaluator.measure(light, &progress).map_err(failure)?);
    }
    if !results.iter().any(|result| result.counts) {
        let names: Vec<String> = results.iter().map(|result| format!("'{}'", result.light.name)).collect();
        let what = format!("{} reaches no surface of the scene, or too few of the places", names.join(", "));
        return Err(Failure::bad_input(what).try_this("move it, turn it, or raise --receivers"));
    }
    let told = chosen.notes.len();
    let evaluation = Evaluation {
        scene: name,
        rel_error: wanted.rel_error,
        ..summed_up(&manifest, &evaluator, &results, chosen.notes)
    };
    for note in &evaluation.notes[told..] {
        say!("note: {note}");
    }
    Ok(Measured { evaluator, results, evaluation })
}

/// Lights to measure with: `own`, or some that are chosen from the scene, and a panorama; without those that are left out or cannot be.
pub fn lights_to_measure(
    geometry: &Geometry,
    own: Option<Vec<TestLight>>,
    panorama: Option<TestLight>,
    lighting: &LightArguments,
) -> Result<Chosen> {
    let Chosen { mut lights, notes } = match own {
        Some(lights) => Chosen { lights, notes: Vec::new() },
        None => default_lights(geometry),
    };
    lights.extend(panorama);
    let mut usable = usable_lights(geometry, lighting.rest_of_tests(lights)).map_err(failure)?;
    usable.notes.splice(0..0, notes);
    Ok(usable)
}

fn summed_up(
    manifest: &Manifest,
    evaluator: &Evaluator,
    results: &[LightResult],
    mut notes: Vec<String>,
) -> Evaluation {
    let lights: Vec<LightRow> = results.iter().map(LightRow::of).collect();
    let unsettled = results.iter().filter(|result| !result.converged);
    notes.extend(
        unsettled.map(|result| format!("under '{}' the bounces had not converged", result.light.name)),
    );
    let dim = results.iter().filter(|result| !result.counts);
    notes.extend(dim.map(|result| {
        let name = &result.light.name;
        format!("'{name}' reaches too few of the places to be measured by them: 'all' is without it; raise --receivers")
    }));
    notes.extend(evaluator.bake().notes(&evaluator.sample().bare()));
    let (figures, classes, pixels) = over_lights(&lights);
    let [units_made_anew, chunks_made_anew] = evaluator.bake().traced();
    let mut worst_clusters = cluster_errors(evaluator, results);
    worst_clusters.truncate(WORST);
    Evaluation {
        receivers: evaluator.sample().places.len(),
        figures,
        classes,
        pixels_measured: evaluator.pixels().measured.len(),
        pixels,
        lights,
        share_without_receiver: evaluator.sample().share_without,
        share_in_cavities: evaluator.sample().share_in_cavities,
        units_made_anew,
        chunks_made_anew,
        chunks: light_chunks(manifest),
        worst_clusters,
        notes,
        ..Evaluation::default()
    }
}

/// Chunks that relighting needs.
fn light_chunks(manifest: &Manifest) -> usize {
    let of_light = manifest.chunks.iter().filter(|(role, _)| Manifest::is_light(role));
    of_light.map(|(_, chunks)| chunks.len()).sum()
}

fn chunk(
    source: &Source,
    manifest: &Manifest,
    digest: Digest,
) -> std::result::Result<Vec<u8>, EvaluationError> {
    let known = manifest.chunks.values().flatten().find(|chunk| chunk.digest == digest);
    let bytes = known.map_or(0, |chunk| chunk.bytes);
    source
        .chunk(&ChunkRef { digest, bytes })
        .map_err(|source| EvaluationError::Missing { digest, source: Box::new(source) })
}

fn failure(error: EvaluationError) -> Failure {
    let exit = match &error {
        EvaluationError::Cancelled(_) => Exit::Interrupted,
        _ => Exit::BadInput,
    };
    Failure::of(exit, &error)
}
