//! Chunks of a field: some probes with their depth maps and their transport.

use serde_json::{Value, json};

use super::content::{FieldPart, MOVES_MAX, PROBE_ROWS, Probe, ProbeKey};
use super::octahedron::MAP_POINTS;
use crate::chunk::bytes::Reader;
use crate::chunk::container::{Container, ContainerWriter, SectionId};
use crate::chunk::error::{all_finite, all_numbers, in_range};
use crate::chunk::factors::{StoredFactors, decode_factors};
use crate::chunk::limits::EMITTERS_MAX;
use crate::chunk::{ChunkError, ChunkKind, ChunkRow, FactorShape, ascending, ascending_keys, ints};
use crate::content::EmitterIrradiance;

/// Most probes of a chunk.
pub const PART_PROBES_MAX: usize = 4096;

/// Probes with their depth maps and their transport.
pub const FIELD: ChunkKind = ChunkKind(7);

/// Its row in the table of chunk kinds.
pub const ROW: ChunkRow = ChunkRow {
    kind: FIELD,
    name: "field",
    sections: &[
        (tags::PROBES, "probes"),
        (tags::BASE, "base"),
        (tags::FACTORS, "factors"),
        (tags::FACTORS_LOW, "factors low"),
        (tags::EMITTERS, "emitters"),
        (tags::DEPTHS, "depths"),
    ],
    describe,
    layers: None,
};

/// Section tags of field chunks; their parts are 0, 0, 0.
pub(crate) mod tags {
    /// Keys and moves.
    pub const PROBES: u8 = 1;
    /// Keys of columns and steps.
    pub const BASE: u8 = 2;
    /// Numbers of U and ΣVᵀ: their high parts.
    pub const FACTORS: u8 = 3;
    /// Low parts of the same numbers.
    pub const FACTORS_LOW: u8 = 4;
    /// Light straight from emitters.
    pub const EMITTERS: u8 = 5;
    /// Depth maps.
    pub const DEPTHS: u8 = 6;
}

const SECTIONS: [SectionId; 6] = [
    SectionId::new(tags::PROBES, [0; 3]),
    SectionId::new(tags::BASE, [0; 3]),
    SectionId::new(tags::FACTORS, [0; 3]),
    SectionId::new(tags::FACTORS_LOW, [0; 3]),
    SectionId::new(tags::EMITTERS, [0; 3]),
    SectionId::new(tags::DEPTHS, [0; 3]),
];

/// A field's chunk, and the error of its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedField {
    /// The chunk.
    pub bytes: Vec<u8>,
    /// `‖U·ΣVᵀ − decoded‖/‖U·ΣVᵀ‖`.
    pub quantisation_error: f32,
}

fn describe(bytes: &[u8]) -> Result<Value, ChunkError> {
    let part = decode_field(bytes)?;
    Ok(json!({
        "probes": part.probes.len(),
        "spacing_m": part.spacing_m,
        "column keys": part.factors.keys.len(),
        "rank": part.factors.rank,
        "emitters": part.emitters.len(),
    }))
}

/// Encodes a part of a field, its probes and emitters ascending by key; `relative_error` bounds that of its factors, as of a cluster's.
///
/// Errs if arrays disagree in length, two keys are alike, a number is not finite or out of its range, or a limit is passed.
pub fn encode_field(part: &FieldPart, relative_error: f32) -> Result<EncodedField, ChunkError> {
    let section = "encoder";
    let probes = in_range(section, "probes", part.probes.len() as u64, 0, PART_PROBES_MAX as u64)?;
    check_spacing(section, part.spacing_m)?;
    let same = |what, length: usize, wanted: usize| {
        in_range(section, what, length as u64, wanted as u64, wanted as u64).map(drop)
    };
    same("depths", part.depths.len(), probes * MAP_POINTS)?;
    in_range(section, "bands", part.factors.bands.into(), 0, 0)?;
    in_range(section, "columns of a sky without keys", part.factors.sky.into(), 0, 0)?;
    in_range(section, "emitters", part.emitters.len() as u64, 0, EMITTERS_MAX as u64)?;
    let (sorted, source) = ascending(&part.probes, "probe", |probe| probe.key)?;
    let (emitters, _) = ascending(&part.emitters, "emitter", |entry| entry.emitter)?;
    same("probes in their order", source.iter().zip(0..).filter(|(from, at)| **from == *at).count(), probes)?;
    for EmitterIrradiance { irradiance, .. } in &emitters {
        same("coefficients of an emitter", irradiance.len(), probes * PROBE_ROWS)?;
        all_finite(section, "coefficients", irradiance.as_flattened())?;
    }
    let factors = StoredFactors::of_rows(&part.factors, probes * PROBE_ROWS, relative_error)?;
    let [base, high, low] = factors.sections();
    let raw = [base_of(&sorted)?, base, high, low, emitters_of(&emitters), depths_of(&part.depths)];
    let mut writer = ContainerWriter::new(FIELD);
    for (id, raw) in SECTIONS.into_iter().zip(&raw) {
        writer.push(id, raw)?;
    }
    let mut head = Vec::new();
    for count in [probes, factors.shape.keys, emitters.len()] {
        head.extend_from_slice(&(count as u32).to_le_bytes());
    }
    head.extend_from_slice(&part.spacing_m.to_le_bytes());
    head.extend_from_slice(&factors.shape.rank.to_le_bytes());
    Ok(EncodedField { bytes: writer.finish(&head)?.0, quantisation_error: factors.relative_error() })
}

fn check_spacing(section: &'static str, spacing_m: f32) -> Result<(), ChunkError> {
    all_numbers(section, "spacing", &[spacing_m], "1e-9..=1e9 m", |x| (1e-9..=1e9).contains(&x))
}

fn base_of(probes: &[Probe]) -> Result<Vec<u8>, ChunkError> {
    let mut out = Vec::new();
    let keys: Vec<u64> = probes.iter().map(|probe| probe.key.0).collect();
    crate::chunk::bytes::put_u64s(&mut out, &keys);
    for axis in 0..3 {
        for probe in probes {
            let steps = u64::from(probe.moved[axis].unsigned_abs());
            in_range("encoder", "steps moved", steps, 0, u64::from(MOVES_MAX.unsigned_abs()))?;
            out.push((probe.moved[axis] + MOVES_MAX) as u8);
        }
    }
    Ok(out)
}

fn emitters_of(emitters: &[EmitterIrradiance]) -> Vec<u8> {
    let mut out = Vec::new();
    emitters.iter().for_each(|entry| out.extend_from_slice(&entry.emitter.to_le_bytes()));
    for EmitterIrradiance { irradiance, .. } in emitters {
        ints::put_f32_planes(&mut out, irradiance.as_flattened());
    }
    out
}

fn depths_of(depths: &[u16]) -> Vec<u8> {
    let mut out = Vec::new();
    // Neighbours along a row are much alike.
    ints::put_deltas(&mut out, depths.iter().map(|&code| i32::from(code)));
    out
}

/// Decodes a part of a field.
pub fn decode_field(bytes: &[u8]) -> Result<FieldPart, ChunkError> {
    let container = Container::whole(FIELD, bytes)?;
    let mut reader = Reader::new("field head", container.head);
    let probes = reader.u32("probes")?;
    let probes = in_range("field head", "probes", probes.into(), 0, PART_PROBES_MAX as u64)?;
    let keys = reader.u32("column keys")? as usize;
    let emitters = reader.u32("emitters")?;
    let emitters = in_range("field head", "emitters", emitters.into(), 0, EMITTERS_MAX as u64)?;
    let spacing_m = reader.f32("spacing")?;
    check_spacing("field head", spacing_m)?;
    let rank = reader.u32("rank")?;
    reader.end()?;
    container.check_sections(&SECTIONS)?;
    let rows = probes * PROBE_ROWS;
    let shape = FactorShape { counts: [rows, 0, 0, 0], levels: 1, keys, sky: false, bands: 0, rank };
    shape.check("field head")?;
    let of_emitters = emitters as u64 * (2 + ints::bytes_max(3 * rows));
    let of_depths = ints::bytes_max(probes * MAP_POINTS);
    container.check_expansion(shape.decoded_bytes() + of_emitters + of_depths + 11 * probes as u64)?;
    let [base_max, high_max, low_max] = shape.bytes_max();
    let all = read_probes(&container.section(0, "probes", 11 * probes as u64)?, probes)?;
    let base = container.section(1, "base", base_max)?;
    let high = container.section(2, "factors", high_max)?;
    let low = container.section(3, "low parts", low_max)?;
    let factors = decode_factors(shape, container.version, [&base, &high, &low])?;
    let emitters = read_emitters(&container.section(4, "emitters", of_emitters)?, emitters, rows)?;
    let raw = container.section(5, "depths", of_depths)?;
    let mut reader = Reader::new("depths", &raw);
    let depths = ints::take_deltas(&mut reader, "depth", probes * MAP_POINTS, 0..=65_535)?;
    reader.end()?;
    let depths = depths.into_iter().map(|code| code as u16).collect();
    Ok(FieldPart { spacing_m, probes: all, depths, factors, emitters })
}

fn read_probes(raw: &[u8], count: usize) -> Result<Vec<Probe>, ChunkError> {
    let mut reader = Reader::new("probes", raw);
    let keys = ascending_keys(&mut reader, "probe", count)?;
    let mut probes = Vec::with_capacity(count);
    for key in keys {
        // A point of the lattice has one key: that of other bits would be read as another.
        let point = ProbeKey(key).point();
        let is_point = [ProbeKey::of(point), ProbeKey::of_cell(point)].contains(&Some(ProbeKey(key)));
        in_range("probes", "keys that name no point", u64::from(!is_point), 0, 0)?;
        probes.push(Probe { key: ProbeKey(key), moved: [0; 3] });
    }
    for axis in 0..3 {
        for probe in &mut probes {
            let most = 2 * u64::from(MOVES_MAX.unsigned_abs());
            let moved = in_range("probes", "steps moved", reader.u8("steps moved")?.into(), 0, most)?;
            probe.moved[axis] = moved as i8 - MOVES_MAX;
        }
    }
    reader.end()?;
    Ok(probes)
}

fn read_emitters(raw: &[u8], count: usize, rows: usize) -> Result<Vec<EmitterIrradiance>, ChunkError> {
    let mut reader = Reader::new("emitters", raw);
    let mut emitters: Vec<EmitterIrradiance> = Vec::with_capacity(count);
    for index in 0..count {
        let emitter = reader.u16("emitter")?;
        if emitters.last().is_some_and(|before| before.emitter >= emitter) {
            return Err(ChunkError::Order { section: "emitters", what: "emitter", index });
        }
        emitters.push(EmitterIrradiance { emitter, irradiance: Vec::new() });
    }
    for entry in &mut emitters {
        let numbers = ints::take_f32_planes(&mut reader, "coefficients", 3 * rows)?;
        entry.irradiance = numbers.as_chunks::<3>().0.to_vec();
    }
    reader.end()?;
    Ok(emitters)
}
