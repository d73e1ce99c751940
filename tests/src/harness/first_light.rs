//! The light of a bake's overview beside that of all of it.

use anyhow::{Context, Result, ensure};
use glam::Vec4;
use lightkiln_proto::chunk::{decode_cluster, decode_patches};
use lightkiln_proto::content::{ClusterTransport, PatchSet};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::OVERVIEW;
use lightkiln_proto::relight::{
    Incoming, LightmapTexels, Limit, PatchTable, Serial, Sky, Transport, stand_in,
};
use lightkiln_worker::reference::luminance;

use super::relit::RelitReceiver;
use super::{Lighting, LocalBake, clusters};

/// A receiver of a bake, and the light that it shows while the overview alone is there.
#[derive(Clone, Debug)]
pub struct FirstLight {
    /// With all of the bake's light.
    pub whole: RelitReceiver,
    /// Indirect irradiance by the overview, W·m⁻².
    pub first: [f32; 3],
}

/// Light at every receiver of a bake, whose emitters are off, by all clusters and by the overview, in the order of clusters.
pub fn first_light(bake: &LocalBake, lighting: &Lighting) -> Result<Vec<FirstLight>> {
    let manifest = &bake.manifest;
    let chunk = manifest.chunks(PATCHES).first().context("no patches")?;
    let set = decode_patches(&bake.chunk(chunk.digest)?)?;
    let overview: Vec<ClusterTransport> = manifest
        .chunks(OVERVIEW)
        .iter()
        .map(|chunk| Ok(decode_cluster(&bake.chunk(chunk.digest)?)?))
        .collect::<Result<_>>()?;
    ensure!(!overview.is_empty(), "the bake has no overview");
    let all = clusters(bake)?;
    let (whole, coarse) = (joined(bake, &set, &all, false)?, joined(bake, &set, &overview, true)?);
    let [whole_ind, coarse_ind] = [&whole, &coarse].map(|transport| indirect(transport, lighting));
    let shown = LightmapTexels { slots: &coarse.slots, receivers: &coarse.receivers };
    let mut found = Vec::with_capacity(whole.receivers.len());
    for cluster in &all {
        let blocks = coarse.slots.block_indices(&cluster.receivers.blocks).map_err(anyhow::Error::msg)?;
        for (&block, &texel) in cluster.receivers.block.iter().zip(&cluster.receivers.texel) {
            let slot = found.len();
            let mut sources = Vec::new();
            shown.push_sources(blocks[usize::from(block)], texel, &mut sources);
            let sum: Vec4 = sources.iter().map(|&slot| coarse_ind[slot as usize]).sum();
            let first = sum / sources.len().max(1) as f32;
            let receivers = &whole.receivers;
            found.push(FirstLight {
                whole: RelitReceiver {
                    position_m: receivers.position_m[slot].truncate(),
                    normal: receivers.normal[slot].truncate(),
                    indirect: whole_ind[slot].truncate().to_array(),
                },
                first: first.truncate().to_array(),
            });
        }
    }
    Ok(found)
}

/// Relative RMSE of first light over the mean of the whole, and its energy over that of the whole.
pub fn beside_the_whole(found: &[FirstLight]) -> [f32; 2] {
    let [mut squares, mut whole, mut first] = [0.0_f64; 3];
    for light in found {
        let [a, b] =
            [light.whole.indirect, light.first].map(|rgb| luminance(glam::DVec3::from(rgb.map(f64::from))));
        squares += (a - b) * (a - b);
        whole += a;
        first += b;
    }
    let count = found.len().max(1) as f64;
    [((squares / count).sqrt() / (whole / count)) as f32, (first / whole) as f32]
}

fn joined(
    bake: &LocalBake,
    set: &PatchSet,
    clusters: &[ClusterTransport],
    is_part: bool,
) -> Result<Transport<PatchTable>> {
    let manifest = &bake.manifest;
    let blocks = manifest.layout()?.blocks.iter().map(|block| (block.key, block.size));
    let stands = |slots: &mut _| if is_part { stand_in(set, slots) } else { Ok(()) };
    let columns = |slots: &_| PatchTable::new(set, slots);
    Ok(Transport::join_some(blocks, manifest.emitters.len(), clusters, stands, columns)?)
}

/// Indirect irradiance without that of emitters, by slot.
fn indirect(transport: &Transport<PatchTable>, lighting: &Lighting) -> Vec<Vec4> {
    let direct = |position_m: &Vec4, normal: &Vec4| {
        let [r, g, b] = (lighting.direct)(position_m.truncate(), normal.truncate());
        Vec4::new(r, g, b, 0.0)
    };
    let at = |positions: &[Vec4], normals: &[Vec4]| -> Vec<Vec4> {
        positions.iter().zip(normals).map(|(position_m, normal)| direct(position_m, normal)).collect()
    };
    let dir = at(&transport.receivers.position_m, &transport.receivers.normal);
    let [positions_m, normals] = transport.near.surfaces(&transport.receivers);
    let near = at(&positions_m, &normals);
    let [zenith, horizon] = lighting.sky.map(Into::into);
    // Factors beyond the emitters are not read.
    let off = vec![0.0; usize::from(u16::MAX)];
    let incoming = Incoming {
        dir: &dir,
        near: &near,
        sky: Sky { zenith, horizon },
        panorama: None,
        emitter_scale: &off,
        ..Incoming::default()
    };
    transport.settle(&Serial, &incoming, Limit::default()).ind
}
