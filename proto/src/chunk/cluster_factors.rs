//! The factors' codes in their sections: which cells a layer adds, in which order, and how U's are guessed.

use std::ops::Range;

use super::bytes::Reader;
use super::cells::{CellReader, CellWriter};
use super::error::{ChunkError, in_range};
use super::layers::{LayerBox, Shape, band_groups, coefficients_of, rank_groups, ranks_of};
use super::predict::Predictor;
use super::quantise::{Quantised, value};
use crate::content::ClusterTransport;

/// Receivers per cell of U.
const U_CELL: usize = 48;
/// Columns per cell of ΣVᵀ where each group of columns has but one.
const VT_CELL: usize = 48;
/// Codes of a column of U are stored as they are.
const AS_IS: u8 = 0;
/// Codes of a column of U are stored as differences from guesses.
const GUESSED: u8 = 1;

/// A part of the factors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// Rows of ΣVᵀ: a rank group, and in it a band group of every key.
    Vt { ranks: usize, bands: usize },
    /// Columns of U: the receivers of a level, a rank group.
    U { level: u32, ranks: usize },
}

/// Parts of `layer`: by rank group, first ΣVᵀ by band group, then U from coarse to fine.
fn parts_of(shape: &Shape, layer: LayerBox) -> Vec<Part> {
    let mut parts = Vec::new();
    for ranks in rank_groups(layer.rank) {
        parts.extend(band_groups(layer.bands).map(|bands| Part::Vt { ranks, bands }));
        parts.extend(shape.levels_in(layer).map(|level| Part::U { level, ranks }));
    }
    parts
}

/// Parts that `layer` adds to `before`.
fn new_parts(shape: &Shape, before: Option<LayerBox>, layer: LayerBox) -> Vec<Part> {
    let known = before.map(|before| parts_of(shape, before)).unwrap_or_default();
    parts_of(shape, layer).into_iter().filter(|part| !known.contains(part)).collect()
}

/// Lengths of the cells of `parts`, in order.
fn cell_lengths(shape: Shape, parts: &[Part]) -> impl Iterator<Item = usize> + Clone {
    parts.iter().flat_map(move |&part| match part {
        Part::Vt { ranks, bands } => {
            let rows = ranks_of(ranks, shape.rank).len();
            std::iter::repeat_n(vt_cells(&shape, shape.bands, bands), rows)
                .flatten()
                .map(|cell| cell.len())
                .collect::<Vec<_>>()
        }
        Part::U { level, ranks } => {
            let rows = shape.counts[level as usize];
            let row_cells = (0..rows).step_by(U_CELL).map(|first| U_CELL.min(rows - first));
            let columns = ranks_of(ranks, shape.rank).len();
            std::iter::repeat_n(row_cells.collect::<Vec<_>>(), columns).flatten().collect()
        }
    })
}

/// Columns of each cell of one row of ΣVᵀ with bands up to `bands`: those of band group `group` of one group of columns,
/// or of many, where each has but one column.
fn vt_cells(shape: &Shape, bands: u32, group: usize) -> Vec<Range<usize>> {
    let groups = shape.column_groups;
    if shape.bands == 0 {
        return (0..groups).step_by(VT_CELL).map(|first| first..groups.min(first + VT_CELL)).collect();
    }
    let coefficients = shape.columns(bands) / groups.max(1);
    let js = coefficients_of(group, shape.bands);
    (0..groups).map(|index| index * coefficients + js.start..index * coefficients + js.end).collect()
}

/// Columns of U among `parts`: each has a byte that says how its codes are stored.
fn u_columns(shape: &Shape, parts: &[Part]) -> usize {
    let columns = |part: &Part| match *part {
        Part::U { ranks, .. } => ranks_of(ranks, shape.rank).len(),
        Part::Vt { .. } => 0,
    };
    parts.iter().map(columns).sum()
}

/// Most raw bytes of a layer's two sections of factors.
pub(super) fn factors_bytes_max(shape: &Shape, before: Option<LayerBox>, layer: LayerBox) -> [u64; 2] {
    let parts = new_parts(shape, before, layer);
    let (cells, numbers) = cell_lengths(*shape, &parts).fold((0, 0), |(cells, sum), n| (cells + 1, sum + n));
    [(u_columns(shape, &parts) + cells + numbers) as u64, 3 * numbers as u64 + 1]
}

/// The two sections of what `layer` adds to `before`: how U is stored, shifts and high parts; low parts.
pub(super) fn write_factors(
    shape: &Shape,
    before: Option<LayerBox>,
    layer: LayerBox,
    factors: &Quantised,
    predictor: &Predictor,
) -> (Vec<u8>, Vec<u8>) {
    let (mut modes, mut cells) = (Vec::new(), CellWriter::default());
    let (receivers, columns) = (shape.receivers_in(0), shape.columns(shape.bands));
    for part in new_parts(shape, before, layer) {
        match part {
            Part::Vt { ranks, bands } => {
                let of_row = vt_cells(shape, shape.bands, bands);
                for i in ranks_of(ranks, shape.rank) {
                    let row = &factors.vt[i * columns..][..columns];
                    of_row.iter().for_each(|cell| cells.push(&row[cell.clone()]));
                }
            }
            Part::U { level, ranks } => {
                let rows = shape.rows_of(level);
                for i in ranks_of(ranks, shape.rank) {
                    let column = &factors.u[i * receivers..][..receivers];
                    let differences = predictor.differences(rows.clone(), column);
                    let guessed = total(&differences) < total(&column[rows.clone()]);
                    modes.push(if guessed { GUESSED } else { AS_IS });
                    let stored = if guessed { &differences } else { &column[rows.clone()] };
                    stored.chunks(U_CELL).for_each(|cell| cells.push(cell));
                }
            }
        }
    }
    let (mut high, low) = cells.finish();
    modes.append(&mut high);
    (modes, low)
}

fn total(values: &[i32]) -> u64 {
    values.iter().map(|value| u64::from(value.unsigned_abs())).sum()
}

/// Codes of U that later layers guess from, one array per rank, in stored order of receivers.
pub(super) struct FactorReader<'a> {
    /// Counts of the chunk.
    pub shape: &'a Shape,
    /// Steps s_u and s_v per rank.
    pub steps: [&'a [f32]; 2],
    /// Sources of U's guesses.
    pub predictor: &'a Predictor,
}

impl FactorReader<'_> {
    /// Reads what `layer` adds to `before` into `cluster`, whose arrays have their final size; `u_codes` holds the
    /// codes of U read so far and is added to.
    pub fn read(
        &self,
        sections: [&[u8]; 2],
        before: Option<LayerBox>,
        layer: LayerBox,
        u_codes: &mut [Vec<i32>],
        cluster: &mut ClusterTransport,
    ) -> Result<(), ChunkError> {
        let parts = new_parts(self.shape, before, layer);
        let (mut high, mut low) =
            (Reader::new("factors", sections[0]), Reader::new("low parts", sections[1]));
        let mut modes = high.take("modes", u_columns(self.shape, &parts), 1)?.iter();
        let mut cells = CellReader::new(&mut high, &mut low, cell_lengths(*self.shape, &parts))?;
        high.end()?;
        low.end()?;
        for part in parts {
            match part {
                Part::Vt { ranks, bands } => self.read_vt(ranks, bands, &mut cells, cluster),
                Part::U { level, ranks } => {
                    for i in ranks_of(ranks, self.shape.rank) {
                        let mode = modes.next().copied().unwrap_or(AS_IS);
                        in_range("factors", "mode of U", mode.into(), AS_IS.into(), GUESSED.into())?;
                        self.read_u(level, i, mode, &mut cells, &mut u_codes[i], cluster);
                    }
                }
            }
        }
        Ok(())
    }

    fn read_vt(&self, ranks: usize, bands: usize, cells: &mut CellReader, cluster: &mut ClusterTransport) {
        let columns = self.shape.columns(cluster.bands);
        let of_row = vt_cells(self.shape, cluster.bands, bands);
        let mut codes = Vec::new();
        for i in ranks_of(ranks, self.shape.rank) {
            let row = &mut cluster.vt[i * columns..][..columns];
            for cell in &of_row {
                codes.clear();
                cells.next(cell.len(), &mut codes);
                let entries = row[cell.clone()].iter_mut().zip(&codes);
                entries.for_each(|(entry, &code)| *entry = value(code, self.steps[1][i]));
            }
        }
    }

    fn read_u(
        &self,
        level: u32,
        i: usize,
        mode: u8,
        cells: &mut CellReader,
        column: &mut Vec<i32>,
        cluster: &mut ClusterTransport,
    ) {
        let (rows, rank) = (self.shape.rows_of(level), cluster.rank as usize);
        let mut stored = Vec::with_capacity(rows.len());
        while stored.len() < rows.len() {
            cells.next(U_CELL.min(rows.len() - stored.len()), &mut stored);
        }
        if mode == GUESSED {
            self.predictor.restore(rows.clone(), &stored, column);
        } else {
            column.append(&mut stored);
        }
        for row in rows {
            cluster.u[row * rank + i] = value(column[row], self.steps[0][i]);
        }
    }
}
