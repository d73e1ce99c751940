//! Chunk of one level of an object's volume.

use serde_json::{Value, json};

use super::content::{
    GLOWS_MAX, LEVELS, NODES_MAX, NODES_MIN, PARTS_MAX, PATCHES_MAX, PartGlow, PartPatch, TransferLevel,
    TransferPart,
};
use crate::chunk::bytes::{Reader, put_f32s, put_u64s};
use crate::chunk::container::{Container, ContainerWriter, SectionId};
use crate::chunk::error::{all_ascending, all_numbers, in_range};
use crate::chunk::{ChunkError, ChunkKind, ChunkRow, ints};
use crate::content::PatchKey;

/// A level of an object's volume.
pub const TRANSFER_CHUNK: ChunkKind = ChunkKind(10);

/// Its row in the table of chunk kinds.
pub const ROW: ChunkRow = ChunkRow {
    kind: TRANSFER_CHUNK,
    name: "transfer",
    sections: &[
        (tags::PARTS, "parts"),
        (tags::PATCHES, "patches"),
        (tags::GLOWS, "glows"),
        (tags::CODES, "codes"),
    ],
    describe,
    layers: None,
};

/// Section tags of chunks of volumes; their parts are 0, 0, 0.
pub(crate) mod tags {
    /// Counts, planes and steps.
    pub const PARTS: u8 = 1;
    /// Keys and shares.
    pub const PATCHES: u8 = 2;
    /// Emitters and shares.
    pub const GLOWS: u8 = 3;
    /// F_p and Ω_p.
    pub const CODES: u8 = 4;
}

const SECTIONS: [SectionId; 4] = [
    SectionId::new(tags::PARTS, [0; 3]),
    SectionId::new(tags::PATCHES, [0; 3]),
    SectionId::new(tags::GLOWS, [0; 3]),
    SectionId::new(tags::CODES, [0; 3]),
];
/// Least length of an object as a share of its distance from its origin: 32 bits tell its nodes apart.
pub const NEAREST: f32 = 1e-3;
/// Section of the head, for errors.
const HEAD: &str = "transfer head";
/// Bytes of the numbers of a part: its middle, plane and steps.
const PART_BYTES: u64 = 36;

fn describe(bytes: &[u8]) -> Result<Value, ChunkError> {
    let level = decode_transfer(bytes)?;
    let patches: usize = level.parts.iter().map(|part| part.patches.len()).sum();
    Ok(json!({
        "level": level.level, "nodes": level.nodes, "parts": level.parts.len(), "patches": patches,
        "dark parts": level.parts.iter().filter(|part| part.patches.is_empty()).count(),
        "planes": level.parts.iter().filter(|part| part.plane[..3] != [0.0; 3]).count(),
        "box_m": level.box_m,
    }))
}

/// Counts of a level.
#[derive(Clone, Copy, Debug)]
struct Counts {
    nodes: usize,
    parts: usize,
    patches: usize,
    glows: usize,
}

impl Counts {
    fn of(level: &TransferLevel) -> Self {
        let sum = |of: fn(&TransferPart) -> usize| level.parts.iter().map(of).sum();
        Self {
            nodes: level.node_count(),
            parts: level.parts.len(),
            patches: sum(|part| part.patches.len()),
            glows: sum(|part| part.glows.len()),
        }
    }

    /// Most bytes of each section.
    fn bytes_max(self) -> [u64; 4] {
        let Self { nodes, parts, patches, glows } = self;
        let whole = ints::bytes_max;
        [
            2 * whole(parts) + PART_BYTES * parts as u64,
            12 * patches as u64,
            whole(glows) + 12 * glows as u64,
            4 * (nodes * parts) as u64,
        ]
    }
}

/// Encodes a level. Nothing is lost.
///
/// Errs if a count passes its limit or contradicts another, a number is not finite or out of its range, or the patches of a part do not ascend.
pub fn encode_transfer(level: &TransferLevel) -> Result<Vec<u8>, ChunkError> {
    let counts = Counts::of(level);
    check_head("encoder", level, counts)?;
    let codes = level.codes.len() as u64;
    in_range(
        "encoder",
        "codes",
        codes,
        (counts.nodes * counts.parts) as u64,
        (counts.nodes * counts.parts) as u64,
    )?;
    check("encoder", level)?;
    let mut writer = ContainerWriter::new(TRANSFER_CHUNK);
    for (id, raw) in SECTIONS.into_iter().zip([parts(level), patches(level), glows(level), packed(level)]) {
        writer.push(id, &raw)?;
    }
    let mut head = Vec::new();
    let numbers = [level.level, level.nodes, counts.parts as u32, counts.patches as u32, counts.glows as u32];
    numbers.iter().for_each(|number| head.extend_from_slice(&number.to_le_bytes()));
    put_f32s(&mut head, level.box_m.as_flattened());
    Ok(writer.finish(&head)?.0)
}

fn check_head(section: &'static str, level: &TransferLevel, counts: Counts) -> Result<(), ChunkError> {
    in_range(section, "level", level.level.into(), 0, u64::from(LEVELS) - 1)?;
    in_range(section, "nodes", level.nodes.into(), NODES_MIN.into(), NODES_MAX.into())?;
    in_range(section, "parts", counts.parts as u64, 0, PARTS_MAX as u64)?;
    in_range(section, "patches", counts.patches as u64, 0, PATCHES_MAX as u64)?;
    in_range(section, "glows", counts.glows as u64, 0, GLOWS_MAX as u64)?;
    all_numbers(section, "box", level.box_m.as_flattened(), "-1e6..=1e6 m", |x| (-1e6..=1e6).contains(&x))?;
    let [low, high] = level.box_m;
    let edges: Vec<f32> = low.iter().zip(high).map(|(low, high)| high - low).collect();
    all_numbers(section, "edges of the box", &edges, "0 m or more", |x| x >= 0.0)?;
    let longest = edges.iter().fold(0.0_f32, |longest, edge| longest.max(*edge));
    all_numbers(section, "longest edge of the box", &[longest], "more than 1e-6 m", |x| x > 1e-6)?;
    let farthest = level.box_m.as_flattened().iter().fold(0.0_f32, |most, at| most.max(at.abs()));
    let is_near = |share: f32| share >= NEAREST;
    all_numbers(
        section,
        "longest edge of the box over its farthest place",
        &[longest / farthest],
        "0.001 or more",
        is_near,
    )
}

fn check(section: &'static str, level: &TransferLevel) -> Result<(), ChunkError> {
    for part in &level.parts {
        let keys: Vec<PatchKey> = part.patches.iter().map(|patch| patch.key).collect();
        all_ascending(section, "patch", &keys)?;
        if let Some(key) = keys.iter().find(|key| key.sky().is_some() || key.is_difference()) {
            in_range(section, "patch key", key.0, 0, 0)?;
        }
        let shares: Vec<f32> = part.patches.iter().map(|patch| patch.share).collect();
        all_numbers(section, "share of a patch", &shares, "0..=1", |x| (0.0..=1.0).contains(&x))?;
        for glow in &part.glows {
            all_numbers(section, "share of a glow", &glow.share, "0 or more", |x| x >= 0.0 && x.is_finite())?;
        }
        all_numbers(section, "middle", &part.middle_m, "-1e6..=1e6 m", |x| (-1e6..=1e6).contains(&x))?;
        let [x, y, z, offset] = part.plane;
        let square = x * x + y * y + z * z;
        let is_unit = |square: f32| square == 0.0 || (0.98..=1.02).contains(&square);
        all_numbers(section, "square of a plane's normal", &[square], "0 or 1", is_unit)?;
        all_numbers(section, "offset of a plane", &[offset], "-2e6..=2e6 m", |x| (-2e6..=2e6).contains(&x))?;
        all_numbers(section, "step", &part.steps, "0..=0.1", |x| (0.0..=0.1).contains(&x))?;
    }
    if level.codes.as_flattened().contains(&i8::MIN) {
        in_range(section, "code", 128, 0, 127)?;
    }
    Ok(())
}

fn parts(level: &TransferLevel) -> Vec<u8> {
    let mut raw = Vec::new();
    ints::put_u32s(&mut raw, &level.parts.iter().map(|part| part.patches.len() as u32).collect::<Vec<_>>());
    ints::put_u32s(&mut raw, &level.parts.iter().map(|part| part.glows.len() as u32).collect::<Vec<_>>());
    for part in &level.parts {
        put_f32s(&mut raw, &part.middle_m);
        put_f32s(&mut raw, &part.plane);
        put_f32s(&mut raw, &part.steps);
    }
    raw
}

fn patches(level: &TransferLevel) -> Vec<u8> {
    let all = || level.parts.iter().flat_map(|part| &part.patches);
    let mut raw = Vec::new();
    put_u64s(&mut raw, &all().map(|patch| patch.key.0).collect::<Vec<_>>());
    put_f32s(&mut raw, &all().map(|patch| patch.share).collect::<Vec<_>>());
    raw
}

fn glows(level: &TransferLevel) -> Vec<u8> {
    let all = || level.parts.iter().flat_map(|part| &part.glows);
    let mut raw = Vec::new();
    ints::put_u32s(&mut raw, &all().map(|glow| glow.emitter.into()).collect::<Vec<_>>());
    put_f32s(&mut raw, &all().flat_map(|glow| glow.share).collect::<Vec<_>>());
    raw
}

/// Each component of a part by itself, each code less what its seven neighbours before it say ([Ibarria2003]).
fn packed(level: &TransferLevel) -> Vec<u8> {
    let mut raw = Vec::with_capacity(4 * level.codes.len());
    for part in 0..level.parts.len() {
        let codes = level.codes_of(part);
        for component in 0..4 {
            let at = |index: usize| codes[index][component];
            raw.extend(
                (0..codes.len())
                    .map(|index| at(index).wrapping_sub(predicted(level.nodes as usize, index, at)) as u8),
            );
        }
    }
    raw
}

fn unpacked(raw: &[u8], counts: Counts, side: usize) -> Vec<[i8; 4]> {
    let mut codes = vec![[0; 4]; counts.nodes * counts.parts];
    let by_component = raw.chunks_exact(counts.nodes).enumerate();
    for (number, residues) in by_component {
        let (part, component) = (number / 4, number % 4);
        let own = &mut codes[part * counts.nodes..(part + 1) * counts.nodes];
        for (index, residue) in residues.iter().enumerate() {
            let before = predicted(side, index, |index| own[index][component]);
            own[index][component] = before.wrapping_add(*residue as i8);
        }
    }
    codes
}

/// The number of a node that a cube of its neighbours before it has: that of a function that is linear along some axis.
fn predicted(side: usize, index: usize, at: impl Fn(usize) -> i8) -> i8 {
    let strides = [1, side, side * side];
    let place = [index % side, index / side % side, index / (side * side)];
    let mut sum = 0_i8;
    for corner in 1..8_usize {
        let is_before = |axis: usize| corner >> axis & 1 == 1;
        if (0..3).any(|axis| is_before(axis) && place[axis] == 0) {
            continue;
        }
        let back: usize = (0..3).filter(|axis| is_before(*axis)).map(|axis| strides[axis]).sum();
        let number = at(index - back);
        sum = if corner.count_ones() % 2 == 1 { sum.wrapping_add(number) } else { sum.wrapping_sub(number) };
    }
    sum
}

/// Decodes a level.
pub fn decode_transfer(bytes: &[u8]) -> Result<TransferLevel, ChunkError> {
    let container = Container::whole(TRANSFER_CHUNK, bytes)?;
    let mut reader = Reader::new(HEAD, container.head);
    let [level, nodes] = [reader.u32("level")?, reader.u32("nodes")?];
    let [parts, patches, glows] = [reader.u32("parts")?, reader.u32("patches")?, reader.u32("glows")?];
    let numbers = reader.f32s("box", 6)?;
    reader.end()?;
    let mut box_m = [[0.0; 3]; 2];
    box_m.as_flattened_mut().copy_from_slice(&numbers);
    let mut found = TransferLevel { level, nodes, box_m, ..TransferLevel::default() };
    let [parts, patches, glows] = [parts, patches, glows].map(|count| count as usize);
    check_head(HEAD, &found, Counts { nodes: 0, parts, patches, glows })?;
    let counts = Counts { nodes: found.node_count(), parts, patches, glows };
    container.check_sections(&SECTIONS)?;
    let most = counts.bytes_max();
    container.check_expansion(most.iter().sum())?;
    read_parts(&container.section(0, "parts", most[0])?, &mut found, counts)?;
    read_patches(&container.section(1, "patches", most[1])?, &mut found, counts)?;
    read_glows(&container.section(2, "glows", most[2])?, &mut found, counts)?;
    let raw = container.section(3, "codes", most[3])?;
    let mut reader = Reader::new("codes", &raw);
    let residues = reader.take("codes", counts.nodes * counts.parts, 4)?;
    reader.end()?;
    found.codes = unpacked(residues, counts, nodes as usize);
    check("transfer", &found)?;
    Ok(found)
}

/// Parts with as many patches and glows as they have, all of which are yet to be read.
fn read_parts(raw: &[u8], found: &mut TransferLevel, counts: Counts) -> Result<(), ChunkError> {
    let mut reader = Reader::new("parts", raw);
    let patches = ints::take_u32s(&mut reader, "patches of a part", counts.parts)?;
    let glows = ints::take_u32s(&mut reader, "glows of a part", counts.parts)?;
    for (what, all, wanted) in
        [("patches of parts", &patches, counts.patches), ("glows of parts", &glows, counts.glows)]
    {
        let sum = all.iter().map(|count| u64::from(*count)).sum();
        in_range("parts", what, sum, wanted as u64, wanted as u64)?;
    }
    let none = (PartPatch { key: PatchKey(0), share: 0.0 }, PartGlow { emitter: 0, share: [0.0; 3] });
    for (patches, glows) in patches.into_iter().zip(glows) {
        let mut part = TransferPart {
            patches: vec![none.0; patches as usize],
            glows: vec![none.1; glows as usize],
            ..TransferPart::default()
        };
        for number in &mut part.middle_m {
            *number = reader.f32("middle")?;
        }
        for number in &mut part.plane {
            *number = reader.f32("plane")?;
        }
        for number in &mut part.steps {
            *number = reader.f32("step")?;
        }
        found.parts.push(part);
    }
    reader.end()
}

fn read_patches(raw: &[u8], found: &mut TransferLevel, counts: Counts) -> Result<(), ChunkError> {
    let mut reader = Reader::new("patches", raw);
    let keys = reader.u64s("key", counts.patches)?;
    let shares = reader.f32s("share", counts.patches)?;
    let own = found.parts.iter_mut().flat_map(|part| &mut part.patches);
    own.zip(keys.into_iter().zip(shares))
        .for_each(|(patch, (key, share))| *patch = PartPatch { key: PatchKey(key), share });
    reader.end()
}

fn read_glows(raw: &[u8], found: &mut TransferLevel, counts: Counts) -> Result<(), ChunkError> {
    let mut reader = Reader::new("glows", raw);
    let emitters = ints::take_u32s(&mut reader, "emitter", counts.glows)?;
    let shares = reader.f32s("share", 3 * counts.glows)?;
    reader.end()?;
    let own = found.parts.iter_mut().flat_map(|part| &mut part.glows);
    for (glow, (emitter, share)) in own.zip(emitters.into_iter().zip(shares.chunks_exact(3))) {
        let emitter = in_range("glows", "emitter", emitter.into(), 0, u16::MAX.into())? as u16;
        *glow = PartGlow { emitter, share: [share[0], share[1], share[2]] };
    }
    Ok(())
}
