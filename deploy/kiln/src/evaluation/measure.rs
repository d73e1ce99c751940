//! The measurement itself: bundle and scene in, figures and everything that pictures need out.

use lightkiln_client::fetch::Source;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{ChunkRef, Manifest};
use lightkiln_worker::evaluate::{EvaluationError, Evaluator, LightResult, Options, cluster_errors};
use lightkiln_worker::reference::Precision;
use lightkiln_worker::task::Progress;

use super::arguments::EvaluationArguments;
use super::table::{Evaluation, LightRow, over_lights};
use crate::commands::submitting::PackedScene;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;

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
    source: &Source,
    scene: PackedScene,
    wanted: &EvaluationArguments,
    interrupt: &Interrupt,
) -> Result<Measured> {
    let own = wanted.own_lights()?;
    let name = scene.name.clone();
    let (_, manifest) = source.manifest()?;
    let progress = Progress::new();
    let precision = Precision { rel_error: wanted.rel_error, ..Precision::default() };
    let options = Options { receivers: wanted.receivers, precision, ..Options::default() };
    eprintln!("preparing the scene anew, and the rows of {} receivers", wanted.receivers);
    let bytes = |digest| chunk(source, &manifest, digest);
    let evaluator =
        Evaluator::new(&manifest, scene.into_bytes(), bytes, options, &progress).map_err(failure)?;
    let chosen = match own {
        Some(lights) => evaluator.usable(lights),
        None => {
            let chosen = evaluator.default_lights();
            evaluator.usable(chosen.lights).map(|mut usable| {
                usable.notes.splice(0..0, chosen.notes);
                usable
            })
        }
    };
    let chosen = chosen.map_err(failure)?;
    for note in &chosen.notes {
        eprintln!("note: {note}");
    }
    let mut results = Vec::new();
    for light in &chosen.lights {
        if interrupt.is_raised() {
            return Err(Failure::new(Exit::Interrupted, "the evaluation was interrupted"));
        }
        eprintln!("{}: {}", light.name, light.words);
        results.push(evaluator.measure(light, &progress).map_err(failure)?);
    }
    let evaluation = Evaluation {
        scene: name,
        rel_error: wanted.rel_error,
        ..summed_up(&manifest, &evaluator, &results, chosen.notes)
    };
    Ok(Measured { evaluator, results, evaluation })
}

fn summed_up(
    manifest: &Manifest,
    evaluator: &Evaluator,
    results: &[LightResult],
    mut notes: Vec<String>,
) -> Evaluation {
    let lights: Vec<LightRow> = results.iter().map(LightRow::of).collect();
    let unsettled = results.iter().filter(|result| !result.settled.converged);
    notes.extend(
        unsettled.map(|result| format!("under '{}' the bounces had not converged", result.light.name)),
    );
    let (figures, classes) = over_lights(&lights);
    let [cells_made_anew, clusters_made_anew] = evaluator.made_anew();
    let mut worst_clusters = cluster_errors(evaluator, results);
    worst_clusters.truncate(WORST);
    Evaluation {
        receivers: evaluator.sample().receivers.len(),
        figures,
        classes,
        lights,
        share_without_receiver: evaluator.sample().share_without,
        share_in_cavities: evaluator.sample().share_in_cavities,
        cells_made_anew,
        clusters_made_anew,
        clusters: manifest.clusters.len(),
        worst_clusters,
        notes,
        ..Evaluation::default()
    }
}

fn chunk(
    source: &Source,
    manifest: &Manifest,
    digest: Digest,
) -> std::result::Result<Vec<u8>, EvaluationError> {
    let clusters = manifest.clusters.iter().map(|cluster| (cluster.digest, cluster.bytes));
    let probes = manifest.probes.iter().chain(&manifest.patches).map(|batch| (batch.digest, batch.bytes));
    let bytes = clusters.chain(probes).find(|(known, _)| *known == digest).map_or(0, |(_, bytes)| bytes);
    source
        .chunk(&ChunkRef { digest, bytes })
        .map_err(|source| EvaluationError::Missing { digest, source: Box::new(source) })
}

fn failure(error: EvaluationError) -> Failure {
    let exit = match &error {
        EvaluationError::Cancelled(_) => Exit::Interrupted,
        _ => Exit::BadInput,
    };
    let mut failure = Failure::new(exit, error.to_string());
    if let Some(source) = std::error::Error::source(&error) {
        failure = failure.caused_by(source);
    }
    failure
}
