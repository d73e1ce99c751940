//! An overview's light held against that of the whole bake.

use std::path::Path;

use anyhow::{Result, ensure};
use glam::{Vec3, Vec4};
use lightkiln_client::fetch::Source;
use lightkiln_client::stream::{Candidate, Lit as Place, Rung, by_need};
use lightkiln_proto::chunk::{decode_cluster, decode_patches};
use lightkiln_proto::content::{ClusterTransport, PatchSet};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{CLUSTERS, Manifest, with_chunks};
use lightkiln_proto::relight::{
    DirectAt, Incoming, LightmapTexels, Limit, PatchTable, Sky, Transport, stand_in,
};
use lightkiln_worker::evaluate::{TestLight, default_lights};
use lightkiln_worker::factors::Threads;
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::kinds::prt::overview::overview;
use lightkiln_worker::reference::{Lighting, Reference};
use lightkiln_worker::scene::{Bundle, Limits, import};
use lightkiln_worker::task::Progress;
use rayon::prelude::*;

use super::Size;

/// End of the bounces.
const LIMIT: Limit = Limit { bounces_max: 400, change_max: 1e-4 };
/// Points over rectangles for E_dir.
const RECT_POINTS: u32 = 8;

/// A bake under the lights of the evaluation.
pub struct Whole {
    pub(super) manifest: Manifest,
    pub(super) set: PatchSet,
    clusters: Vec<ClusterTransport>,
    pub(super) transport: Transport<PatchTable>,
    pub(super) geometry: Geometry,
    pub(super) lights: Vec<Lit>,
}

/// Light of the whole bake.
pub struct Lit {
    pub(super) light: TestLight,
    /// E_dir by slot.
    dir: Vec<Vec4>,
    /// E_dir by near hit.
    pub(super) near: Vec<Vec4>,
    /// E_ind by slot.
    ind: Vec<Vec4>,
}

/// Light of a part of a bake, and who stands for whom in it.
pub struct Part {
    /// The part.
    pub(super) transport: Transport<PatchTable>,
    /// Slots in the whole of which each of its receivers has the mean E_dir.
    same: Vec<Vec<usize>>,
    /// By slot in the whole: receivers of the part whose mean light a picture shows there.
    standing: Vec<Vec<u32>>,
    /// By slot in the whole: the receiver that stands for it.
    nearest: Vec<Option<u32>>,
}

/// A part under a light.
pub struct Seen {
    /// E_ind by slot of the part.
    pub(super) ind: Vec<Vec4>,
    /// Energy over that of the whole.
    pub(super) energy: f64,
    /// Relative RMSE of E_ind over all receivers.
    pub(super) error: f64,
}

/// Shares of the bytes of all clusters that come after the overview.
pub const SHARES: [f64; 6] = [0.0, 0.01, 0.04, 0.12, 0.20, 0.40];

/// An overview beside the whole.
#[derive(Clone, Debug)]
pub struct FirstLight {
    /// Receivers.
    pub receivers: usize,
    /// Bytes of its chunks.
    pub bytes: u64,
    /// Those bytes over the bytes of all light.
    pub share: f64,
    /// By light.
    pub lights: Vec<OfLight>,
}

/// An overview under one light.
#[derive(Clone, Debug)]
pub struct OfLight {
    /// Name.
    pub name: String,
    /// Energy over that of the whole.
    pub energy: f64,
    /// Relative RMSE of E_ind over all receivers with the exact light of those clusters that are needed most, by [`SHARES`].
    pub by_need: Vec<f64>,
    /// The same with the clusters of the largest squares of the error over their bytes: no order is better.
    pub by_error: Vec<f64>,
    /// That of the best overview with the same receivers: each has the mean of those that it stands for.
    pub best: f64,
}

impl FirstLight {
    /// Root of the mean square of the lights' errors.
    pub fn error(&self) -> f64 {
        let squares: f64 = self.lights.iter().map(|light| light.by_need[0].powi(2)).sum();
        (squares / self.lights.len().max(1) as f64).sqrt()
    }
}

impl Whole {
    /// A bundle's bake, and its scene's file.
    pub fn read(bundle: &Path, scene: &Path) -> Result<Self> {
        let source = Source::Bundle(bundle.to_owned());
        let (_, manifest) = source.manifest()?;
        let limits = Limits::default();
        let scene = import(&Bundle::from_bytes(Bundle::pack_path(scene, &limits)?, &limits)?, &limits)?.scene;
        let geometry = Geometry::new(scene)?;
        let patches = manifest.chunks(PATCHES);
        ensure!(patches.len() == 1, "the bundle is of kind {}, wanted prt", manifest.kind);
        let set = decode_patches(&source.chunk(&patches[0])?)?;
        let decode = |chunk: &_| -> Result<ClusterTransport> { Ok(decode_cluster(&source.chunk(chunk)?)?) };
        let clusters: Vec<ClusterTransport> =
            manifest.chunks(CLUSTERS).par_iter().map(decode).collect::<Result<_>>()?;
        let blocks = manifest.layout()?.blocks.iter().map(|block| (block.key, block.size));
        let transport = Transport::join(blocks, manifest.emitters.len(), &clusters, |slots| {
            PatchTable::new(&set, slots)
        })?;
        let lights = default_lights(&geometry).lights;
        let lights =
            lights.into_iter().map(|light| Lit::of(&geometry, &transport, light)).collect::<Result<_>>()?;
        Ok(Self { manifest, set, clusters, transport, geometry, lights })
    }

    /// The overview of a size, and how near it comes.
    pub fn first_light(&self, size: Size) -> Result<FirstLight> {
        let cluster = |index: usize| Ok(self.clusters[index].clone());
        let found = overview(&self.set, self.clusters.len(), cluster, size, &Progress::new())?;
        let clusters: Vec<ClusterTransport> =
            found.iter().map(|cluster| decode_cluster(&cluster.bytes)).collect::<Result<_, _>>()?;
        let coarse = joined(&self.manifest, &self.set, &clusters)?;
        let bytes: usize = found.iter().map(|cluster| cluster.bytes.len()).sum();
        let of_light = [CLUSTERS, PATCHES].into_iter().flat_map(|role| self.manifest.chunks(role));
        let all: u64 = of_light.map(|chunk| chunk.bytes).sum();
        let receivers = coarse.receivers.len();
        let part = self.standing(coarse)?;
        let lights = self.lights.iter().map(|lit| self.beside(lit, &part)).collect();
        Ok(FirstLight { receivers, bytes: bytes as u64, share: bytes as f64 / all as f64, lights })
    }

    /// Who stands for whom in a part.
    pub(super) fn standing(&self, transport: Transport<PatchTable>) -> Result<Part> {
        let shown = LightmapTexels { slots: &transport.slots, receivers: &transport.receivers };
        let (mut standing, mut nearest) = (Vec::new(), Vec::new());
        let mut same = vec![Vec::new(); transport.receivers.len()];
        for ClusterTransport { receivers, .. } in &self.clusters {
            let blocks = transport.slots.block_indices(&receivers.blocks).map_err(anyhow::Error::msg)?;
            for (&block, &texel) in receivers.block.iter().zip(&receivers.texel) {
                let block = blocks[usize::from(block)];
                let slots =
                    [transport.slots.slot(block, texel), transport.slots.standing_inside(block, texel)];
                for of in slots.into_iter().flatten() {
                    same[of as usize].push(standing.len());
                }
                // As a picture shows it: guests, who are in no patch, have the light of those around them.
                let mut sources = Vec::new();
                shown.push_sources(block, texel, &mut sources);
                nearest.push(transport.slots.standing(block, texel));
                standing.push(sources);
            }
        }
        Ok(Part { transport, same, standing, nearest })
    }

    /// A part under a light, with E_dir of its near hits.
    pub(super) fn seen(&self, lit: &Lit, part: &Part, near: &[Vec4]) -> Seen {
        let dir: Vec<Vec4> = part
            .same
            .iter()
            .map(|slots| slots.iter().map(|&slot| lit.dir[slot]).sum::<Vec4>() / slots.len().max(1) as f32)
            .collect();
        let ind = settled(&part.transport, &lit.light.lighting, &dir, near);
        let slots = || 0..lit.ind.len();
        let whole: f64 = lit.ind.iter().map(|exact| f64::from(exact.truncate().element_sum())).sum();
        let energy: f64 =
            slots().map(|slot| f64::from(part.shown(&ind, slot).truncate().element_sum())).sum();
        let squares: f64 = slots().map(|slot| part.square(&ind, lit, slot)).sum();
        let numbers = 3.0 * lit.ind.len() as f64;
        Seen { ind, energy: energy / whole, error: (squares / numbers).sqrt() / (whole / numbers) }
    }

    /// An overview under a light.
    fn beside(&self, lit: &Lit, part: &Part) -> OfLight {
        let Part { transport: coarse, same, nearest, .. } = part;
        let Seen { ind, energy, .. } = self.seen(lit, part, &[]);
        let mut mean = vec![Vec4::ZERO; same.len()];
        let mut count = vec![0.0_f32; same.len()];
        for (exact, to) in lit.ind.iter().zip(nearest) {
            if let Some(to) = *to {
                mean[to as usize] += *exact;
                count[to as usize] += 1.0;
            }
        }
        mean.iter_mut().zip(&count).for_each(|(mean, count)| *mean /= count.max(1.0));
        let square = |light: &[Vec4], slot: usize| part.square(light, lit, slot);
        let slots = || 0..lit.ind.len();
        let whole: f64 = lit.ind.iter().map(|exact| f64::from(exact.truncate().element_sum())).sum();
        let numbers = 3.0 * lit.ind.len() as f64;
        let relative = |squares: f64| (squares.max(0.0) / numbers).sqrt() / (whole / numbers);

        let rows: Vec<_> = with_chunks(&self.manifest).collect();
        let squares: Vec<f64> = self
            .transport
            .clusters
            .clusters
            .iter()
            .map(|cluster| cluster.rows().map(|slot| square(&ind, slot)).sum())
            .collect();
        let curve = |order: &[usize]| {
            let bytes_all: u64 = rows.iter().map(|(_, chunk)| chunk.bytes).sum();
            let left_at = |share: f64| {
                let mut left = share * bytes_all as f64;
                let mut squares_left: f64 = squares.iter().sum();
                for &index in order {
                    left -= rows[index].1.bytes as f64;
                    if left < 0.0 {
                        break;
                    }
                    squares_left -= squares[index];
                }
                relative(squares_left)
            };
            SHARES.map(left_at).to_vec()
        };
        let candidates: Vec<Candidate> = rows
            .iter()
            .map(|(row, chunk)| Candidate {
                bounds_m: row.bounds_m.map(Vec3::from),
                receivers: row.receivers,
                rungs: vec![Rung { bytes: chunk.bytes, memory: 0, left: 0.0 }],
                held: 0,
                kept: 0,
            })
            .collect();
        let places: Vec<Place> = coarse
            .receivers
            .position_m
            .iter()
            .zip(&ind)
            .map(|(position_m, ind)| Place { position_m: position_m.truncate(), irradiance: ind.truncate() })
            .collect();
        let [low, high] = self.manifest.bounds_m.map(Vec3::from);
        let mut by_error: Vec<usize> = (0..rows.len()).collect();
        let gain = |index: usize| squares[index] / rows[index].1.bytes as f64;
        by_error.sort_by(|&a, &b| gain(b).total_cmp(&gain(a)));
        let need = by_need(&candidates, &places, None, low.distance(high));
        let need: Vec<usize> = need.iter().map(|step| step.candidate).collect();
        OfLight {
            name: lit.light.name.clone(),
            energy,
            by_need: curve(&need),
            by_error: curve(&by_error),
            best: relative(slots().map(|slot| square(&mean, slot)).sum()),
        }
    }
}

impl Part {
    /// Light that a picture shows at a slot of the whole.
    fn shown(&self, light: &[Vec4], slot: usize) -> Vec4 {
        let sum: Vec4 = self.standing[slot].iter().map(|&to| light[to as usize]).sum();
        sum / self.standing[slot].len().max(1) as f32
    }

    /// The square of its error.
    fn square(&self, light: &[Vec4], lit: &Lit, slot: usize) -> f64 {
        f64::from((self.shown(light, slot) - lit.ind[slot]).truncate().length_squared())
    }
}

impl Lit {
    fn of(geometry: &Geometry, transport: &Transport<PatchTable>, light: TestLight) -> Result<Self> {
        let reference = Reference::new(geometry, &light.lighting)?;
        let slots = (0..transport.receivers.len() as u32).into_par_iter();
        let at = |place| direct(&reference, transport, place);
        let dir: Vec<Vec4> = slots.map(|slot| at(DirectAt::Receiver(slot))).collect();
        let hits = (0..transport.near.len()).into_par_iter();
        let near: Vec<Vec4> =
            hits.map(|hit| at(transport.near.direct_at(hit, &transport.receivers))).collect();
        let ind = settled(transport, &light.lighting, &dir, &near);
        Ok(Self { light, dir, near, ind })
    }
}

/// E_dir at a place, by rays.
pub(super) fn direct(reference: &Reference<'_>, transport: &Transport<PatchTable>, place: DirectAt) -> Vec4 {
    let (position_m, normal) = match place {
        DirectAt::Receiver(slot) => {
            let receivers = &transport.receivers;
            (receivers.position_m[slot as usize].truncate(), receivers.normal[slot as usize].truncate())
        }
        DirectAt::Texel { position_m, normal, .. } | DirectAt::Point { position_m, normal } => {
            (position_m, normal)
        }
    };
    let site = Site { position_m, normal, face_normal: normal };
    reference.direct_irradiance(&site, RECT_POINTS).as_vec3().extend(0.0)
}

/// The transport of some clusters of a bake; those that are there stand for the others.
pub(super) fn joined(
    manifest: &Manifest,
    set: &PatchSet,
    clusters: &[ClusterTransport],
) -> Result<Transport<PatchTable>> {
    let blocks = manifest.layout()?.blocks.iter().map(|block| (block.key, block.size));
    Ok(Transport::join_some(
        blocks,
        manifest.emitters.len(),
        clusters,
        |slots| stand_in(set, slots),
        |slots| PatchTable::new(set, slots),
    )?)
}

/// E_ind by slot after the last bounce.
pub(super) fn settled(
    transport: &Transport<PatchTable>,
    lighting: &Lighting,
    dir: &[Vec4],
    near: &[Vec4],
) -> Vec<Vec4> {
    // Factors beyond the emitters are not read.
    let emitter_scale = vec![lighting.emitter_scale; usize::from(u16::MAX)];
    let sky = Sky::of(&lighting.lights);
    transport
        .settle(
            &Threads,
            &Incoming {
                dir,
                near,
                sky,
                panorama: lighting.panorama.as_deref(),
                emitter_scale: &emitter_scale,
                ..Incoming::default()
            },
            LIMIT,
        )
        .ind
}
