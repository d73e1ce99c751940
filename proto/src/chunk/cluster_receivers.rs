//! Receivers of a cluster chunk, level by level: places, materials, irradiance of emitters.

use std::ops::Range;

use super::bytes::Reader;
use super::error::{ChunkError, all_numbers, in_range};
use super::ints;
use super::numbers::*;
use super::order::{morton, texel_of};
use super::predict::Predictor;
use crate::content::{EmitterIrradiance, LINKS, Receivers, TexelEdge};

/// Most albedos in a palette; clusters with more distinct ones use 8-bit codes.
pub(super) const PALETTE_MAX: usize = 256;
/// All bits of a receiver's links.
pub(super) const LINKS_MAX: u64 = (1 << LINKS.len()) - 1;
/// Columns of codes that are guessed: position x, y, z; normal u, v; albedo R, G, B unless there is a palette.
const GUESSED_COLUMNS: usize = 8;
const ALBEDO_COLUMN: usize = 5;

/// Receivers for each colour of a palette at least: a colour takes twelve bytes, an index one, three codes three.
const RECEIVERS_PER_COLOUR: usize = 6;
/// Colours that a palette may have in any case.
const COLOURS_FREE: usize = 8;

/// Distinct albedos in order of first use, or nothing when there are so many that codes are shorter.
pub(super) fn palette_of(albedo: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let most = (albedo.len() / RECEIVERS_PER_COLOUR).clamp(COLOURS_FREE, PALETTE_MAX);
    let mut palette: Vec<[f32; 3]> = Vec::new();
    for &colour in albedo {
        if !palette.contains(&colour) {
            if palette.len() == most {
                return Vec::new();
            }
            palette.push(colour);
        }
    }
    palette
}

/// Codes that receivers of finer levels are guessed from, and what all levels share.
pub(super) struct ReceiverCodec {
    /// Bounds of positions in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Albedos by index; empty when albedos are 8-bit codes.
    pub palette: Vec<[f32; 3]>,
    /// Levels in use.
    pub levels: u32,
    /// Whether coverage and edges are stored: not in version 1.
    has_coverage: bool,
    columns: [Vec<i32>; GUESSED_COLUMNS],
}

impl ReceiverCodec {
    /// A codec that has seen no receivers.
    pub fn new(bounds_m: [[f32; 3]; 2], palette: Vec<[f32; 3]>, levels: u32, version: u16) -> Self {
        Self { bounds_m, palette, levels, has_coverage: version > 1, columns: Default::default() }
    }

    /// Takes in all receivers, in stored order, before any is written.
    pub fn load(&mut self, receivers: &Receivers) {
        for axis in 0..3 {
            let bounds = self.axis_bounds(axis);
            let code = |x: &[f32; 3]| position_code(x[axis], bounds).into();
            self.columns[axis] = receivers.position_m.iter().map(code).collect();
        }
        let normals: Vec<[i16; 2]> = receivers.normal.iter().map(|&normal| normal_code(normal)).collect();
        for axis in 0..2 {
            self.columns[3 + axis] = normals.iter().map(|code| code[axis].into()).collect();
        }
        for channel in 0..3 {
            let code = |colour: &[f32; 3]| albedo_code(colour[channel]).into();
            self.columns[ALBEDO_COLUMN + channel] = receivers.albedo.iter().map(code).collect();
        }
    }

    fn axis_bounds(&self, axis: usize) -> [f32; 2] {
        [self.bounds_m[0][axis], self.bounds_m[1][axis]]
    }

    fn guessed_columns(&self) -> Range<usize> {
        0..if self.palette.is_empty() { GUESSED_COLUMNS } else { ALBEDO_COLUMN }
    }

    /// Appends receivers `rows`, all of `level`, to `out`.
    pub fn write(
        &self,
        out: &mut Vec<u8>,
        receivers: &Receivers,
        rows: Range<usize>,
        level: u32,
        predictor: &Predictor,
    ) {
        write_texels(out, receivers, rows.clone(), level);
        for column in self.guessed_columns() {
            ints::put_i32s(out, &predictor.differences(rows.clone(), &self.columns[column]));
        }
        if !self.palette.is_empty() {
            let index_of = |colour| self.palette.iter().position(|other| other == colour).unwrap_or(0) as u32;
            ints::put_u32s(out, &receivers.albedo[rows.clone()].iter().map(index_of).collect::<Vec<_>>());
        }
        write_emission(out, &receivers.emission[rows.clone()]);
        let links: Vec<u32> = receivers.links[rows.clone()].iter().map(|&bits| bits.into()).collect();
        ints::put_u32s(out, &links);
        ints::put_u32s(
            out,
            &receivers.coverage[rows.clone()].iter().map(|&bits| (!bits).into()).collect::<Vec<_>>(),
        );
        ints::put_u32s(out, &receivers.edge[rows].iter().map(|edge| edge.0.into()).collect::<Vec<_>>());
    }

    /// Reads `count` receivers of `level` and appends them to `receivers`; the predictor learns of them.
    pub fn read(
        &mut self,
        reader: &mut Reader,
        receivers: &mut Receivers,
        count: usize,
        level: u32,
        predictor: &mut Predictor,
    ) -> Result<(), ChunkError> {
        let rows = receivers.len()..receivers.len() + count;
        read_texels(reader, receivers, count, [level, self.levels])?;
        predictor.extend(receivers, rows.clone(), level);
        for column in self.guessed_columns() {
            let differences = ints::take_i32s(reader, "attribute", count)?;
            predictor.restore(rows.clone(), &differences, &mut self.columns[column]);
            let (min, max) = match column {
                0..3 => (0, 65_535),
                3..ALBEDO_COLUMN => (-32_767, 32_767),
                _ => (0, 255),
            };
            let allowed = |&&code: &&i32| !(min..=max).contains(&code);
            if let Some(&code) = self.columns[column][rows.clone()].iter().find(allowed) {
                let (section, what) = (reader.section(), "code of a position, normal or albedo");
                let value = code.unsigned_abs().into();
                return Err(ChunkError::OutOfRange { section, what, value, min: 0, max: max as u64 });
            }
        }
        self.decode_columns(receivers, rows);
        self.read_palette_albedo(reader, receivers, count)?;
        read_emission(reader, receivers, count)?;
        for bits in ints::take_u32s(reader, "links", count)? {
            receivers.links.push(in_range("receivers", "links", bits.into(), 0, LINKS_MAX)? as u8);
        }
        if !self.has_coverage {
            receivers.coverage.resize(receivers.len(), 0);
            receivers.edge.resize(receivers.len(), TexelEdge::NONE);
            return Ok(());
        }
        for bits in ints::take_u32s(reader, "coverage", count)? {
            let uncovered = in_range("receivers", "coverage", bits.into(), 0, u16::MAX.into())? as u16;
            receivers.coverage.push(!uncovered);
        }
        for code in ints::take_u32s(reader, "edge", count)? {
            let code = in_range("receivers", "edge", code.into(), 0, u16::MAX.into())?;
            receivers.edge.push(TexelEdge(code as u16));
        }
        Ok(())
    }

    fn decode_columns(&self, receivers: &mut Receivers, rows: Range<usize>) {
        for row in rows {
            let code = |column: usize| self.columns[column][row];
            let position = [0, 1, 2].map(|axis| position_of(code(axis) as u16, self.axis_bounds(axis)));
            receivers.position_m.push(position);
            receivers.normal.push(normal_of([code(3) as i16, code(4) as i16]));
            if self.palette.is_empty() {
                let channels = [0, 1, 2].map(|channel| albedo_of(code(ALBEDO_COLUMN + channel) as u8));
                receivers.albedo.push(channels);
            }
        }
    }

    fn read_palette_albedo(
        &self,
        reader: &mut Reader,
        receivers: &mut Receivers,
        count: usize,
    ) -> Result<(), ChunkError> {
        if self.palette.is_empty() {
            return Ok(());
        }
        let last = self.palette.len() as u64 - 1;
        for index in ints::take_u32s(reader, "albedo", count)? {
            let index = in_range(reader.section(), "albedo", index.into(), 0, last)?;
            receivers.albedo.push(self.palette[index]);
        }
        Ok(())
    }
}

/// Most raw bytes of `count` receivers of a level.
pub(super) fn receivers_bytes_max(count: usize, blocks: usize, emitters: usize) -> u64 {
    ints::bytes_max(blocks) + 16 * ints::bytes_max(count) + 4 * emitters as u64 * ints::bytes_max(count)
}

/// Per block its number of receivers, then per receiver how far its texel's Morton code at this level is past the one
/// before it in the block.
fn write_texels(out: &mut Vec<u8>, receivers: &Receivers, rows: Range<usize>, level: u32) {
    let mut counts = vec![0; receivers.blocks.len()];
    let mut steps = Vec::with_capacity(rows.len());
    let mut before = None;
    for row in rows {
        let block = receivers.block[row];
        counts[usize::from(block)] += 1;
        let code = morton(receivers.texel[row]) >> (2 * level);
        steps.push(match before {
            Some((same, last)) if same == block => code - last - 1,
            _ => code,
        });
        before = Some((block, code));
    }
    ints::put_u32s(out, &counts);
    ints::put_u32s(out, &steps);
}

fn read_texels(
    reader: &mut Reader,
    receivers: &mut Receivers,
    count: usize,
    [level, levels]: [u32; 2],
) -> Result<(), ChunkError> {
    let section = reader.section();
    let counts = ints::take_u32s(reader, "receivers per block", receivers.blocks.len())?;
    let total: u64 = counts.iter().map(|&count| u64::from(count)).sum();
    in_range(section, "receivers of all blocks", total, count as u64, count as u64)?;
    let mut steps = ints::take_u32s(reader, "texel", count)?.into_iter();
    for (block, &in_block) in counts.iter().enumerate() {
        let mut next = 0_u64;
        for step in steps.by_ref().take(in_block as usize) {
            let code = next + u64::from(step);
            in_range(section, "texel", code, 0, u64::from(u32::MAX >> (2 * level)))?;
            let texel = texel_of((code as u32) << (2 * level));
            let found = Receivers::level(texel, levels);
            in_range(section, "texel's level", found.into(), level.into(), level.into())?;
            receivers.texel.push(texel);
            receivers.block.push(block as u16);
            next = code + 1;
        }
    }
    Ok(())
}

/// For every receiver 0, or 1 if it emits; then what the emitting ones emit.
fn write_emission(out: &mut Vec<u8>, emission: &[[f32; 3]]) {
    let emits = |colour: &&[f32; 3]| **colour != [0.0; 3];
    let mask: Vec<u32> = emission.iter().map(|colour| emits(&colour).into()).collect();
    ints::put_u32s(out, &mask);
    for channel in 0..3 {
        let values: Vec<f32> = emission.iter().filter(emits).map(|colour| colour[channel]).collect();
        ints::put_f32_planes(out, &values);
    }
}

/// Rows of a mask of zeros and ones that are set.
fn take_mask(reader: &mut Reader, what: &'static str, count: usize) -> Result<Vec<usize>, ChunkError> {
    let mut rows = Vec::new();
    for (row, bit) in ints::take_u32s(reader, what, count)?.into_iter().enumerate() {
        if in_range(reader.section(), what, bit.into(), 0, 1)? == 1 {
            rows.push(row);
        }
    }
    Ok(rows)
}

fn read_emission(reader: &mut Reader, receivers: &mut Receivers, count: usize) -> Result<(), ChunkError> {
    let emitting = take_mask(reader, "emission mask", count)?;
    let first = receivers.emission.len();
    receivers.emission.resize(first + count, [0.0; 3]);
    for channel in 0..3 {
        let values = ints::take_f32_planes(reader, "emission", emitting.len())?;
        all_numbers(reader.section(), "emission", &values, "0 or more", |value| value >= 0.0)?;
        emitting.iter().zip(values).for_each(|(row, value)| receivers.emission[first + row][channel] = value);
    }
    Ok(())
}

/// For every receiver 0, or 1 if the emitter reaches it; of those the code of R as a difference from the one before,
/// then of G and B by how much more each is above R's than it was at the first: nothing, for an emitter of one colour.
pub(super) fn write_irradiance(out: &mut Vec<u8>, irradiance: &[[f32; 3]]) {
    let codes: Vec<[i32; 3]> = irradiance.iter().map(|e| e.map(|e| irradiance_code(e).into())).collect();
    let mask: Vec<u32> = codes.iter().map(|codes| u32::from(*codes != [0; 3])).collect();
    ints::put_u32s(out, &mask);
    let lit: Vec<[i32; 3]> = codes.into_iter().filter(|codes| *codes != [0; 3]).collect();
    ints::put_deltas(out, lit.iter().map(|codes| codes[0]));
    for channel in 1..3 {
        let first = lit.first().map_or(0, |codes| codes[channel] - codes[0]);
        out.extend_from_slice(&first.to_le_bytes());
        ints::put_i32s(out, &lit.iter().map(|codes| codes[channel] - codes[0] - first).collect::<Vec<_>>());
    }
}

/// Reads what [`write_irradiance`] wrote of `count` receivers and appends it to `emitter`.
pub(super) fn read_irradiance(
    reader: &mut Reader,
    emitter: &mut EmitterIrradiance,
    count: usize,
) -> Result<(), ChunkError> {
    let lit = take_mask(reader, "irradiance mask", count)?;
    let allowed = 0..=65_535;
    let red = ints::take_deltas(reader, "irradiance", lit.len(), allowed.clone())?;
    let mut codes: Vec<[i32; 3]> = red.into_iter().map(|code| [code; 3]).collect();
    for channel in 1..3 {
        let first = reader.u32("irradiance")? as i32;
        for (codes, over) in codes.iter_mut().zip(ints::take_i32s(reader, "irradiance", lit.len())?) {
            let code = codes[0].wrapping_add(first).wrapping_add(over);
            codes[channel] = in_range(reader.section(), "irradiance", code as u32 as u64, 0, 65_535)? as i32;
        }
    }
    let first = emitter.irradiance.len();
    emitter.irradiance.resize(first + count, [0.0; 3]);
    for (row, codes) in lit.into_iter().zip(codes) {
        emitter.irradiance[first + row] = codes.map(|code| irradiance_of(code as u16));
    }
    Ok(())
}
