//! An overview's light held against that of the whole bake.

use std::path::Path;

use anyhow::{Result, ensure};
use glam::Vec4;
use lightkiln_client::fetch::Source;
use lightkiln_proto::chunk::{decode_cluster, decode_patches};
use lightkiln_proto::content::{ClusterTransport, PatchSet};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{CLUSTERS, Manifest};
use lightkiln_proto::relight::{DirectAt, Incoming, Limit, PatchTable, Sky, Transport};
use lightkiln_worker::evaluate::{TestLight, default_lights};
use lightkiln_worker::factors::Threads;
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::reference::{Lighting, Reference};
use lightkiln_worker::scene::{Bundle, Limits, import};
use lightkiln_worker::task::Progress;
use rayon::prelude::*;

use super::{Overview, Size, overview};

/// End of the bounces.
const LIMIT: Limit = Limit { bounces_max: 400, change_max: 1e-4 };
/// Points over a panel for E_dir.
const PANEL_POINTS: u32 = 8;

/// A bake under the lights of the evaluation.
pub struct Whole {
    manifest: Manifest,
    set: PatchSet,
    clusters: Vec<ClusterTransport>,
    transport: Transport<PatchTable>,
    lights: Vec<Lit>,
}

/// Light of the whole bake.
struct Lit {
    light: TestLight,
    /// E_dir by slot.
    dir: Vec<Vec4>,
    /// E_ind by slot.
    ind: Vec<Vec4>,
}

/// An overview beside the whole.
#[derive(Clone, Debug)]
pub struct FirstLight {
    /// Receivers.
    pub receivers: usize,
    /// Bytes of its chunks.
    pub bytes: u64,
    /// Those bytes over the bytes of all light.
    pub share: f64,
    /// By light: its name, relative RMSE of E_ind over all receivers, and energy.
    pub lights: Vec<(String, f64, f64)>,
}

impl FirstLight {
    /// Root of the mean square of the lights' errors.
    pub fn error(&self) -> f64 {
        let squares: f64 = self.lights.iter().map(|(_, error, _)| error * error).sum();
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
        let transport = joined(&manifest, &set, &clusters)?;
        let lights = default_lights(&geometry).lights;
        let lights =
            lights.into_iter().map(|light| Lit::of(&geometry, &transport, light)).collect::<Result<_>>()?;
        Ok(Self { manifest, set, clusters, transport, lights })
    }

    /// The overview of a size, and how near it comes.
    pub fn first_light(&self, size: Size) -> Result<FirstLight> {
        let parents = self.transport.columns.patches.iter().map(|patch| patch.parent).collect();
        let cluster = |index: usize| Ok(self.clusters[index].clone());
        let found = overview(&self.set, parents, self.clusters.len(), cluster, size, &Progress::new())?;
        let clusters: Vec<ClusterTransport> =
            found.clusters.iter().map(|cluster| decode_cluster(&cluster.bytes)).collect::<Result<_, _>>()?;
        let coarse = joined(&self.manifest, &decode_patches(&found.patches)?, &clusters)?;
        let members = self.members(&found, &coarse);
        let stand_in = self.stand_ins(&clusters, &coarse, &members);
        let lights = self.lights.iter().map(|lit| lit.beside(&coarse, &members, &stand_in)).collect();
        let bytes =
            found.clusters.iter().map(|cluster| cluster.bytes.len()).sum::<usize>() + found.patches.len();
        let of_light = [CLUSTERS, PATCHES].into_iter().flat_map(|role| self.manifest.chunks(role));
        let all: u64 = of_light.map(|chunk| chunk.bytes).sum();
        Ok(FirstLight {
            receivers: coarse.receivers.len(),
            bytes: bytes as u64,
            share: bytes as f64 / all as f64,
            lights,
        })
    }

    /// Slots that each receiver of an overview stands for, with their areas.
    fn members(&self, found: &Overview, coarse: &Transport<PatchTable>) -> Vec<Vec<(u32, f32)>> {
        let mut members = vec![Vec::new(); coarse.receivers.len()];
        for &((block, texel), (to_block, to_texel), area) in &found.stand_for {
            let slots =
                [self.transport.slots.slot_of(block, texel), coarse.slots.slot_of(to_block, to_texel)];
            if let [Some(from), Some(to)] = slots {
                members[to as usize].push((from, area));
            }
        }
        members
    }

    /// The slot of an overview whose light each receiver of the bake has. Guests are in no patch: the nearest of their block.
    fn stand_ins(
        &self,
        clusters: &[ClusterTransport],
        coarse: &Transport<PatchTable>,
        members: &[Vec<(u32, f32)>],
    ) -> Vec<Option<u32>> {
        let mut stand_in = vec![None; self.transport.receivers.len()];
        for (to, members) in (0..).zip(members) {
            members.iter().for_each(|&(from, _)| stand_in[from as usize] = Some(to));
        }
        let mut of_block = std::collections::HashMap::<u64, Vec<([u16; 2], u32)>>::new();
        for ClusterTransport { receivers, .. } in clusters {
            for (&block, &texel) in receivers.block.iter().zip(&receivers.texel) {
                let key = receivers.blocks[usize::from(block)];
                of_block
                    .entry(key)
                    .or_default()
                    .extend(coarse.slots.slot_of(key, texel).map(|to| (texel, to)));
            }
        }
        let mut slot = 0;
        for ClusterTransport { receivers, .. } in &self.clusters {
            for (&block, &texel) in receivers.block.iter().zip(&receivers.texel) {
                let squared = |other: [u16; 2]| -> u32 {
                    (0..2).map(|axis| u32::from(texel[axis].abs_diff(other[axis])).pow(2)).sum()
                };
                let of_block =
                    of_block.get(&receivers.blocks[usize::from(block)]).map_or(&[][..], Vec::as_slice);
                let nearest = || of_block.iter().min_by_key(|(other, to)| (squared(*other), *to));
                stand_in[slot] = stand_in[slot].or_else(|| nearest().map(|(_, to)| *to));
                slot += 1;
            }
        }
        stand_in
    }
}

impl Lit {
    fn of(geometry: &Geometry, transport: &Transport<PatchTable>, light: TestLight) -> Result<Self> {
        let reference = Reference::new(geometry, &light.lighting)?;
        let direct = |place: DirectAt| -> Vec4 {
            let (position_m, normal) = match place {
                DirectAt::Receiver(slot) => {
                    let receivers = &transport.receivers;
                    (
                        receivers.position_m[slot as usize].truncate(),
                        receivers.normal[slot as usize].truncate(),
                    )
                }
                DirectAt::Texel { position_m, normal, .. } | DirectAt::Point { position_m, normal } => {
                    (position_m, normal)
                }
            };
            let site = Site { position_m, normal, face_normal: normal };
            reference.direct_irradiance(&site, PANEL_POINTS).as_vec3().extend(0.0)
        };
        let slots = (0..transport.receivers.len() as u32).into_par_iter();
        let dir: Vec<Vec4> = slots.map(|slot| direct(DirectAt::Receiver(slot))).collect();
        let hits = (0..transport.near.len()).into_par_iter();
        let near: Vec<Vec4> = hits.map(|hit| direct(transport.near.direct_at(hit))).collect();
        let ind = settled(transport, &light.lighting, &dir, &near);
        Ok(Self { light, dir, ind })
    }

    /// An overview under the same light: name, relative RMSE, energy. Its E_dir is the mean over those that each receiver stands
    /// for.
    fn beside(
        &self,
        coarse: &Transport<PatchTable>,
        members: &[Vec<(u32, f32)>],
        stand_in: &[Option<u32>],
    ) -> (String, f64, f64) {
        let mean = |members: &Vec<(u32, f32)>| {
            let sum: Vec4 = members.iter().map(|&(slot, area)| self.dir[slot as usize] * area).sum();
            sum / members.iter().map(|(_, area)| area).sum::<f32>().max(f32::MIN_POSITIVE)
        };
        let dir: Vec<Vec4> = members.iter().map(mean).collect();
        let ind = settled(coarse, &self.light.lighting, &dir, &[]);
        let [mut squares, mut whole, mut part] = [0.0_f64; 3];
        for (exact, to) in self.ind.iter().zip(stand_in) {
            let value = to.map_or(Vec4::ZERO, |to| ind[to as usize]);
            squares += f64::from((value - *exact).truncate().length_squared());
            whole += f64::from(exact.truncate().element_sum());
            part += f64::from(value.truncate().element_sum());
        }
        let numbers = 3.0 * self.ind.len() as f64;
        (self.light.name.clone(), (squares / numbers).sqrt() / (whole / numbers), part / whole)
    }
}

fn joined(
    manifest: &Manifest,
    set: &PatchSet,
    clusters: &[ClusterTransport],
) -> Result<Transport<PatchTable>> {
    let blocks = manifest.layout()?.blocks.iter().map(|block| (block.key, block.size));
    Ok(Transport::join(blocks, manifest.emitters.len(), clusters, |slots| PatchTable::new(set, slots))?)
}

/// E_ind by slot after the last bounce.
fn settled(transport: &Transport<PatchTable>, lighting: &Lighting, dir: &[Vec4], near: &[Vec4]) -> Vec<Vec4> {
    // Factors beyond the emitters are not read.
    let emitter_scale = vec![lighting.emitter_scale; usize::from(u16::MAX)];
    let sky = Sky::of(&lighting.lights);
    transport.settle(&Threads, &Incoming { dir, near, sky, emitter_scale: &emitter_scale }, LIMIT).ind
}
