//! The surface patches of a bake: which receivers each is the mean of.

use super::bytes::{Reader, put_u64s};
use super::cluster::ascending;
use super::cluster_decode::ascending_keys;
use super::container::{Container, ContainerWriter, SectionId};
use super::error::{ChunkError, all_ascending, in_range};
use super::ints;
use super::limits::*;
use super::table::PATCHES;
use crate::content::{AreaCode, Patch, PatchKey, PatchSet, Texel};

/// Section tags of patch chunks; part is 0, 0, 0.
pub(super) mod tags {
    /// Keys, and the leaves of each patch.
    pub const PATCHES: u8 = 1;
    /// Receivers of each leaf.
    pub const LEAVES: u8 = 2;
}

const SECTIONS: [SectionId; 2] =
    [SectionId::new(tags::PATCHES, [0; 3]), SectionId::new(tags::LEAVES, [0; 3])];

/// Encodes patches; they are stored ascending by key. Nothing is lost.
///
/// Errs if two patches share a key, a patch or a leaf is empty or out of range, or a limit is passed.
pub fn encode_patches(set: &PatchSet) -> Result<Vec<u8>, ChunkError> {
    let (patches, _) = ascending(&set.patches, "patch", |patch| patch.key)?;
    check(set)?;
    let mut writer = ContainerWriter::new(PATCHES);
    writer.push(SECTIONS[0], &write_patches(set, &patches))?;
    writer.push(SECTIONS[1], &write_leaves(set))?;
    let leaves = set.leaf_starts.len().saturating_sub(1);
    let counts = [patches.len(), leaves, set.texel.len(), set.blocks.len(), set.sky_parts as usize];
    let head: Vec<u8> = counts.iter().flat_map(|&count| (count as u32).to_le_bytes()).collect();
    Ok(writer.finish(&head)?.0)
}

/// Errs unless every index is in range and nothing is empty.
fn check(set: &PatchSet) -> Result<(), ChunkError> {
    let section = "patches";
    let leaves = set.leaf_starts.len().saturating_sub(1) as u64;
    let receivers = set.texel.len() as u64;
    check_counts(section, [set.patches.len() as u64, leaves, receivers, set.blocks.len() as u64])?;
    check_sky(section, set.sky_parts)?;
    all_ascending(section, "block", &set.blocks)?;
    in_range(section, "blocks of receivers", set.block.len() as u64, receivers, receivers)?;
    in_range(section, "areas of receivers", set.area.len() as u64, receivers, receivers)?;
    in_range(
        section,
        "start of the first leaf",
        set.leaf_starts.first().map_or(0, |&start| u64::from(start)),
        0,
        0,
    )?;
    let end = set.leaf_starts.last().map_or(0, |&end| u64::from(end));
    in_range(section, "end of the last leaf", end, receivers, receivers)?;
    for pair in set.leaf_starts.windows(2) {
        in_range(section, "end of a leaf", pair[1].into(), u64::from(pair[0]) + 1, receivers)?;
    }
    // Each level of the tree holds every leaf once at most, so that reading all patches stays cheap.
    let of_patches: u64 = set.patches.iter().map(|patch| u64::from(patch.leaf_count)).sum();
    in_range(section, "leaves of all patches together", of_patches, 0, PATCH_LEVELS_MAX * leaves)?;
    for patch in &set.patches {
        in_range(section, "level in a patch's key", patch.key.level(), 0, 14)?;
        in_range(section, "direction in a patch's key", patch.key.direction(), 0, 5)?;
        in_range(section, "leaves of a patch", patch.leaf_count.into(), 1, leaves)?;
        in_range(section, "first leaf", patch.first_leaf.into(), 0, leaves - u64::from(patch.leaf_count))?;
    }
    let blocks = set.blocks.len() as u64;
    set.block.iter().try_for_each(|&block| {
        in_range(section, "block index + 1", u64::from(block) + 1, 1, blocks).map(drop)
    })
}

fn check_counts(
    section: &'static str,
    [patches, leaves, receivers, blocks]: [u64; 4],
) -> Result<(), ChunkError> {
    in_range(section, "receivers of patches", receivers, 0, PATCH_RECEIVERS_MAX as u64)?;
    in_range(section, "leaves", leaves, 0, receivers)?;
    in_range(section, "patches", patches, 0, PATCHES_MAX as u64)?;
    in_range(section, "blocks", blocks, 0, PATCH_BLOCKS_MAX as u64).map(drop)
}

fn check_sky(section: &'static str, parts: u32) -> Result<(), ChunkError> {
    in_range(section, "parts of the sky (log2 of a power of two)", u64::from(parts.count_ones()), 1, 1)?;
    in_range(section, "parts of the sky", parts.into(), 1, SKY_PARTS_MAX as u64).map(drop)
}

fn write_patches(set: &PatchSet, patches: &[Patch]) -> Vec<u8> {
    let mut out = Vec::new();
    put_u64s(&mut out, &set.blocks);
    // Neighbours have near keys: differences are small.
    let steps = patches.iter().scan(0, |before, patch| {
        let step = patch.key.0 - *before;
        *before = patch.key.0;
        Some(step)
    });
    let (low, high): (Vec<u32>, Vec<u32>) = steps.map(|step| (step as u32, (step >> 32) as u32)).unzip();
    ints::put_u32s(&mut out, &low);
    ints::put_u32s(&mut out, &high);
    ints::put_deltas(&mut out, patches.iter().map(|patch| patch.first_leaf as i32));
    ints::put_u32s(&mut out, &patches.iter().map(|patch| patch.leaf_count - 1).collect::<Vec<_>>());
    out
}

fn write_leaves(set: &PatchSet) -> Vec<u8> {
    let mut out = Vec::new();
    let sizes = set.leaf_starts.windows(2).map(|pair| pair[1] - pair[0] - 1);
    ints::put_u32s(&mut out, &sizes.collect::<Vec<_>>());
    ints::put_deltas(&mut out, set.block.iter().map(|&block| block as i32));
    for axis in 0..2 {
        ints::put_deltas(&mut out, set.texel.iter().map(|texel| texel[axis].into()));
    }
    out.extend(set.area.iter().map(|area| area.0));
    out
}

/// Decodes patches.
pub fn decode_patches(bytes: &[u8]) -> Result<PatchSet, ChunkError> {
    let container = Container::whole(PATCHES, bytes)?;
    let mut reader = Reader::new("patches head", container.head);
    let counts = [
        reader.u32("patches")?,
        reader.u32("leaves")?,
        reader.u32("receivers")?,
        reader.u32("blocks")?,
        reader.u32("parts of the sky")?,
    ];
    reader.end()?;
    let [patches, leaves, receivers, blocks, sky_parts] = counts;
    check_counts("patches head", [patches, leaves, receivers, blocks].map(u64::from))?;
    let [patches, leaves, receivers, blocks] =
        [patches, leaves, receivers, blocks].map(|count| count as usize);
    container.check_sections(&SECTIONS)?;
    let memory = (16 * patches + 4 * leaves + 9 * receivers + 8 * blocks) as u64;
    container.check_expansion(2 * memory)?;
    let mut set = PatchSet { sky_parts, ..PatchSet::default() };
    let patch_bytes = 8 * blocks as u64 + 4 * ints::bytes_max(patches);
    read_patches(&container.section(0, "patches", patch_bytes)?, blocks, patches, leaves, &mut set)?;
    let leaf_bytes = ints::bytes_max(leaves) + 3 * ints::bytes_max(receivers) + receivers as u64;
    read_leaves(&container.section(1, "leaves", leaf_bytes)?, leaves, receivers, &mut set)?;
    check(&set)?;
    Ok(set)
}

fn read_patches(
    raw: &[u8],
    blocks: usize,
    count: usize,
    leaves: usize,
    set: &mut PatchSet,
) -> Result<(), ChunkError> {
    let mut reader = Reader::new("patches", raw);
    set.blocks = ascending_keys(&mut reader, "block", blocks)?;
    let low = ints::take_u32s(&mut reader, "key", count)?;
    let high = ints::take_u32s(&mut reader, "key", count)?;
    let first = ints::take_deltas(&mut reader, "first leaf", count, 0..=leaves as i32)?;
    let extra = ints::take_u32s(&mut reader, "leaves of a patch", count)?;
    reader.end()?;
    let mut key = 0_u64;
    for index in 0..count {
        let step = u64::from(high[index]) << 32 | u64::from(low[index]);
        let next = key.checked_add(step).filter(|_| index == 0 || step > 0);
        key = next.ok_or(ChunkError::Order { section: "patches", what: "patch", index })?;
        set.patches.push(Patch {
            key: PatchKey(key),
            first_leaf: first[index] as u32,
            leaf_count: extra[index].saturating_add(1),
        });
    }
    Ok(())
}

fn read_leaves(raw: &[u8], leaves: usize, receivers: usize, set: &mut PatchSet) -> Result<(), ChunkError> {
    let mut reader = Reader::new("leaves", raw);
    let sizes = ints::take_u32s(&mut reader, "receivers of a leaf", leaves)?;
    let block = ints::take_deltas(&mut reader, "block", receivers, 0..=PATCH_BLOCKS_MAX as i32 - 1)?;
    let x = ints::take_deltas(&mut reader, "texel", receivers, 0..=65_535)?;
    let y = ints::take_deltas(&mut reader, "texel", receivers, 0..=65_535)?;
    set.area = reader.take("area", receivers, 1)?.iter().map(|&code| AreaCode(code)).collect();
    reader.end()?;
    let mut end = 0_u64;
    set.leaf_starts.push(0);
    for size in sizes {
        end = in_range("leaves", "end of a leaf", end + u64::from(size) + 1, 1, receivers as u64)? as u64;
        set.leaf_starts.push(end as u32);
    }
    set.block = block.into_iter().map(|block| block as u32).collect();
    set.texel = x.into_iter().zip(y).map(|(x, y)| [x as u16, y as u16]).collect::<Vec<Texel>>();
    Ok(())
}
