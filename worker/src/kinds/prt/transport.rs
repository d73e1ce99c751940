//! Task `prt.transport`: a cell's rays, rows and factors; or those of a task alike whose record still holds, or its rows as far as
//! they do.

use lightkiln_proto::chunk::QuantisationSettings;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_proto::kinds::prt::Settings;

use super::colourless::{self, Colourless};
use super::rows::{KeptRows, Known, ROWS_ARTEFACT, RowLimits};
use super::truncate::{self, NamedPiece};
use super::{PatchTransport, Recorded, TracedSettings, TransportParams};
use crate::emitters::Radiance;
use crate::factors::{CellIndex, ClusterCell, Piece, cell_of_task, encoded};
use crate::lightmap::World;
use crate::reads::{Changes, RECORD_ARTEFACT, Record, Stage, of_before, outputs_of_before};
use crate::task::{Context, Progress, TaskError, TaskOutput, params};
use crate::transport::{DEAD_PATH_TEXELS, Row};

/// Error of quantisation as a share of that of truncation: numbers of few bits cost less than ranks, whose loss shows as steps between
/// clusters.
const QUANTISATION_SHARE: f32 = 1.1;
/// Least and most error of quantisation.
const QUANTISATION_ERROR: [f32; 2] = [2e-4, 0.05];

/// Tasks alike that were done before, as far as something is left of them.
#[derive(Debug, Default)]
struct Before {
    /// There were some.
    any: bool,
    /// One of them left a record that holds, and nothing else.
    is_gone: bool,
    /// Changes since the newest that left a record that does not.
    changes: Option<Changes>,
    /// Of such ones some left rows.
    has_rows: bool,
}

/// Runs the task: inputs of [`PatchTransport::of`], `cells` and `stage`; outputs `cluster/N`, `index`, `record` and `rows`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let TransportParams { cluster, settings } = params(task)?;
    let cell = cell_of_task(context, cluster)?;
    let receivers = cell.receivers.len();
    let stage = Stage::of(context)?;
    // Take the result of a task alike, if all that it read is as it was.
    let (mut before, mut changed) =
        (Before { any: !context.alike.is_empty(), ..Before::default() }, Vec::new());
    for outputs in context.alike {
        let Some(record) = of_before(context, outputs, RECORD_ARTEFACT, Record::decoded)? else { continue };
        let changes = record.changes(&stage);
        if changes.any {
            before.changes.get_or_insert(changes);
            changed.push((outputs, record));
        } else if let Some(kept) = kept(context, outputs, receivers)? {
            return Ok(kept);
        } else {
            before.is_gone = true;
        }
    }
    let transport =
        PatchTransport { stage, radiance: Radiance::One, ..PatchTransport::of(context, settings.clone())? };
    let known = known(context, &transport, receivers, &changed)?;
    before.has_rows = known.is_some();
    let known = known.unwrap_or_default();
    let Recorded { pieces, index, record, traced } = transport.recorded(&cell, known, context.progress)?;
    let mut output = colourless(pieces, quantisation(&settings), index)?;
    if let Some((record, rows)) = record {
        output.artefacts.push((RECORD_ARTEFACT.to_owned(), record.encoded()?));
        output.artefacts.extend(rows.encoded()?.map(|bytes| (ROWS_ARTEFACT.to_owned(), bytes)));
    }
    output.counters.insert("receivers_traced".into(), traced as f64);
    output.counters.insert("receivers_kept".into(), (receivers - traced) as f64);
    output.note = note(traced, receivers, &before);
    Ok(output)
}

/// Rows of receivers whose rays met nothing that has changed since tasks alike, in the places of their receivers; `None` if none of
/// these left any rows.
fn known(
    context: &Context,
    transport: &PatchTransport,
    receivers: usize,
    changed: &[(&Vec<Artefact>, Record)],
) -> Result<Option<Vec<Option<Known>>>, TaskError> {
    let limits = RowLimits::of(&transport.settings, receivers, transport.emitters.count());
    let mut all: Option<Vec<Option<Known>>> = None;
    for (outputs, record) in changed {
        if all.as_ref().is_some_and(|known| known.iter().all(Option::is_some)) {
            break;
        }
        let decoded = |bytes: &[u8]| KeptRows::decoded(bytes, &limits);
        let Some(rows) = of_before(context, outputs, ROWS_ARTEFACT, decoded)? else { continue };
        let known = all.get_or_insert_with(|| vec![None; receivers]);
        for (known, row) in known.iter_mut().zip(rows.holding(transport, record)) {
            *known = known.take().or(row);
        }
    }
    Ok(all)
}

/// A receiver's row that is known without any ray, and without noise.
pub struct KnownRow {
    /// The part that every kind has.
    pub shared: Row,
    /// As in [`PatchRow::importance`].
    ///
    /// [`PatchRow::importance`]: crate::transport::PatchRow::importance
    pub importance: [Vec<f32>; 2],
}

/// Outputs `cluster/N` and `index` of a cell whose receivers' rows over such keys are known.
pub fn of_known_rows(
    world: &World,
    settings: &Settings,
    (keys, rows): (&[u64], Vec<KnownRow>),
    cell: &ClusterCell,
    progress: &Progress,
) -> Result<TaskOutput, TaskError> {
    let row = |KnownRow { shared, importance }| super::Row { shared, importance, ..super::Row::default() };
    let (rows, settings) = (rows.into_iter().map(row).collect::<Vec<_>>(), TracedSettings::from(settings));
    let cavity_m = DEAD_PATH_TEXELS * world.lightmap.texel_m;
    let index = CellIndex::of(rows.iter().map(|row| (&row.shared, row.is_dead())), cavity_m);
    let pieces = truncate::pieces((world, &settings), keys, cell, &rows, progress)?;
    colourless(pieces, quantisation(&settings), index)
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

/// Error of the stored numbers of factors that are truncated by such an error.
pub fn quantisation_error(rank_error: f32) -> f32 {
    (QUANTISATION_SHARE * rank_error).clamp(QUANTISATION_ERROR[0], QUANTISATION_ERROR[1])
}

fn quantisation(settings: &TracedSettings) -> QuantisationSettings {
    QuantisationSettings {
        relative_error: quantisation_error(settings.patches.rank_error),
        levels: settings.lod_levels,
    }
}

/// The outputs of a task alike as those of this one; `None` if they are gone, but for rows, which only a later task may want.
fn kept(context: &Context, outputs: &[Artefact], receivers: usize) -> Result<Option<TaskOutput>, TaskError> {
    let Some(artefacts) = outputs_of_before(context, outputs, ROWS_ARTEFACT)? else { return Ok(None) };
    let mut kept = TaskOutput { artefacts, ..TaskOutput::default() };
    let index = kept.artefacts.iter().find(|(name, _)| name == CellIndex::OUTPUT);
    let Some(index) = index.and_then(|(_, bytes)| CellIndex::decoded(bytes).ok()) else { return Ok(None) };
    kept.counters = index.counters();
    kept.counters.insert("receivers_kept".into(), receivers as f64);
    kept.note = format!("as before: nothing that the rays of its {receivers} receivers met has changed");
    Ok(Some(kept))
}

/// Why a task was run.
fn note(traced: usize, receivers: usize, before: &Before) -> String {
    let Some(Changes { cells, tiles, patches, first, .. }) = &before.changes else {
        let why = match before {
            Before { any: false, .. } => "none like them were before",
            Before { is_gone: true, .. } => {
                "nothing that they met has changed, but the light of before is gone"
            }
            _ => "those like them before left no record, as they met too much, or it is gone",
        };
        return format!("{receivers} receivers traced: {why}");
    };
    let first = first.as_deref().unwrap_or("something");
    let rows = if before.has_rows { "" } else { "; rows of before were too large to keep, or are gone" };
    format!(
        "{traced} of {receivers} receivers traced: {first} has changed \
         (in all {cells} cells, {tiles} tiles of the lightmap, {patches} patches){rows}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn note_tells_receivers_that_are_new_from_those_of_which_something_is_lost() {
        let note = |before: Before| note(7, 9, &before);
        let any = || Before { any: true, ..Before::default() };
        assert!(note(Before::default()).ends_with("9 receivers traced: none like them were before"));
        assert!(note(any()).contains("left no record"));
        assert!(note(Before { is_gone: true, ..any() }).contains("is gone"));
        let changed = || {
            let first = Some("the cell".to_owned());
            Before { changes: Some(Changes { any: true, cells: 3, first, ..Changes::default() }), ..any() }
        };
        let with_rows = note(Before { has_rows: true, ..changed() });
        assert!(with_rows.starts_with("7 of 9 receivers traced: the cell has changed (in all 3 cells"));
        assert!(with_rows.ends_with(')'), "{with_rows}");
        assert!(note(changed()).contains("rows of before were too large to keep, or are gone"));
    }
}
