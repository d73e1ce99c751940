//! Factors of rows as sections of a chunk: quantised, coarse to fine. Cluster chunks have them by layer ([`encode_cluster`]);
//! a chunk kind of rows without levels takes [`StoredFactors::of_rows`] and [`decode_factors`].
//!
//! [`encode_cluster`]: super::encode_cluster

use std::ops::Range;

use super::ascending;
use super::bytes::{Reader, put_f32s};
use super::cells::{CellReader, CellWriter};
use super::column_keys::{keys_bytes_max, put_keys, take_keys};
use super::column_order::ColumnOrder;
use super::column_scale::{put_scales, scales, scales_bytes_max, take_scales};
use super::error::{ChunkError, all_numbers, in_range};
use super::layers::{FactorShape, LayerBox, band_groups, coefficients_of, rank_groups, ranks_of};
use super::limits::{BANDS_MAX, RANK_MAX};
use super::order::LEVELS_MAX;
use super::predict::Predictor;
use super::quantise::{Quantised, RELATIVE_ERROR_MAX, RELATIVE_ERROR_MIN, STEP_MAX, quantise, value};
use crate::content::{ColumnKey, FactorSteps, TransportFactors};

/// Rows per cell of U.
const U_CELL: usize = 48;
/// Columns per cell of ΣVᵀ where each group of columns has but one.
const VT_CELL: usize = 48;
/// Last version that stores the columns of every rank by key.
const LAST_BY_KEY: u16 = 2;
/// Last version that stores the numbers of all columns with one step a rank.
const LAST_WITHOUT_SCALES: u16 = 3;
/// Codes of a column of U are stored as they are.
const AS_IS: u8 = 0;
/// Codes of a column of U are stored as differences from guesses.
const GUESSED: u8 = 1;

/// A part of the factors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// Rows of ΣVᵀ: a rank group, and in it a band group of every key.
    Vt { ranks: usize, bands: usize },
    /// Columns of U: the rows of a level, a rank group.
    U { level: u32, ranks: usize },
}

/// Parts of `layer`: by rank group, first ΣVᵀ by band group, then U from coarse to fine.
fn parts_of(shape: &FactorShape, layer: LayerBox) -> Vec<Part> {
    let mut parts = Vec::new();
    for ranks in rank_groups(layer.rank) {
        parts.extend(band_groups(layer.bands).map(|bands| Part::Vt { ranks, bands }));
        parts.extend(shape.levels_in(layer).map(|level| Part::U { level, ranks }));
    }
    parts
}

/// Parts that `layer` adds to `before`.
fn new_parts(shape: &FactorShape, before: Option<LayerBox>, layer: LayerBox) -> Vec<Part> {
    let known = before.map(|before| parts_of(shape, before)).unwrap_or_default();
    parts_of(shape, layer).into_iter().filter(|part| !known.contains(part)).collect()
}

/// Lengths of the cells of `parts`, in order.
fn cell_lengths(shape: FactorShape, parts: &[Part]) -> impl Iterator<Item = usize> + Clone {
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
fn vt_cells(shape: &FactorShape, bands: u32, group: usize) -> Vec<Range<usize>> {
    let groups = shape.column_groups();
    if shape.bands == 0 {
        return (0..groups).step_by(VT_CELL).map(|first| first..groups.min(first + VT_CELL)).collect();
    }
    let coefficients = shape.columns(bands) / groups.max(1);
    let js = coefficients_of(group, shape.bands);
    (0..groups).map(|index| index * coefficients + js.start..index * coefficients + js.end).collect()
}

/// Columns of U among `parts`: each has a byte that says how its codes are stored.
fn u_columns(shape: &FactorShape, parts: &[Part]) -> usize {
    let columns = |part: &Part| match *part {
        Part::U { ranks, .. } => ranks_of(ranks, shape.rank).len(),
        Part::Vt { .. } => 0,
    };
    parts.iter().map(columns).sum()
}

/// Factors in stored order, quantised.
pub struct StoredFactors {
    /// Counts, as the chunk's head must give them.
    pub shape: FactorShape,
    /// Keys named, ascending: those whose column of ΣVᵀ is worth no code are left out where keys have one column each.
    pub keys: Vec<ColumnKey>,
    /// ΣVᵀ in stored order, where keys have one column each.
    codes: Quantised,
}

impl StoredFactors {
    /// Of rows without levels, in their order; `relative_error` is the largest `‖U·ΣVᵀ − decoded‖/‖U·ΣVᵀ‖` (Frobenius),
    /// 0.0001..=0.5.
    ///
    /// Errs if arrays disagree in length, two keys are alike, a number is not finite or out of its range, or a limit is
    /// passed.
    pub fn of_rows(factors: &TransportFactors, rows: usize, relative_error: f32) -> Result<Self, ChunkError> {
        let source: Vec<usize> = (0..rows).collect();
        Self::of(factors, &source, [rows, 0, 0, 0], 1, relative_error)
    }

    /// Of rows in the order of `source`, with those of each level.
    pub(super) fn of(
        factors: &TransportFactors,
        source: &[usize],
        counts: [usize; LEVELS_MAX as usize],
        levels: u32,
        relative_error: f32,
    ) -> Result<Self, ChunkError> {
        check_input(factors, source.len(), relative_error)?;
        let (mut keys, key_source) = ascending(&factors.keys, "column key", |&key| key)?;
        let u = rank_major(&factors.u, factors.rank as usize, source);
        let mut vt = sorted_columns(factors, &key_source);
        let has_scales = factors.bands == 0 && !factors.sky;
        let scales = if has_scales { scales(&keys) } else { Vec::new() };
        if has_scales {
            vt.iter_mut().zip(scales.iter().cycle()).for_each(|(value, scale)| *value /= scale);
        }
        let mut codes = quantise(&u, &vt, factors.rank as usize, relative_error)?;
        check_scaled("encoder", &codes.vt_step, &scales)?;
        if has_scales {
            codes.vt = largest_first(&without_zeros(&codes.vt, &mut keys), keys.len());
        }
        let TransportFactors { bands, rank, sky, .. } = *factors;
        let shape = FactorShape { counts, levels, keys: keys.len(), sky, bands, rank };
        shape.check("encoder")?;
        Ok(Self { shape, keys, codes })
    }

    /// `‖U·ΣVᵀ − decoded‖/‖U·ΣVᵀ‖`, measured on what a decoder will have.
    pub fn relative_error(&self) -> f32 {
        self.codes.relative_error as f32
    }

    /// The three sections of rows without levels: keys and steps, high parts, low parts.
    pub fn sections(&self) -> [Vec<u8>; 3] {
        let mut base = Vec::new();
        self.write_base(&mut base);
        let (high, low) = self.layer(None, self.shape.full(), &Predictor::none(self.shape.receivers_in(0)));
        [base, high, low]
    }

    /// Appends keys, scales and steps.
    pub(super) fn write_base(&self, out: &mut Vec<u8>) {
        put_keys(out, &self.keys);
        if self.shape.has_scales() {
            put_scales(out, &self.keys);
        }
        put_f32s(out, &self.codes.u_step);
        put_f32s(out, &self.codes.vt_step);
    }

    /// The two sections of what `layer` adds to `before`: how U is stored, shifts and high parts; low parts.
    pub(super) fn layer(
        &self,
        before: Option<LayerBox>,
        layer: LayerBox,
        predictor: &Predictor,
    ) -> (Vec<u8>, Vec<u8>) {
        let shape = &self.shape;
        let (mut modes, mut cells) = (Vec::new(), CellWriter::default());
        let (rows, columns) = (shape.receivers_in(0), shape.columns(shape.bands));
        for part in new_parts(shape, before, layer) {
            match part {
                Part::Vt { ranks, bands } => {
                    let of_row = vt_cells(shape, shape.bands, bands);
                    for i in ranks_of(ranks, shape.rank) {
                        let row = &self.codes.vt[i * columns..][..columns];
                        of_row.iter().for_each(|cell| cells.push(&row[cell.clone()]));
                    }
                }
                Part::U { level, ranks } => {
                    let of_level = shape.rows_of(level);
                    for i in ranks_of(ranks, shape.rank) {
                        let column = &self.codes.u[i * rows..][..rows];
                        let differences = predictor.differences(of_level.clone(), column);
                        let guessed = total(&differences) < total(&column[of_level.clone()]);
                        modes.push(if guessed { GUESSED } else { AS_IS });
                        let stored = if guessed { &differences } else { &column[of_level.clone()] };
                        stored.chunks(U_CELL).for_each(|cell| cells.push(cell));
                    }
                }
            }
        }
        let (mut high, low) = cells.finish();
        modes.append(&mut high);
        (modes, low)
    }
}

fn check_input(factors: &TransportFactors, rows: usize, relative_error: f32) -> Result<(), ChunkError> {
    let section = "encoder";
    let same = |what, length: usize, wanted: usize| {
        in_range(section, what, length as u64, wanted as u64, wanted as u64).map(drop)
    };
    all_numbers(section, "relative error", &[relative_error], "0.0001..=0.5", |error| {
        (RELATIVE_ERROR_MIN..=RELATIVE_ERROR_MAX).contains(&error)
    })?;
    let rank = factors.rank as usize;
    in_range(section, "bands", factors.bands.into(), 0, BANDS_MAX as u64)?;
    in_range(section, "rank", rank as u64, 0, RANK_MAX as u64)?;
    same("entries of U", factors.u.len(), rows * rank)?;
    same("entries of ΣVᵀ", factors.vt.len(), factors.columns() * rank)
}

/// Errs if a step of ΣVᵀ is too large for the largest scale of its columns.
fn check_scaled(section: &'static str, vt_step: &[f32], scales: &[f32]) -> Result<(), ChunkError> {
    let largest = scales.iter().copied().fold(1.0, f32::max);
    let is_small = |step| step * largest <= STEP_MAX;
    all_numbers(section, "step of ΣVᵀ at the largest scale", vt_step, "0..=1e28", is_small)
}

/// Codes of ΣVᵀ of one column per key without the columns that are zero in every rank, and `keys` without theirs.
fn without_zeros(vt: &[i32], keys: &mut Vec<ColumnKey>) -> Vec<i32> {
    let columns = keys.len().max(1);
    let is_used: Vec<bool> =
        (0..columns).map(|c| vt.iter().skip(c).step_by(columns).any(|code| *code != 0)).collect();
    let mut used = is_used.iter();
    keys.retain(|_| used.next().copied().unwrap_or_default());
    vt.iter().zip(is_used.iter().cycle()).filter(|(_, used)| **used).map(|(code, _)| *code).collect()
}

/// Codes of ΣVᵀ of one column per key in stored order, rank by rank.
fn largest_first(vt: &[i32], columns: usize) -> Vec<i32> {
    let mut order = ColumnOrder::new(columns);
    let mut stored = Vec::with_capacity(vt.len());
    for row in vt.chunks_exact(columns.max(1)) {
        stored.extend(order.columns().iter().map(|&column| row[column as usize]));
        order.advance(row);
    }
    stored
}

/// Row-major `u` as rank-major, its rows in the order of `source`.
fn rank_major(u: &[f32], rank: usize, source: &[usize]) -> Vec<f32> {
    (0..rank).flat_map(|i| source.iter().map(move |&row| u[row * rank + i])).collect()
}

/// ΣVᵀ with its keys' columns in the order of `key_source`; the sky's stay last.
fn sorted_columns(factors: &TransportFactors, key_source: &[usize]) -> Vec<f32> {
    let coefficients = factors.coefficients();
    let mut vt = Vec::with_capacity(factors.vt.len());
    for row in factors.vt.chunks_exact(factors.columns().max(1)) {
        for &key in key_source {
            vt.extend_from_slice(&row[key * coefficients..][..coefficients]);
        }
        vt.extend_from_slice(&row[key_source.len() * coefficients..]);
    }
    vt
}

fn total(values: &[i32]) -> u64 {
    values.iter().map(|value| u64::from(value.unsigned_abs())).sum()
}

/// Decodes the three sections of rows without levels. `shape` is the chunk head's: its limits are checked here, the
/// lengths of the sections ([`FactorShape::bytes_max`]) by the caller, before it unpacks them; `version` is the chunk's.
pub fn decode_factors(
    shape: FactorShape,
    version: u16,
    sections: [&[u8]; 3],
) -> Result<TransportFactors, ChunkError> {
    shape.check("factors")?;
    let [base, high, low] = sections;
    let mut decoder = FactorDecoder::new(shape, shape.full());
    let mut reader = Reader::new("base", base);
    decoder.base(&mut reader, version)?;
    reader.end()?;
    decoder.layer([high, low], None, shape.full(), &Predictor::none(shape.receivers_in(0)))?;
    Ok(decoder.factors)
}

impl FactorShape {
    /// Most raw bytes of the three sections of rows without levels.
    pub fn bytes_max(&self) -> [u64; 3] {
        let [high, low] = self.layer_bytes_max(None, self.full());
        [self.base_bytes_max(), high, low]
    }

    /// Memory that the decoded factors take, about.
    pub fn decoded_bytes(&self) -> u64 {
        self.layer_decoded_bytes(self.full())
    }

    /// Most raw bytes of keys and steps.
    pub(super) fn base_bytes_max(&self) -> u64 {
        keys_bytes_max(self.keys) + scales_bytes_max(self.keys) + 8 * u64::from(self.rank)
    }

    /// Whether columns have scales: where each key has one column.
    fn has_scales(&self) -> bool {
        self.bands == 0 && !self.sky
    }

    /// Memory that a decoded layer's factors and keys take, about.
    pub(super) fn layer_decoded_bytes(&self, layer: LayerBox) -> u64 {
        let numbers = layer.rank as usize * (self.receivers_in(layer.level) + self.columns(layer.bands));
        (4 * numbers + 8 * self.keys) as u64
    }

    /// Most raw bytes of a layer's two sections of factors.
    pub(super) fn layer_bytes_max(&self, before: Option<LayerBox>, layer: LayerBox) -> [u64; 2] {
        let parts = new_parts(self, before, layer);
        let (cells, numbers) =
            cell_lengths(*self, &parts).fold((0, 0), |(cells, sum), n| (cells + 1, sum + n));
        [(u_columns(self, &parts) + cells + numbers) as u64, 3 * numbers as u64 + 1]
    }
}

/// Factors that fill up layer by layer.
pub(super) struct FactorDecoder {
    shape: FactorShape,
    /// Arrays have their final size.
    pub factors: TransportFactors,
    /// Codes of U that later layers guess from, one array per rank, in stored order of rows.
    u_codes: Vec<Vec<i32>>,
    /// Of the next rank of ΣVᵀ, where keys have one column each and are not stored in their own order.
    order: Option<ColumnOrder>,
}

impl FactorDecoder {
    /// Of a shape whose counts have been checked against their limits, up to `layer`.
    pub fn new(shape: FactorShape, layer: LayerBox) -> Self {
        let (rank, rows) = (layer.rank as usize, shape.receivers_in(layer.level));
        let factors = TransportFactors {
            keys: Vec::new(),
            bands: layer.bands,
            sky: shape.sky,
            rank: layer.rank,
            u: vec![0.0; rows * rank],
            vt: vec![0.0; rank * shape.columns(layer.bands)],
            steps: FactorSteps::default(),
        };
        let u_codes = vec![Vec::new(); rank];
        Self { shape, factors, u_codes, order: None }
    }

    /// Reads keys and steps of a chunk of `version`.
    pub fn base(&mut self, reader: &mut Reader, version: u16) -> Result<(), ChunkError> {
        let rank = self.shape.rank as usize;
        self.factors.keys = take_keys(reader, self.shape.keys, version)?;
        if version > LAST_WITHOUT_SCALES && self.shape.has_scales() {
            self.factors.steps.scale = take_scales(reader, &self.factors.keys)?;
        }
        let is_ordered = version > LAST_BY_KEY && self.shape.has_scales();
        self.order = is_ordered.then(|| ColumnOrder::new(self.shape.keys));
        let FactorSteps { u, vt, scale } = &mut self.factors.steps;
        for (what, steps) in [("steps of U", &mut *u), ("steps of ΣVᵀ", &mut *vt)] {
            *steps = reader.f32s(what, rank)?;
            all_numbers("base", what, steps, "0..=1e28", |step| (0.0..=STEP_MAX).contains(&step))?;
        }
        check_scaled("base", vt, scale)?;
        // Those of the layer alone.
        [u, vt].into_iter().for_each(|steps| steps.truncate(self.factors.rank as usize));
        Ok(())
    }

    /// Reads what `layer` adds to `before`.
    pub fn layer(
        &mut self,
        sections: [&[u8]; 2],
        before: Option<LayerBox>,
        layer: LayerBox,
        predictor: &Predictor,
    ) -> Result<(), ChunkError> {
        let shape = self.shape;
        let parts = new_parts(&shape, before, layer);
        let (mut high, mut low) =
            (Reader::new("factors", sections[0]), Reader::new("low parts", sections[1]));
        let mut modes = high.take("modes", u_columns(&shape, &parts), 1)?.iter();
        let mut cells = CellReader::new(&mut high, &mut low, cell_lengths(shape, &parts))?;
        high.end()?;
        low.end()?;
        for part in parts {
            match part {
                Part::Vt { ranks, bands } => self.read_vt(ranks, bands, &mut cells),
                Part::U { level, ranks } => {
                    for i in ranks_of(ranks, shape.rank) {
                        let mode = modes.next().copied().unwrap_or(AS_IS);
                        in_range("factors", "mode of U", mode.into(), AS_IS.into(), GUESSED.into())?;
                        self.read_u(level, i, (mode == GUESSED).then_some(predictor), &mut cells);
                    }
                }
            }
        }
        Ok(())
    }

    fn read_vt(&mut self, ranks: usize, bands: usize, cells: &mut CellReader) {
        let columns = self.shape.columns(self.factors.bands);
        let of_row = vt_cells(&self.shape, self.factors.bands, bands);
        let (mut codes, mut by_key) = (Vec::new(), vec![0; columns]);
        for i in ranks_of(ranks, self.shape.rank) {
            let TransportFactors { vt, steps, .. } = &mut self.factors;
            let row = &mut vt[i * columns..][..columns];
            for cell in &of_row {
                codes.clear();
                cells.next(cell.len(), &mut codes);
                for (place, &code) in cell.clone().zip(&codes) {
                    let column = self.order.as_ref().map_or(place, |order| order.columns()[place] as usize);
                    by_key[column] = code;
                    let scale = steps.scale.get(column).copied().unwrap_or(1.0);
                    row[column] = value(code, steps.vt[i]) * scale;
                }
            }
            self.order.iter_mut().for_each(|order| order.advance(&by_key));
        }
    }

    fn read_u(&mut self, level: u32, i: usize, guesses: Option<&Predictor>, cells: &mut CellReader) {
        let (rows, rank) = (self.shape.rows_of(level), self.factors.rank as usize);
        let column = &mut self.u_codes[i];
        let mut stored = Vec::with_capacity(rows.len());
        while stored.len() < rows.len() {
            cells.next(U_CELL.min(rows.len() - stored.len()), &mut stored);
        }
        match guesses {
            Some(predictor) => predictor.restore(rows.clone(), &stored, column),
            None => column.append(&mut stored),
        }
        for row in rows {
            self.factors.u[row * rank + i] = value(column[row], self.factors.steps.u[i]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::VERSION;
    use super::*;

    #[test]
    fn patches_without_a_code_are_not_named() {
        let mut keys = vec![3, 5, 8, 9];
        let vt = [0, 1, 0, 0, 0, -2, 0, 7];
        assert_eq!(without_zeros(&vt, &mut keys), [1, 0, -2, 7]);
        assert_eq!(keys, [5, 9]);
        assert_eq!(without_zeros(&[], &mut keys), [0; 0]);
        assert!(keys.is_empty());
    }

    #[test]
    fn factors_of_rows_without_levels_come_back_within_the_error() {
        let wave = |count: usize| (0..count).map(|i| libm::sinf(i as f32 * 0.7)).collect::<Vec<f32>>();
        for (bands, sky, groups) in [(0, false, 30), (2, true, 6)] {
            let keys = (0..30 / (bands + 1)).map(|i| 1000 - u64::from(i)).take(groups - usize::from(sky));
            let factors =
                TransportFactors { keys: keys.collect(), bands, sky, rank: 3, ..Default::default() };
            let factors = TransportFactors { u: wave(90 * 3), vt: wave(3 * factors.columns()), ..factors };
            let stored = StoredFactors::of_rows(&factors, 90, 0.001).unwrap();
            let sections = stored.sections();
            let lengths = sections.each_ref().map(|section| section.len() as u64);
            assert!(lengths.iter().zip(stored.shape.bytes_max()).all(|(length, max)| *length <= max));
            let decoded =
                decode_factors(stored.shape, VERSION, sections.each_ref().map(Vec::as_slice)).unwrap();
            assert!(decoded.keys.is_sorted() && decoded.keys == stored.keys);
            let near = |a: &f32, b: &f32| (a - b).abs() < 0.01;
            assert!(decoded.u.len() == 270 && decoded.u.iter().zip(&factors.u).all(|(a, b)| near(a, b)));
            let in_order = TransportFactors { vt: sorted_columns(&factors, &reversed(&factors)), ..factors };
            assert!(decoded.vt.iter().zip(&in_order.vt).all(|(a, b)| near(a, b)));
            let short = [&sections[0][..], &sections[1][1..], &sections[2][..]];
            assert!(decode_factors(stored.shape, VERSION, short).is_err());
        }
    }

    fn reversed(factors: &TransportFactors) -> Vec<usize> {
        (0..factors.keys.len()).rev().collect()
    }
}
