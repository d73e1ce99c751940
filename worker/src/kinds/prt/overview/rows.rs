//! Rows of an overview's receivers, from the factors of the clusters that they lie in.

use std::collections::HashSet;

use lightkiln_proto::content::{ClusterTransport, NearSurface, PatchKey, Receivers};

use super::coarse::{Name, OverviewPatches};
use crate::lightmap::Numbering;

/// A receiver of an overview with its row.
#[derive(Clone, Debug)]
pub struct CoarseRow {
    /// The receiver, alone.
    pub receiver: Receivers,
    /// Irradiance straight from emitters that reach it.
    pub emitters: Vec<(u16, [f32; 3])>,
    /// Weight of each column that has any, ascending by key.
    pub columns: Vec<(u64, f32)>,
}

/// Rows of the chosen receivers of a cluster. Near hits are columns of the patches that they lie on.
pub fn rows(
    coarse: &OverviewPatches<'_>,
    chosen: &HashSet<Name>,
    cluster: &ClusterTransport,
) -> Vec<CoarseRow> {
    let receivers = &cluster.receivers;
    let name = |at: usize| (receivers.blocks[usize::from(receivers.block[at])], receivers.texel[at]);
    let picked: Vec<usize> = (0..receivers.len()).filter(|&at| chosen.contains(&name(at))).collect();
    if picked.is_empty() {
        return Vec::new();
    }
    let factors = &cluster.factors;
    let columns: Vec<Vec<PatchKey>> = factors.keys.iter().map(|&key| coarse.columns(PatchKey(key))).collect();
    let keys = Numbering::of(columns.iter().flatten().copied());
    let places: Vec<Vec<usize>> =
        columns.iter().map(|keys_| keys_.iter().map(|&key| keys.place(key)).collect()).collect();
    // ΣVᵀ over the columns of the overview.
    let (rank, count) = (factors.rank as usize, columns.len());
    let mut folded = vec![0.0_f32; rank * keys.len()];
    for i in 0..rank {
        for (places, value) in places.iter().zip(&factors.vt[i * count..][..count]) {
            places.iter().for_each(|place| folded[i * keys.len() + place] += value);
        }
    }
    let near: Vec<std::ops::Range<usize>> = cluster.near.ranges().collect();
    picked
        .into_iter()
        .map(|at| {
            let mut sums = vec![0.0_f32; keys.len()];
            for (i, u) in factors.u[at * rank..][..rank].iter().enumerate() {
                sums.iter_mut().zip(&folded[i * keys.len()..]).for_each(|(sum, value)| *sum += u * value);
            }
            let mut columns: Vec<(u64, f32)> = keys.values().iter().map(|key| key.0).zip(sums).collect();
            let own = coarse.columns_at(name(at));
            for hit in near.get(at).cloned().unwrap_or_default() {
                let met = match cluster.near.surface[hit] {
                    NearSurface::Texel { block, texel } => {
                        coarse.columns_at((cluster.near.blocks[usize::from(block)], texel))
                    }
                    NearSurface::Own { .. } => None,
                };
                let met = met.as_ref().or(own.as_ref()).into_iter().flatten();
                columns.extend(met.map(|key| (key.0, cluster.near.weight[at])));
            }
            columns.sort_by_key(|(key, _)| *key);
            columns.dedup_by(|next, kept| {
                let is_same = next.0 == kept.0;
                kept.1 += if is_same { next.1 } else { 0.0 };
                is_same
            });
            columns.retain(|(_, weight)| *weight != 0.0);
            let emitters = cluster.emitters.iter().map(|column| (column.emitter, column.irradiance[at]));
            let emitters = emitters.filter(|(_, irradiance)| *irradiance != [0.0; 3]).collect();
            CoarseRow { receiver: alone(receivers, at), emitters, columns }
        })
        .collect()
}

/// One of some receivers.
fn alone(receivers: &Receivers, at: usize) -> Receivers {
    Receivers {
        blocks: vec![receivers.blocks[usize::from(receivers.block[at])]],
        block: vec![0],
        texel: vec![receivers.texel[at]],
        position_m: vec![receivers.position_m[at]],
        normal: vec![receivers.normal[at]],
        albedo: vec![receivers.albedo[at]],
        emission: vec![receivers.emission[at]],
        links: vec![receivers.links[at]],
        coverage: vec![receivers.coverage[at]],
        edge: vec![receivers.edge[at]],
    }
}
