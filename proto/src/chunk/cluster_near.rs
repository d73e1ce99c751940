//! Near hits of a cluster chunk: of receivers in narrow places, points that light is read at one by one.

use std::ops::Range;

use super::bytes::{Reader, put_u64s};
use super::cluster_decode::ascending_keys;
use super::error::{ChunkError, all_finite, all_numbers, in_range};
use super::ints;
use super::limits::{BLOCKS_MAX, NEAR_HITS_MAX};
use super::numbers::{albedo_code, albedo_of, normal_code, normal_of};
use super::order::{Arrangement, morton};
use crate::content::{BlockKey, ClusterTransport, NearHits, NearSurface, Texel};

/// Largest offset: the reach.
const OFFSET_MAX: i32 = NearHits::STEPS as i32;
/// Last version whose offsets are stored in single steps.
const LAST_IN_STEPS: u16 = 3;
/// Largest code of a normal's axis.
const NORMAL_CODE_MAX: i32 = 32_767;
/// Code of the whole hemisphere's weight π.
const WEIGHT_CODE_MAX: u32 = 65_535;
/// Largest error of the weight of near hits.
pub const NEAR_WEIGHT_ERROR: f32 = 0.5001 * std::f32::consts::PI / WEIGHT_CODE_MAX as f32;
/// Longest reach in metres.
const REACH_MAX_M: f32 = 1e4;
/// Memory that a decoded hit takes.
pub(super) const HIT_BYTES: u64 = (size_of::<NearSurface>() + size_of::<[i16; 3]>()) as u64;

/// A hit as it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Code {
    surface: SurfaceCode,
    /// From the receiver, in stored steps.
    offset: [i16; 3],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum SurfaceCode {
    Texel { block: u16, morton: u32, texel: Texel },
    Own { normal: [i16; 2], albedo: [u8; 3] },
}

/// Near hits in stored order.
pub(super) struct StoredNear {
    reach_m: f32,
    blocks: Vec<BlockKey>,
    /// Of each receiver in stored order.
    weights: Vec<u32>,
    hits: Vec<Vec<Code>>,
}

impl StoredNear {
    /// The hits of a cluster whose receivers are stored in the order of `arrangement`; `None` if there are none. Errs if arrays disagree
    /// or a number is out of its range.
    pub fn of(cluster: &ClusterTransport, arrangement: &Arrangement) -> Result<Option<Self>, ChunkError> {
        let near = &cluster.near;
        if near.is_empty() {
            return Ok(None);
        }
        check(near, cluster.receivers.len())?;
        let key_of = |surface: &NearSurface| match surface {
            NearSurface::Texel { block, .. } => near.blocks.get(usize::from(*block)).copied(),
            NearSurface::Own { .. } => None,
        };
        let mut blocks: Vec<BlockKey> = near.surface.iter().filter_map(key_of).collect();
        blocks.sort_unstable();
        blocks.dedup();
        let code = |hit: usize| {
            let surface = match near.surface[hit] {
                NearSurface::Texel { block, texel } => {
                    let key = near.blocks[usize::from(block)];
                    let block = blocks.partition_point(|other| *other < key) as u16;
                    SurfaceCode::Texel { block, morton: morton(texel), texel }
                }
                NearSurface::Own { albedo, normal } => {
                    SurfaceCode::Own { normal: normal_code(normal), albedo: albedo.map(albedo_code) }
                }
            };
            Code {
                surface,
                offset: near.offset[hit].map(|steps| NearHits::stored(steps) / NearHits::STEPS_STORED),
            }
        };
        let ranges: Vec<Range<usize>> = near.ranges().collect();
        let hits = arrangement.source.iter().map(|&receiver| {
            let mut codes: Vec<Code> = ranges[receiver].clone().map(code).collect();
            codes.sort_unstable();
            codes
        });
        let hits = hits.collect();
        let weights = arrangement.source.iter().map(|&receiver| weight_code(near.weight[receiver])).collect();
        Ok(Some(Self { reach_m: near.reach_m, blocks, weights, hits }))
    }

    /// Writes the head of the first layer's section.
    pub fn begin(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.reach_m.to_le_bytes());
        out.extend_from_slice(&(self.blocks.len() as u32).to_le_bytes());
        put_u64s(out, &self.blocks);
    }

    /// Appends the hits of receivers `rows`.
    pub fn write(&self, out: &mut Vec<u8>, rows: Range<usize>) {
        let counts: Vec<u32> = self.hits[rows.clone()].iter().map(|hits| hits.len() as u32).collect();
        ints::put_u32s(out, &counts);
        let weights: Vec<u32> =
            rows.clone().filter(|&row| !self.hits[row].is_empty()).map(|row| self.weights[row]).collect();
        ints::put_u32s(out, &weights);
        let hits = || self.hits[rows.clone()].iter().flatten();
        let is_own = |hit: &Code| matches!(hit.surface, SurfaceCode::Own { .. });
        ints::put_u32s(out, &hits().map(|hit| is_own(hit).into()).collect::<Vec<_>>());
        let (mut texels, mut own): (Vec<[i32; 3]>, Vec<[i32; 5]>) = (Vec::new(), Vec::new());
        for hit in hits() {
            match hit.surface {
                SurfaceCode::Texel { block, texel: [x, y], .. } => texels.push([block, x, y].map(i32::from)),
                SurfaceCode::Own { normal: [u, v], albedo: [r, g, b] } => {
                    own.push([u.into(), v.into(), r.into(), g.into(), b.into()]);
                }
            }
        }
        for column in 0..3 {
            ints::put_deltas(out, texels.iter().map(|codes| codes[column]));
        }
        for column in 0..5 {
            ints::put_deltas(out, own.iter().map(|codes| codes[column]));
        }
        for axis in 0..3 {
            ints::put_deltas(out, hits().map(|hit| hit.offset[axis].into()));
        }
    }
}

fn check(near: &NearHits, receivers: usize) -> Result<(), ChunkError> {
    let section = "encoder";
    let same = |what, length: usize, wanted: usize| {
        in_range(section, what, length as u64, wanted as u64, wanted as u64).map(drop)
    };
    let hits = near.len();
    same("counts of near hits", near.count.len(), receivers)?;
    same("weights of near hits", near.weight.len(), receivers)?;
    same("near hits of all receivers", near.count.iter().map(|&count| usize::from(count)).sum(), hits)?;
    same("offsets of near hits", near.offset.len(), hits)?;
    in_range(section, "near hits", hits as u64, 0, NEAR_HITS_MAX as u64)?;
    for surface in &near.surface {
        match surface {
            NearSurface::Texel { block, .. } => {
                let last = near.blocks.len() as u64;
                in_range(section, "block index + 1", u64::from(*block) + 1, 1, last)?;
            }
            NearSurface::Own { albedo, normal } => {
                all_numbers(section, "albedo", albedo, "0 to below 1", |x| (0.0..1.0).contains(&x))?;
                all_finite(section, "normal", normal)?;
            }
        }
    }
    for code in near.offset.as_flattened() {
        in_range(section, "offset of a near hit", code.unsigned_abs().into(), 0, OFFSET_MAX as u64)?;
    }
    reach_in_range(section, near.reach_m)?;
    let pi = 0.0..=std::f32::consts::PI;
    all_numbers(section, "weight of near hits", &near.weight, "0 to π", |weight| pi.contains(&weight))
}

fn reach_in_range(section: &'static str, reach_m: f32) -> Result<(), ChunkError> {
    all_numbers(section, "reach of near hits", &[reach_m], "above 0 to 1e4", |reach| {
        reach > 0.0 && reach <= REACH_MAX_M
    })
}

fn weight_code(weight: f32) -> u32 {
    libm::roundf(weight / std::f32::consts::PI * WEIGHT_CODE_MAX as f32) as u32
}

/// Reads what [`StoredNear::begin`] wrote.
pub(super) fn read_begin(reader: &mut Reader, near: &mut NearHits) -> Result<(), ChunkError> {
    near.reach_m = reader.f32("reach of near hits")?;
    reach_in_range(reader.section(), near.reach_m)?;
    let blocks = reader.u32("blocks of near hits")?;
    let blocks = in_range(reader.section(), "blocks of near hits", blocks.into(), 0, BLOCKS_MAX as u64)?;
    near.blocks = ascending_keys(reader, "block of near hits", blocks)?;
    Ok(())
}

/// Reads the hits of the next `receivers` receivers of a chunk of `version`; `may_take` errs if as many hits are too many.
pub(super) fn read_near(
    reader: &mut Reader,
    near: &mut NearHits,
    receivers: usize,
    version: u16,
    may_take: impl Fn(u64) -> Result<(), ChunkError>,
) -> Result<(), ChunkError> {
    let section = reader.section();
    let counts = ints::take_u32s(reader, "near hits", receivers)?;
    let lit = counts.iter().filter(|&&count| count > 0).count();
    for &count in &counts {
        near.count.push(in_range(section, "near hits of a receiver", count.into(), 0, u8::MAX.into())? as u8);
    }
    let new: usize = counts.iter().map(|&count| count as usize).sum();
    let all = (near.len() + new) as u64;
    in_range(section, "near hits", all, 0, NEAR_HITS_MAX as u64)?;
    may_take(all)?;
    let mut weights = ints::take_u32s(reader, "weight of near hits", lit)?.into_iter();
    for &count in &counts {
        let code = if count > 0 { weights.next().unwrap_or_default() } else { 0 };
        in_range(section, "weight of near hits", code.into(), 0, WEIGHT_CODE_MAX.into())?;
        near.weight.push(code as f32 / WEIGHT_CODE_MAX as f32 * std::f32::consts::PI);
    }
    let mut is_own = Vec::with_capacity(new);
    for flag in ints::take_u32s(reader, "flag of a near hit", new)? {
        is_own.push(in_range(section, "flag of a near hit", flag.into(), 0, 1)? == 1);
    }
    let own = is_own.iter().filter(|own| **own).count();
    let mut codes = |what, count, min: i32, max: i32| ints::take_deltas(reader, what, count, min..=max);
    let last_block = near.blocks.len() as i32 - 1;
    let mut blocks = codes("block of a near hit", new - own, 0, last_block)?.into_iter();
    let mut texel = || codes("texel of a near hit", new - own, 0, u16::MAX.into());
    let mut texels = texel()?.into_iter().zip(texel()?);
    let mut normal = || codes("normal of a near hit", own, -NORMAL_CODE_MAX, NORMAL_CODE_MAX);
    let mut normals = normal()?.into_iter().zip(normal()?);
    let mut albedo = || codes("albedo of a near hit", own, 0, u8::MAX.into());
    let mut albedos = albedo()?.into_iter().zip(albedo()?).zip(albedo()?);
    let mut surface = |is_own: bool| {
        if is_own {
            let ((u, v), ((r, g), b)) = (normals.next()?, albedos.next()?);
            let albedo = [r, g, b].map(|code| albedo_of(code as u8));
            return Some(NearSurface::Own { albedo, normal: normal_of([u as i16, v as i16]) });
        }
        let (block, (x, y)) = (blocks.next()?, texels.next()?);
        Some(NearSurface::Texel { block: block as u16, texel: [x as u16, y as u16] })
    };
    near.surface.reserve(new);
    near.surface.extend(is_own.into_iter().filter_map(&mut surface));
    let steps = if version > LAST_IN_STEPS { NearHits::STEPS_STORED } else { 1 };
    let most = OFFSET_MAX / i32::from(steps);
    let mut offsets = || ints::take_deltas(reader, "offset of a near hit", new, -most..=most);
    let offsets = [offsets()?, offsets()?, offsets()?];
    let [x, y, z] = offsets;
    near.offset
        .extend(x.into_iter().zip(y).zip(z).map(|((x, y), z)| [x, y, z].map(|code| code as i16 * steps)));
    Ok(())
}

/// Most raw bytes of the hits of levels of so many receivers, without what the first section begins with.
pub(super) fn near_bytes_max(counts: &[usize]) -> u64 {
    let receivers: usize = counts.iter().sum();
    let hits = (receivers * usize::from(u8::MAX)).min(NEAR_HITS_MAX);
    // An array takes a byte more than its numbers do.
    2 * ints::bytes_max(receivers) + 12 * ints::bytes_max(hits) + 14 * counts.len() as u64
}

/// Most raw bytes of what the first section begins with.
pub(super) fn begin_bytes_max() -> u64 {
    8 + 8 * BLOCKS_MAX as u64
}
