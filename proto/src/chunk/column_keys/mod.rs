//! Sets of column keys. Those of patches and parts of the sky are a walk through the cells that hold patches, level by
//! level; others stand as they are.
//!
//! A cluster names most patches of a cut of their tree, so keys have much in common: a cell's place follows from a bit
//! of the cell around it. Bytes of one kind lie side by side, and flat surfaces of all directions have equal bytes.

use std::collections::BTreeMap;

use super::ascending_keys;
use super::bytes::{Reader, put_u64s};
use super::error::{ChunkError, all_ascending, in_range};
use super::ints::{put_deltas, put_u32s, take_deltas, take_u32s};
use crate::content::{ColumnKey, PatchKey};

/// Mode: all keys as they are.
const PLAIN: u8 = 0;
/// Mode: a walk.
const WALK: u8 = 1;
/// Mode: a walk, and which of the patches have columns of differences.
const WALK_OF_DIFFERENCES: u8 = 2;
/// Last version without columns of differences.
const LAST_WITHOUT_DIFFERENCES: u16 = 3;
/// Last version that has keys as they are, without a mode.
const LAST_WITHOUT_MODE: u16 = 2;
/// Highest level of a patch.
const LEVEL_MAX: u64 = 14;
/// Directions of patches.
const DIRECTIONS: usize = 6;
/// Cells of an axis lie in `-CELL_END..CELL_END`.
const CELL_END: i32 = 1 << 14;
/// Highest number of a patch among those of its place.
const ORDINAL_MAX: u32 = (1 << 10) - 1;
/// Code of a cell whose patches are listed.
const LISTED: u8 = 3;
/// Codes in a byte, of 2 bits each.
const CODES_PER_BYTE: usize = 4;

/// Most raw bytes that `count` keys take.
pub(super) fn keys_bytes_max(count: usize) -> u64 {
    1 + 8 * count as u64
}

/// Appends `keys`, ascending: as a walk if they can be one and it is shorter.
pub(super) fn put_keys(out: &mut Vec<u8>, keys: &[ColumnKey]) {
    let mut of_patches: Vec<PatchKey> = keys.iter().map(|&key| PatchKey(key)).collect();
    of_patches.sort_unstable_by_key(|key| key.patch());
    let named: Vec<ColumnKey> = of_patches.iter().map(|key| key.patch().0).collect();
    let is_difference: Vec<u8> = of_patches.iter().map(|key| key.is_difference().into()).collect();
    let walk = walk_of(&named).map(|mut walk| {
        let has_differences = is_difference.contains(&1);
        if has_differences {
            walk.extend(
                is_difference.chunks(8).map(|bits| bits.iter().rev().fold(0, |byte, bit| byte << 1 | bit)),
            );
        }
        (if has_differences { WALK_OF_DIFFERENCES } else { WALK }, walk)
    });
    match walk.filter(|(_, walk)| walk.len() < 8 * keys.len()) {
        Some((mode, mut walk)) => {
            out.push(mode);
            out.append(&mut walk);
        }
        None => {
            out.push(PLAIN);
            put_u64s(out, keys);
        }
    }
}

/// Reads `count` keys of a chunk of `version`, ascending; the caller has checked `count`.
pub(super) fn take_keys(
    reader: &mut Reader,
    count: usize,
    version: u16,
) -> Result<Vec<ColumnKey>, ChunkError> {
    let mode = if version > LAST_WITHOUT_MODE { reader.u8("mode of keys")? } else { PLAIN };
    let last = if version > LAST_WITHOUT_DIFFERENCES { WALK_OF_DIFFERENCES } else { WALK };
    match in_range(reader.section(), "mode of keys", mode.into(), PLAIN.into(), last.into())? as u8 {
        WALK => take_walk(reader, count),
        WALK_OF_DIFFERENCES => {
            let named = take_walk(reader, count)?;
            take_differences(reader, named)
        }
        _ => ascending_keys(reader, "column key", count),
    }
}

/// Keys of columns that read `named`, or differences where the bit of it says so.
fn take_differences(reader: &mut Reader, named: Vec<ColumnKey>) -> Result<Vec<ColumnKey>, ChunkError> {
    let section = reader.section();
    let bits = reader.take("bits of differences", named.len().div_ceil(8), 1)?;
    let column = |(index, &key): (usize, &ColumnKey)| {
        let key = PatchKey(key);
        let bit = bits[index / 8] >> (index % 8) & 1;
        let highest = u64::from(key.sky().is_none());
        in_range(section, "bit of a difference", bit.into(), 0, highest)?;
        Ok(if bit == 1 { key.difference().0 } else { key.0 })
    };
    let mut keys = named.iter().enumerate().map(column).collect::<Result<Vec<_>, ChunkError>>()?;
    let spare = bits.last().map_or(0, |last| u64::from(*last) >> (1 + (named.len() - 1) % 8));
    in_range(section, "bits past the last key", spare, 0, 0)?;
    keys.sort_unstable();
    Ok(keys)
}

/// Contents of a visited cell.
#[derive(Default)]
struct Held {
    /// A bit of each visited sub-cell.
    sub_cells: u8,
    /// Numbers of the patches of this cell and its level, ascending.
    ordinals: Vec<u32>,
}

impl Held {
    /// Number of the one patch; in cells with sub-cells 0 for none, else that number plus 1; [`LISTED`] for all others.
    fn code(&self) -> u8 {
        let inner = u32::from(self.sub_cells != 0);
        match self.ordinals[..] {
            [] => 0,
            [ordinal] if ordinal + inner < LISTED.into() => (ordinal + inner) as u8,
            _ => LISTED,
        }
    }
}

/// The walk, or none if a key is neither a patch's nor a sky part's, or if two are alike.
fn walk_of(keys: &[ColumnKey]) -> Option<Vec<u8>> {
    if !keys.is_sorted_by(|a, b| a < b) {
        return None;
    }
    let (patches, sky) = keys.split_at(keys.partition_point(|&key| PatchKey(key).level() <= LEVEL_MAX));
    if patches.iter().any(|&key| PatchKey(key).direction() >= DIRECTIONS as u64) {
        return None;
    }
    let sky = sky.iter().map(|&key| PatchKey(key).sky()).collect::<Option<Vec<u32>>>()?;
    let levels = visited(patches);
    let cells = || levels.iter().rev().flat_map(BTreeMap::values);
    let mut out = vec![levels.len() as u8 - 1];
    put_highest(&mut out, levels.last()?.keys());
    out.extend(levels[1..].iter().rev().flat_map(BTreeMap::values).map(|held| held.sub_cells));
    for inner in [false, true] {
        let codes = cells().filter(|held| (held.sub_cells != 0) == inner).map(Held::code);
        put_codes(&mut out, &codes.collect::<Vec<u8>>());
    }
    let listed: Vec<&[u32]> =
        cells().filter(|held| held.code() == LISTED).map(|held| &held.ordinals[..]).collect();
    put_u32s(&mut out, &listed.iter().map(|ordinals| ordinals.len() as u32 - 1).collect::<Vec<_>>());
    put_u32s(&mut out, &listed.into_iter().flat_map(gaps).collect::<Vec<_>>());
    put_u32s(&mut out, &gaps(&sky));
    Some(out)
}

/// Cells by level, from 0 to the highest that a patch has, each by the key of its first patch.
fn visited(patches: &[ColumnKey]) -> Vec<BTreeMap<PatchKey, Held>> {
    let highest = patches.last().map_or(0, |&key| PatchKey(key).level());
    let mut levels: Vec<BTreeMap<PatchKey, Held>> = Vec::new();
    levels.resize_with(highest as usize + 1, BTreeMap::new);
    for key in patches.iter().map(|&key| PatchKey(key)) {
        let place = PatchKey(key.0 - u64::from(key.ordinal()));
        levels[key.level() as usize].entry(place).or_default().ordinals.push(key.ordinal());
    }
    for level in 1..levels.len() {
        let (below, above) = levels.split_at_mut(level);
        for (&cell, bit) in below[level - 1].keys().map(|cell| (cell, sub_cell_of(*cell))) {
            above[0].entry(around(cell)).or_default().sub_cells |= bit;
        }
    }
    levels
}

/// Axes of a cell from the highest bit of a sub-cell's number to the lowest. That along the direction is first.
fn axes(cell: PatchKey) -> [usize; 3] {
    let along = cell.direction() as usize / 2;
    [along, (along + 1) % 3, (along + 2) % 3]
}

/// The cell of the next level around `cell`.
fn around(cell: PatchKey) -> PatchKey {
    PatchKey::of_cell(cell.level() as u32 + 1, cell.cell().map(|c| c >> 1), cell.direction() as u8, 0)
}

/// Bit of `cell` among the sub-cells of the one around it.
fn sub_cell_of(cell: PatchKey) -> u8 {
    1 << axes(cell).iter().fold(0, |number, &axis| number << 1 | cell.cell()[axis] & 1)
}

/// Sub-cell `number`, 0…7, of `cell`, whose level is 1 or more.
fn sub_cell(cell: PatchKey, number: u8) -> PatchKey {
    let mut at = cell.cell().map(|c| 2 * c);
    for (place, axis) in axes(cell).into_iter().enumerate() {
        at[axis] += i32::from(number >> (2 - place) & 1);
    }
    PatchKey::of_cell(cell.level() as u32 - 1, at, cell.direction() as u8, 0)
}

/// Appends the cells of the highest level.
fn put_highest<'a>(out: &mut Vec<u8>, cells: impl Iterator<Item = &'a PatchKey> + Clone) {
    let mut of_direction = [0; DIRECTIONS];
    cells.clone().for_each(|cell| of_direction[cell.direction() as usize] += 1);
    put_u32s(out, &of_direction);
    (0..3).for_each(|axis| put_deltas(out, cells.clone().map(|cell| cell.cell()[axis])));
}

fn put_codes(out: &mut Vec<u8>, codes: &[u8]) {
    let packed = |codes: &[u8]| codes.iter().rev().fold(0, |byte, code| byte << 2 | code);
    out.extend(codes.chunks(CODES_PER_BYTE).map(packed));
}

/// Numbers left out before each of `ascending`, since the one before.
fn gaps(ascending: &[u32]) -> Vec<u32> {
    let mut next = 0;
    ascending.iter().map(|&number| number - std::mem::replace(&mut next, number.wrapping_add(1))).collect()
}

/// Inverse of [`gaps`]; errs on numbers above `max`.
fn ascending_of(
    section: &'static str,
    what: &'static str,
    gaps: impl Iterator<Item = u32>,
    max: u32,
) -> Result<Vec<u32>, ChunkError> {
    let mut next = 0;
    let number = |gap| {
        let number = in_range(section, what, next + u64::from(gap), 0, max.into())? as u64;
        next = number + 1;
        Ok(number as u32)
    };
    gaps.map(number).collect()
}

/// Errs unless the sub-cells of `cell` lie on their lattice.
fn check_divisible(section: &'static str, cell: PatchKey) -> Result<(), ChunkError> {
    cell.cell().into_iter().try_for_each(|c| {
        let place = (c + CELL_END) as u64;
        let half = CELL_END as u64 / 2;
        in_range(section, "place of a divided cell + 2¹⁴", place, half, 3 * half - 1).map(drop)
    })
}

/// Reads a walk to `count` keys: patches of all visited cells, and as many sky parts as are left. Each visited cell holds
/// a patch at least, so no level has more cells.
fn take_walk(reader: &mut Reader, count: usize) -> Result<Vec<ColumnKey>, ChunkError> {
    let section = reader.section();
    let cells = take_cells(reader, count)?;
    let (mut keys, listed) = take_single(reader, cells)?;
    let more = take_u32s(reader, "patches of a cell", listed.len())?;
    let in_lists = more.iter().map(|&more| u64::from(more) + 1).sum();
    let left = count.saturating_sub(keys.len());
    in_range(section, "patches", keys.len() as u64, 0, count as u64)?;
    let in_lists = in_range(section, "listed patches", in_lists, 0, left as u64)?;
    let mut lists = take_u32s(reader, "number of a patch", in_lists)?.into_iter();
    for (cell, more) in listed.into_iter().zip(more) {
        let list = lists.by_ref().take(more as usize + 1);
        let ordinals = ascending_of(section, "number of a patch", list, ORDINAL_MAX)?;
        keys.extend(ordinals.into_iter().map(|ordinal| cell.0 + u64::from(ordinal)));
    }
    let sky = take_u32s(reader, "part of the sky", left - in_lists)?;
    let sky = ascending_of(section, "part of the sky", sky.into_iter(), u32::MAX)?;
    keys.extend(sky.into_iter().map(|part| PatchKey::of_sky(part).0));
    keys.sort_unstable();
    Ok(keys)
}

/// Reads the visited cells, from the highest level down, each with a bit of each sub-cell.
fn take_cells(reader: &mut Reader, count: usize) -> Result<Vec<(PatchKey, u8)>, ChunkError> {
    let section = reader.section();
    let mut cells = take_highest(reader, count)?;
    let mut visited = Vec::new();
    while cells.first().is_some_and(|cell| cell.level() > 0) {
        let bits = reader.take("sub-cells", cells.len(), 1)?;
        let below = bits.iter().map(|bits| u64::from(bits.count_ones())).sum();
        let mut sub_cells =
            Vec::with_capacity(in_range(section, "cells of a level", below, 0, count as u64)?);
        for (cell, &bits) in cells.into_iter().zip(bits) {
            if bits != 0 {
                check_divisible(section, cell)?;
            }
            let inside = (0..8).filter(|number| bits >> number & 1 == 1);
            sub_cells.extend(inside.map(|number| sub_cell(cell, number)));
            visited.push((cell, bits));
        }
        sub_cells.sort_unstable();
        cells = sub_cells;
    }
    visited.extend(cells.into_iter().map(|cell| (cell, 0)));
    Ok(visited)
}

/// Reads the cells of the highest level, ascending.
fn take_highest(reader: &mut Reader, count: usize) -> Result<Vec<PatchKey>, ChunkError> {
    let section = reader.section();
    let level = in_range(section, "highest level", reader.u8("highest level")?.into(), 0, LEVEL_MAX)?;
    let of_direction = take_u32s(reader, "cells of a direction", DIRECTIONS)?;
    let total = of_direction.iter().map(|&cells| u64::from(cells)).sum();
    let total = in_range(section, "cells of the highest level", total, 0, count as u64)?;
    let mut places = || take_deltas(reader, "place of a cell", total, -CELL_END..=CELL_END - 1);
    let places = [places()?, places()?, places()?];
    let directions = (0..).zip(of_direction).flat_map(|(of, cells)| std::iter::repeat_n(of, cells as usize));
    let cell = |(index, direction)| {
        let at = places.each_ref().map(|axis: &Vec<i32>| axis[index]);
        PatchKey::of_cell(level as u32, at, direction, 0)
    };
    let cells: Vec<PatchKey> = directions.enumerate().map(cell).collect();
    all_ascending(section, "cell", &cells)?;
    Ok(cells)
}

/// Reads the codes of `cells`: keys of cells with one patch, and cells whose patches are listed.
fn take_single(
    reader: &mut Reader,
    cells: Vec<(PatchKey, u8)>,
) -> Result<(Vec<ColumnKey>, Vec<PatchKey>), ChunkError> {
    let inner = cells.iter().filter(|(_, sub_cells)| *sub_cells != 0).count();
    let mut codes = [take_codes(reader, cells.len() - inner)?, take_codes(reader, inner)?];
    let (mut keys, mut listed) = (Vec::new(), Vec::new());
    for (cell, sub_cells) in cells {
        let inner = u8::from(sub_cells != 0);
        match codes[usize::from(inner)].next().unwrap_or_default() {
            LISTED => listed.push(cell),
            code => keys.extend(code.checked_sub(inner).map(|ordinal| cell.0 + u64::from(ordinal))),
        }
    }
    Ok((keys, listed))
}

/// Reads `count` codes.
fn take_codes<'a>(
    reader: &mut Reader<'a>,
    count: usize,
) -> Result<impl Iterator<Item = u8> + use<'a>, ChunkError> {
    let packed = reader.take("codes of cells", count.div_ceil(CODES_PER_BYTE), 1)?;
    let codes = |byte: &u8| [0, 2, 4, 6].map(|shift| *byte >> shift & LISTED);
    Ok(packed.iter().flat_map(codes))
}

#[cfg(test)]
mod tests;
