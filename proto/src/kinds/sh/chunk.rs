//! Batches of probes: positions, and what each relight ray meets, in groups of rays so that a prefix of the chunk is a
//! batch with a power of two fewer rays.

use std::ops::Range;

use serde_json::{Value, json};

use super::content::{Probe, ProbeBatch, RelightHit};
use crate::chunk::bytes::{Reader, put_f32s, put_u64s};
use crate::chunk::container::{Container, ContainerWriter, SectionId};
use crate::chunk::error::{all_finite, all_numbers, in_range};
use crate::chunk::limits::BLOCKS_MAX;
use crate::chunk::{ChunkError, ChunkKind, ChunkRow, ascending, ascending_keys, ints, morton, normal_code};
use crate::content::BlockKey;
use crate::harmonics::relight_direction;

/// Most probes in a batch.
pub const BATCH_PROBES_MAX: usize = 16_384;
/// Most relight rays of a probe; always a power of two.
pub const RELIGHT_RAYS_MAX: usize = 16_384;
/// Most hits in a batch: probes × rays.
pub const HITS_MAX: usize = 1 << 24;

/// A batch of probes with what their relight rays meet.
pub const PROBES: ChunkKind = ChunkKind(2);

/// Its row in the table of chunk kinds.
pub const ROW: ChunkRow = ChunkRow {
    kind: PROBES,
    name: "probes",
    sections: &[(tags::BASE, "base"), (tags::HITS, "hits")],
    describe,
    layers: None,
};

fn describe(bytes: &[u8]) -> Result<Value, ChunkError> {
    let batch = decode_probe_batch(bytes)?;
    let count = |wanted: fn(&RelightHit) -> bool| batch.hits.iter().filter(|hit| wanted(hit)).count();
    Ok(json!({
        "probes": batch.probes.len(),
        "relight_rays": batch.relight_rays,
        "blocks": batch.blocks.len(),
        "hits_receiver": count(|hit| matches!(hit, RelightHit::Receiver { .. })),
        "hits_sky": count(|hit| matches!(hit, RelightHit::Sky)),
        "hits_dark": count(|hit| matches!(hit, RelightHit::Dark)),
    }))
}

/// Section tags of probe chunks.
pub(crate) mod tags {
    /// Keys, positions and radii. Part: 0, 0, 0.
    pub const BASE: u8 = 1;
    /// Hits of a group of rays. Part: group, 0, 0.
    pub const HITS: u8 = 2;
}

/// Bytes of a probe chunk's head.
const PROBES_HEAD_BYTES: usize = 12;
/// Groups of rays: [0, K/4), [K/4, K/2), [K/2, K).
pub const RAY_GROUPS: usize = 3;

/// Symbols of what a ray meets; block b is `BLOCK + b`.
const SKY: u32 = 0;
const DARK: u32 = 1;
const BLOCK: u32 = 2;

/// Rays of group `group` of `rays` (a power of two).
fn rays_of(group: usize, rays: usize) -> Range<usize> {
    [0..rays / 4, rays / 4..rays / 2, rays / 2..rays][group].clone()
}

/// Encodes a batch; probes are stored ascending by key, blocks too. Nothing is lost.
///
/// Errs if the rays are no power of two, arrays disagree in length, two probes share a key, or a limit is passed.
pub fn encode_probe_batch(batch: &ProbeBatch) -> Result<Vec<u8>, ChunkError> {
    let section = "encoder";
    let rays = batch.relight_rays as usize;
    in_range(section, "probes", batch.probes.len() as u64, 0, BATCH_PROBES_MAX as u64)?;
    check_rays(section, batch.relight_rays)?;
    let hits = batch.probes.len() * rays;
    in_range(section, "hits", batch.hits.len() as u64, hits as u64, hits.min(HITS_MAX) as u64)?;
    let positions: Vec<f32> = batch.probes.iter().flat_map(|probe| probe.position_m).collect();
    all_finite(section, "position", &positions)?;
    let radii: Vec<f32> = batch.probes.iter().map(|probe| probe.radius_m).collect();
    all_numbers(section, "radius", &radii, "above 0", |radius| radius > 0.0 && radius.is_finite())?;

    let (probes, source) = ascending(&batch.probes, "probe", |probe| probe.key)?;
    let (blocks, index_of) = used_blocks(batch)?;
    let mut writer = ContainerWriter::new(PROBES);
    writer.push(SectionId::new(tags::BASE, [0; 3]), &base(&probes, &blocks))?;
    for group in 0..RAY_GROUPS {
        let order = coherent(rays_of(group, rays), batch.relight_rays);
        let in_order =
            |probe: &usize| order.iter().map(|&ray| batch.hits[probe * rays + ray]).collect::<Vec<_>>();
        let hits: Vec<RelightHit> = source.iter().flat_map(in_order).collect();
        writer.push(SectionId::new(tags::HITS, [group as u8, 0, 0]), &write_hits(&hits, &index_of))?;
    }
    let mut head = Vec::with_capacity(PROBES_HEAD_BYTES);
    for count in [probes.len(), rays, blocks.len()] {
        head.extend_from_slice(&(count as u32).to_le_bytes());
    }
    Ok(writer.finish(&head)?.0)
}

fn check_rays(section: &'static str, rays: u32) -> Result<usize, ChunkError> {
    in_range(section, "relight rays (log2 of a power of two)", u64::from(rays.count_ones()), 1, 1)?;
    in_range(section, "relight rays", rays.into(), 1, RELIGHT_RAYS_MAX as u64)
}

/// Rays of a group in the order in which they are stored: along a Z curve over the sphere's cylinder (z, φ), so that
/// one ray mostly meets what the one before it met.
fn coherent(rays: Range<usize>, count: u32) -> Vec<usize> {
    let mut keyed: Vec<(u32, usize)> = rays
        .map(|ray| {
            let code = normal_code(relight_direction(ray as u32, count).to_array());
            let cell = code.map(|w| (i32::from(w) + 32_768) as u16);
            (morton(cell), ray)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, ray)| ray).collect()
}

/// Blocks that hits name, ascending by key, and for each of the batch's blocks its index among them.
fn used_blocks(batch: &ProbeBatch) -> Result<(Vec<BlockKey>, Vec<u32>), ChunkError> {
    let section = "encoder";
    let mut used = vec![false; batch.blocks.len()];
    for hit in &batch.hits {
        if let RelightHit::Receiver { block, .. } = hit {
            let count = batch.blocks.len() as u64;
            used[in_range(section, "block index + 1", u64::from(*block) + 1, 1, count)? - 1] = true;
        }
    }
    let mut blocks: Vec<BlockKey> =
        batch.blocks.iter().zip(&used).filter(|(_, used)| **used).map(|(&key, _)| key).collect();
    blocks.sort_unstable();
    blocks.dedup();
    in_range(section, "blocks", blocks.len() as u64, 0, BLOCKS_MAX as u64)?;
    let index_of =
        batch.blocks.iter().map(|key| blocks.partition_point(|other| other < key) as u32).collect();
    Ok((blocks, index_of))
}

fn base(probes: &[Probe], blocks: &[BlockKey]) -> Vec<u8> {
    let mut out = Vec::new();
    put_u64s(&mut out, blocks);
    put_u64s(&mut out, &probes.iter().map(|probe| probe.key).collect::<Vec<_>>());
    for axis in 0..3 {
        put_f32s(&mut out, &probes.iter().map(|probe| probe.position_m[axis]).collect::<Vec<_>>());
    }
    put_f32s(&mut out, &probes.iter().map(|probe| probe.radius_m).collect::<Vec<_>>());
    out
}

/// A symbol per hit, then the texels of those that meet a receiver.
fn write_hits(hits: &[RelightHit], index_of: &[u32]) -> Vec<u8> {
    let symbols = hits.iter().map(|hit| match hit {
        RelightHit::Sky => SKY,
        RelightHit::Dark => DARK,
        RelightHit::Receiver { block, .. } => BLOCK + index_of[usize::from(*block)],
    });
    let texels = || {
        hits.iter().filter_map(|hit| match hit {
            RelightHit::Receiver { texel, .. } => Some(texel),
            _ => None,
        })
    };
    let mut out = Vec::new();
    ints::put_u32s(&mut out, &symbols.collect::<Vec<_>>());
    for axis in 0..2 {
        ints::put_deltas(&mut out, texels().map(|texel| texel[axis].into()));
    }
    out
}

/// Decodes a whole batch.
pub fn decode_probe_batch(bytes: &[u8]) -> Result<ProbeBatch, ChunkError> {
    let container = Container::whole(PROBES, bytes)?;
    Ok(decode(&container)?.0)
}

/// Decodes as many rays per probe as lie fully in `bytes`, the first bytes of a chunk of `total_len` bytes: K, K/2 or
/// K/4. Gives the batch, whose `relight_rays` is that number, and K.
///
/// Directions of a shortened batch are `relight_direction(k, K)` with the **full** K.
pub fn decode_probe_batch_prefix(bytes: &[u8], total_len: u64) -> Result<(ProbeBatch, u32), ChunkError> {
    decode(&Container::prefix(PROBES, bytes, total_len)?)
}

fn decode(container: &Container) -> Result<(ProbeBatch, u32), ChunkError> {
    let mut reader = Reader::new("probes head", container.head);
    let count = reader.u32("probes")?;
    let count = in_range("probes head", "probes", count.into(), 0, BATCH_PROBES_MAX as u64)?;
    let all_rays = reader.u32("relight rays")?;
    let rays = check_rays("probes head", all_rays)?;
    in_range("probes head", "hits", (count * rays) as u64, 0, HITS_MAX as u64)?;
    let blocks = reader.u32("blocks")?;
    let blocks = in_range("probes head", "blocks", blocks.into(), 0, BLOCKS_MAX as u64)?;
    reader.end()?;
    let hits = (0..RAY_GROUPS as u8).map(|group| SectionId::new(tags::HITS, [group, 0, 0]));
    let wanted: Vec<SectionId> = std::iter::once(SectionId::new(tags::BASE, [0; 3])).chain(hits).collect();
    container.check_sections(&wanted)?;
    let groups = container.complete.saturating_sub(1);
    // With K < 4 the first groups are empty; a batch without rays is of no use.
    let present = if groups == 0 { 0 } else { rays_of(groups - 1, rays).end };
    if present == 0 {
        let (left, wanted) = (container.present(), container.end_of(2));
        return Err(ChunkError::Truncated { section: "chunk", what: "first rays", offset: 0, wanted, left });
    }
    let max = (8 * blocks + 24 * count) as u64;
    container.check_expansion(max + (count * present * size_of::<RelightHit>()) as u64)?;
    let (blocks, probes) = read_base(&container.section(0, "base", max)?, blocks, count)?;
    let mut hits = vec![RelightHit::Dark; count * present];
    for group in 0..groups {
        let order = coherent(rays_of(group, rays), all_rays);
        let in_group = count * order.len();
        let raw = container.section(group + 1, "hits", 3 * ints::bytes_max(in_group))?;
        let mut found = read_hits(&raw, in_group, blocks.len())?.into_iter();
        for probe in 0..count {
            for (&ray, hit) in order.iter().zip(found.by_ref()) {
                hits[probe * present + ray] = hit;
            }
        }
    }
    Ok((ProbeBatch { probes, relight_rays: present as u32, blocks, hits }, all_rays))
}

fn read_base(raw: &[u8], blocks: usize, count: usize) -> Result<(Vec<BlockKey>, Vec<Probe>), ChunkError> {
    let mut reader = Reader::new("base", raw);
    let blocks = ascending_keys(&mut reader, "block", blocks)?;
    let keys = ascending_keys(&mut reader, "probe", count)?;
    let positions =
        [reader.f32s("position", count)?, reader.f32s("position", count)?, reader.f32s("position", count)?];
    let radii = reader.f32s("radius", count)?;
    all_numbers("base", "radius", &radii, "above 0", |radius| radius > 0.0)?;
    reader.end()?;
    let probe = |index: usize| Probe {
        key: keys[index],
        position_m: [positions[0][index], positions[1][index], positions[2][index]],
        radius_m: radii[index],
    };
    Ok((blocks, (0..count).map(probe).collect()))
}

fn read_hits(raw: &[u8], count: usize, blocks: usize) -> Result<Vec<RelightHit>, ChunkError> {
    let mut reader = Reader::new("hits", raw);
    let symbols = ints::take_u32s(&mut reader, "what rays meet", count)?;
    let receivers = symbols.iter().filter(|&&symbol| symbol >= BLOCK).count();
    let x = ints::take_deltas(&mut reader, "texel", receivers, 0..=65_535)?;
    let y = ints::take_deltas(&mut reader, "texel", receivers, 0..=65_535)?;
    reader.end()?;
    let mut texels = x.into_iter().zip(y).map(|(x, y)| [x as u16, y as u16]);
    let mut hits = Vec::with_capacity(count);
    for symbol in symbols {
        hits.push(match symbol {
            SKY => RelightHit::Sky,
            DARK => RelightHit::Dark,
            _ => {
                let last = blocks as u64 + 1;
                let block =
                    in_range("hits", "block symbol", symbol.into(), BLOCK.into(), last)? as u32 - BLOCK;
                RelightHit::Receiver { block: block as u16, texel: texels.next().unwrap_or_default() }
            }
        });
    }
    Ok(hits)
}
