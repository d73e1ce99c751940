//! Chunks of voxels: elements of a region or of the top, level by level, so that a prefix of the chunk is its coarse levels.

use std::cmp::Reverse;

use serde_json::{Map, Value, json};

use super::columns::{LevelCounts, SECTIONS, placed, read_level, write_level};
use super::content::{BRICK_VOXELS, BRICKS_MAX, Brick, Element, Glow, LEVELS_MAX, VoxelPart};
use super::head::{GLOWS_MAX, Head, PART_BRICKS_MAX, PART_ELEMENTS_MAX, check_side, tags};
use super::place::{CELLS_MAX, Lattices, PatchPlace, check_key};
use crate::chunk::bytes::Reader;
use crate::chunk::container::{Container, ContainerWriter, check_expansion};
use crate::chunk::error::{all_ascending, all_numbers, in_range};
use crate::chunk::{ChunkError, ChunkKind, ChunkRow, ints};
use crate::manifest::Layer;

/// Elements of a region, or of the top.
pub const VOXELS_CHUNK: ChunkKind = ChunkKind(9);

/// Its row in the table of chunk kinds.
pub const ROW: ChunkRow = ChunkRow {
    kind: VOXELS_CHUNK,
    name: "voxels",
    sections: &[
        (tags::GLOWS, "glows"),
        (tags::BRICKS, "bricks"),
        (tags::NORMALS, "normals"),
        (tags::PLANES, "planes"),
        (tags::PATCHES, "patches"),
        (tags::BITS, "bits"),
    ],
    describe,
    layers: Some(voxel_layers),
};

/// Names of a level's sections.
const NAMES: [&str; SECTIONS] = ["bricks", "normals", "planes", "patches", "bits"];

fn describe(bytes: &[u8]) -> Result<Value, ChunkError> {
    let part = decode_voxels(bytes)?;
    let layers = voxel_layers(bytes, bytes.len() as u64)?;
    let mut levels = Map::new();
    let mut before = 0;
    for (bricks, layer) in by_level(&part.bricks).zip(&layers) {
        let LevelCounts { level, bricks, voxels, elements } = LevelCounts::of(bricks);
        let of_level = json!({
            "bricks": bricks, "voxels": voxels, "elements": elements, "bytes": layer.bytes - before,
        });
        before = layer.bytes;
        levels.insert(level.to_string(), of_level);
    }
    let elements = part.elements();
    Ok(json!({
        "voxel_m": part.voxel_m,
        "bricks": part.bricks.len(),
        "elements": elements,
        "dark elements": all_elements(&part).filter(|element| element.patch.is_none()).count(),
        "bytes an element": bytes.len() as f64 / elements.max(1) as f64,
        "glows": part.glows.len(),
        "levels": levels,
    }))
}

fn all_elements(part: &VoxelPart) -> impl Iterator<Item = &Element> {
    part.bricks.iter().flat_map(|brick| &brick.elements)
}

/// Bricks of each level.
fn by_level(bricks: &[Brick]) -> impl Iterator<Item = &[Brick]> {
    bricks.chunk_by(|a, b| a.key.level == b.key.level)
}

/// Encodes elements, which keep their order. Nothing is lost.
///
/// Errs if bricks or voxels are not in order or hold nothing, an element has no bits, a patch's key is not that of a patch, a place in
/// the table of what elements emit is not there, a number is not finite or out of its range, or a limit is passed.
pub fn encode_voxels(part: &VoxelPart) -> Result<Vec<u8>, ChunkError> {
    check("encoder", part)?;
    packed(part)
}

/// The chunk of elements that have been checked.
pub(super) fn packed(part: &VoxelPart) -> Result<Vec<u8>, ChunkError> {
    let cells = best_cells(part);
    let levels = by_level(&part.bricks).map(LevelCounts::of).collect();
    let head = Head { voxel_m: part.voxel_m, glows: part.glows.len(), cells, levels };
    let mut ids = head.sections().into_iter();
    let mut writer = ContainerWriter::new(VOXELS_CHUNK);
    let mut push = |raw: &[u8]| ids.next().map_or(Ok(()), |id| writer.push(id, raw));
    push(&write_glows(&part.glows))?;
    for bricks in by_level(&part.bricks) {
        for raw in write_level(bricks, cells) {
            push(&raw)?;
        }
    }
    let (bytes, _) = writer.finish(&head.write())?;
    check_expansion("encoder", head.decoded_bytes(&head.levels), bytes.len() as u64)?;
    Ok(bytes)
}

/// Cells of patches along a side of their level's voxels, by which most patches lie in their elements' voxels.
fn best_cells(part: &VoxelPart) -> u32 {
    let inside = |cells: u32| -> usize {
        let of_brick = |brick: &Brick| {
            let lattices = Lattices { level: brick.key.level, cells };
            let places = placed(brick).map(|(voxel, of)| PatchPlace::of(of.patch, lattices, voxel));
            places.filter(|place| matches!(place, PatchPlace::Column { .. })).count()
        };
        part.bricks.iter().map(of_brick).sum()
    };
    // Of equal counts the least.
    (1..=CELLS_MAX).rev().max_by_key(|&cells| inside(cells)).unwrap_or(1)
}

/// Errs unless all is in order, in range and of use.
fn check(section: &'static str, part: &VoxelPart) -> Result<(), ChunkError> {
    check_side(section, part.voxel_m)?;
    in_range(section, "glows", part.glows.len() as u64, 0, GLOWS_MAX as u64)?;
    for Glow { share, .. } in &part.glows {
        all_numbers(section, "share of a glow", share, "0 or more", |x| x >= 0.0 && x.is_finite())?;
    }
    in_range(section, "bricks", part.bricks.len() as u64, 0, PART_BRICKS_MAX as u64)?;
    in_range(section, "elements", part.elements() as u64, 0, PART_ELEMENTS_MAX as u64)?;
    let order: Vec<_> = part.bricks.iter().map(|brick| (Reverse(brick.key.level), brick.key)).collect();
    all_ascending(section, "brick", &order)?;
    part.bricks.iter().try_for_each(|brick| check_brick(section, brick, part.glows.len() as u64))
}

fn check_brick(section: &'static str, brick: &Brick, glows: u64) -> Result<(), ChunkError> {
    in_range(section, "level", brick.key.level.into(), 0, u64::from(LEVELS_MAX) - 1)?;
    for at in brick.key.cell().to_array() {
        in_range(section, "cell of a brick", at.unsigned_abs().into(), 0, BRICKS_MAX.unsigned_abs().into())?;
    }
    let places = BRICK_VOXELS.pow(3) as u64;
    in_range(section, "voxels of a brick", brick.voxels.len() as u64, 1, places)?;
    all_ascending(section, "voxel", &brick.voxels.iter().map(|voxel| voxel.place).collect::<Vec<_>>())?;
    let mut elements = 0;
    for voxel in &brick.voxels {
        in_range(section, "voxel", voxel.place.into(), 0, places - 1)?;
        elements +=
            in_range(section, "elements of a voxel", voxel.elements.into(), 1, u16::MAX.into())? as u64;
    }
    in_range(section, "elements of a brick", brick.elements.len() as u64, elements, elements)?;
    for Element { normal, bits, patch, glow, .. } in &brick.elements {
        for at in normal.0 {
            in_range(section, "normal", at.unsigned_abs().into(), 0, i16::MAX as u64)?;
        }
        in_range(section, "bits of an element", u64::from(bits.count_ones()), 1, 64)?;
        in_range(section, "glow", (*glow).into(), 0, glows)?;
        patch.map_or(Ok(()), |key| check_key(section, key))?;
    }
    Ok(())
}

fn write_glows(glows: &[Glow]) -> Vec<u8> {
    let mut out = Vec::new();
    ints::put_u32s(&mut out, &glows.iter().map(|glow| glow.emitter.into()).collect::<Vec<_>>());
    for channel in 0..3 {
        let shares: Vec<f32> = glows.iter().map(|glow| glow.share[channel]).collect();
        ints::put_f32_planes(&mut out, &shares);
    }
    out
}

fn read_glows(raw: &[u8], count: usize) -> Result<Vec<Glow>, ChunkError> {
    let mut reader = Reader::new("glows", raw);
    let emitters = ints::take_u32s(&mut reader, "emitter", count)?;
    let mut glows = Vec::with_capacity(count);
    for emitter in emitters {
        let emitter = in_range("glows", "emitter", emitter.into(), 0, u16::MAX.into())? as u16;
        glows.push(Glow { emitter, share: [0.0; 3] });
    }
    for channel in 0..3 {
        let shares = ints::take_f32_planes(&mut reader, "share", count)?;
        glows.iter_mut().zip(shares).for_each(|(glow, share)| glow.share[channel] = share);
    }
    reader.end()?;
    Ok(glows)
}

/// Decodes elements.
pub fn decode_voxels(bytes: &[u8]) -> Result<VoxelPart, ChunkError> {
    let container = Container::whole(VOXELS_CHUNK, bytes)?;
    Ok(decode(&container, bytes.len() as u64)?.0)
}

/// Decodes the levels that lie fully in `bytes`, the first bytes of a chunk of `total_len` bytes, from the coarsest; `Layer::bytes` is the
/// length of as many levels. Errs if not even the coarsest is there.
pub fn decode_voxels_prefix(bytes: &[u8], total_len: u64) -> Result<(VoxelPart, Layer), ChunkError> {
    decode(&Container::prefix(VOXELS_CHUNK, bytes, total_len)?, total_len)
}

/// Layers of a chunk of voxels, one for each of its levels, from its first bytes: header, head and section table must be there.
pub fn voxel_layers(bytes: &[u8], total_len: u64) -> Result<Vec<Layer>, ChunkError> {
    let container = Container::prefix(VOXELS_CHUNK, bytes, total_len)?;
    let head = Head::read(container.head)?;
    container.check_sections(&head.sections())?;
    Ok((head.levels.len().min(1)..=head.levels.len())
        .map(|levels| layer(&container, &head, levels))
        .collect())
}

/// The layer of the first `levels` levels.
fn layer(container: &Container, head: &Head, levels: usize) -> Layer {
    let level = head.levels[..levels].last().map_or(0, |counts| counts.level);
    Layer { bytes: container.end_of(Head::sections_of(levels)), level, bands: 0, rank: 0 }
}

fn decode(container: &Container, total_len: u64) -> Result<(VoxelPart, Layer), ChunkError> {
    let head = Head::read(container.head)?;
    container.check_sections(&head.sections())?;
    let fewest = Head::sections_of(head.levels.len().min(1));
    if container.complete < fewest {
        let (wanted, left) = (container.end_of(fewest).min(total_len), container.present());
        return Err(ChunkError::Truncated {
            section: "chunk",
            what: "coarsest level",
            offset: 0,
            wanted,
            left,
        });
    }
    let levels = &head.levels[..(container.complete - 1) / SECTIONS];
    container.check_expansion(head.decoded_bytes(levels))?;
    let glows = container.section(0, "glows", 4 * ints::bytes_max(head.glows))?;
    let glows = read_glows(&glows, head.glows)?;
    let mut bricks = Vec::new();
    for (index, counts) in levels.iter().enumerate() {
        let mut sections = std::array::from_fn(|_| Vec::new());
        for (at, (section, bytes_max)) in sections.iter_mut().zip(counts.bytes_max()).enumerate() {
            *section = container.section(Head::sections_of(index) + at, NAMES[at], bytes_max)?;
        }
        bricks.extend(read_level(*counts, &sections, head.cells)?);
    }
    let part = VoxelPart { voxel_m: head.voxel_m, glows, bricks };
    check("voxels", &part)?;
    Ok((part, layer(container, &head, levels.len())))
}
