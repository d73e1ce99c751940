//! Task `prt.transport`: a cell's rays, rows and factors; or those of a task alike whose record still holds, or its rows as far as
//! they do.

use lightkiln_proto::chunk::QuantisationSettings;
use lightkiln_proto::jobs::{Artefact, TaskSpec};

use super::colourless::{self, Colourless};
use super::rows::{Gathered, KeptRows, ROWS_ARTEFACT};
use super::truncate::NamedPiece;
use super::{PatchTransport, Recorded, TracedSettings, TransportParams};
use crate::emitters::Radiance;
use crate::factors::{CellIndex, Piece, cell_of_task, encoded};
use crate::reads::{Changes, RECORD_ARTEFACT, Record, Stage};
use crate::task::{Context, FetchError, TaskError, TaskOutput, params};

/// Error of quantisation as a share of that of truncation: numbers of few bits cost less than ranks, whose loss shows as steps between
/// clusters.
const QUANTISATION_SHARE: f32 = 1.1;
/// Least and most error of quantisation.
const QUANTISATION_ERROR: [f32; 2] = [2e-4, 0.05];

/// Runs the task: inputs of [`PatchTransport::of`], `cells` and `stage`; outputs `cluster/N`, `index`, `record` and `rows`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let TransportParams { cluster, settings } = params(task)?;
    let cell = cell_of_task(context, cluster)?;
    let receivers = cell.receivers.len();
    let stage = Stage::of(context)?;
    // Take the result of a task alike, if all that it read is as it was.
    let (mut changed, mut before) = (None, Vec::new());
    for outputs in context.alike {
        let Some(record) = of_before(context, outputs, RECORD_ARTEFACT, Record::decoded)? else { continue };
        let changes = record.changes(&stage);
        if changes.any {
            changed.get_or_insert(changes);
            before.push((outputs, record));
        } else if let Some(kept) = kept(context, outputs, receivers)? {
            return Ok(kept);
        }
    }
    let transport =
        PatchTransport { stage, radiance: Radiance::One, ..PatchTransport::of(context, settings.clone())? };
    let known = known(context, &transport, receivers, &before)?;
    let Recorded { pieces, index, record, traced } = transport.recorded(&cell, known, context.progress)?;
    let mut output = colourless(pieces, quantisation(&settings), index)?;
    if let Some((record, rows)) = record {
        output.artefacts.push((RECORD_ARTEFACT.to_owned(), record.encoded()?));
        output.artefacts.extend(rows.encoded()?.map(|bytes| (ROWS_ARTEFACT.to_owned(), bytes)));
    }
    output.counters.insert("receivers_traced".into(), traced as f64);
    output.counters.insert("receivers_kept".into(), (receivers - traced) as f64);
    output.note = note(traced, receivers, changed.as_ref());
    Ok(output)
}

/// Rows of receivers whose rays met nothing that has changed since tasks alike, in the places of their receivers.
fn known(
    context: &Context,
    transport: &PatchTransport,
    receivers: usize,
    before: &[(&Vec<Artefact>, Record)],
) -> Result<Vec<Option<Gathered>>, TaskError> {
    let mut known: Vec<Option<Gathered>> = vec![None; receivers];
    for (outputs, record) in before {
        if known.iter().all(Option::is_some) {
            break;
        }
        let Some(rows) = of_before(context, outputs, ROWS_ARTEFACT, KeptRows::decoded)? else { continue };
        for (known, row) in known.iter_mut().zip(rows.holding(transport, record)) {
            *known = known.take().or(row);
        }
    }
    Ok(known)
}

/// Outputs `cluster/N` and `index`.
fn colourless(
    pieces: Vec<NamedPiece>,
    quantisation: QuantisationSettings,
    index: CellIndex,
) -> Result<TaskOutput, TaskError> {
    let (mut pieces, near_own): (Vec<Piece>, Vec<_>) = pieces.into_iter().unzip();
    pieces.iter_mut().for_each(Colourless::take_from);
    let encoded = encoded(&pieces, quantisation)?;
    let index = index.with_clusters(&pieces, &encoded);
    let mut output = TaskOutput { counters: index.counters(), ..TaskOutput::default() };
    for (number, ((piece, near_own), encoded)) in pieces.into_iter().zip(near_own).zip(encoded).enumerate() {
        let cluster = Colourless::of(piece, near_own, encoded).encoded()?;
        output.artefacts.push((colourless::output(number), cluster));
    }
    output.artefacts.push((CellIndex::OUTPUT.into(), index.encoded()?));
    Ok(output)
}

fn quantisation(settings: &TracedSettings) -> QuantisationSettings {
    QuantisationSettings {
        relative_error: (QUANTISATION_SHARE * settings.patches.rank_error)
            .clamp(QUANTISATION_ERROR[0], QUANTISATION_ERROR[1]),
        levels: settings.lod_levels,
    }
}

/// The value of that name among outputs; `None` if it is gone or of other code.
fn of_before<T>(
    context: &Context,
    outputs: &[Artefact],
    name: &str,
    decoded: fn(&[u8]) -> Result<T, TaskError>,
) -> Result<Option<T>, TaskError> {
    let Some(artefact) = outputs.iter().find(|output| output.name == name) else { return Ok(None) };
    match context.source.get(artefact.digest) {
        Ok(bytes) => Ok(decoded(&bytes).ok()),
        Err(FetchError::Cancelled(cancelled)) => Err(cancelled.into()),
        Err(_) => Ok(None),
    }
}

/// The outputs of a task alike as those of this one; `None` if they are gone, but for rows, which only a later task may want.
fn kept(context: &Context, outputs: &[Artefact], receivers: usize) -> Result<Option<TaskOutput>, TaskError> {
    let mut kept = TaskOutput::default();
    for output in outputs {
        match context.source.get(output.digest) {
            Ok(bytes) => kept.artefacts.push((output.name.clone(), bytes.as_ref().clone())),
            Err(FetchError::Cancelled(cancelled)) => return Err(cancelled.into()),
            Err(_) if output.name == ROWS_ARTEFACT => (),
            Err(_) => return Ok(None),
        }
    }
    let index = kept.artefacts.iter().find(|(name, _)| name == CellIndex::OUTPUT);
    let Some(index) = index.and_then(|(_, bytes)| CellIndex::decoded(bytes).ok()) else { return Ok(None) };
    kept.counters = index.counters();
    kept.counters.insert("receivers_kept".into(), receivers as f64);
    kept.note = format!("as before: nothing that the rays of its {receivers} receivers met has changed");
    Ok(Some(kept))
}

/// Why a task was run.
fn note(traced: usize, receivers: usize, changed: Option<&Changes>) -> String {
    let Some(Changes { cells, tiles, patches, first, .. }) = changed else {
        return format!("{receivers} receivers traced: none like them were before");
    };
    let first = first.as_deref().unwrap_or("something");
    format!(
        "{traced} of {receivers} receivers traced: {first} has changed \
         (in all {cells} cells, {tiles} tiles of the lightmap, {patches} patches)"
    )
}
