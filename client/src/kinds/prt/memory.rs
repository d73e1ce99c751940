//! Memory that light over surface patches takes when it is lit, about: budgets are held against it.

use lightkiln_proto::content::{ClusterTransport, PatchSet};

use crate::fetch::Layers;

/// Memory of a receiver that is lit, of one of its near hits, and of a number of U and of ΣVᵀ, in bytes, about.
const RECEIVER_BYTES: u64 = 240;
const NEAR_BYTES: u64 = 36;
const U_BYTES: f64 = 1.1;
const VT_BYTES: f64 = 0.7;
/// Memory of a column, and of a patch, in bytes.
const COLUMN_BYTES: u64 = 8;
const PATCH_BYTES: u64 = 48;
/// Near hits of a receiver whose cluster has not come: the mean of Sponza.
const NEAR_HITS: u64 = 6;

/// Memory of the first bytes of a cluster, when they are lit: as the directory tells it, with the bytes themselves.
pub(super) fn rung_memory(of: Layers<'_>, bytes: u64) -> u64 {
    let (receivers, keys) = (u64::from(of.row.receivers), u64::from(of.row.keys));
    let all = memory(receivers, keys, of.row.rank, NEAR_HITS * receivers);
    bytes + (all as f64 * bytes as f64 / of.chunk.bytes.max(1) as f64) as u64
}

fn memory_of(cluster: &ClusterTransport, near_hits: usize) -> u64 {
    let keys = cluster.factors.keys.len() as u64;
    memory(cluster.receivers.len() as u64, keys, cluster.factors.rank, near_hits as u64)
}

fn memory(receivers: u64, keys: u64, rank: u32, near_hits: u64) -> u64 {
    let numbers = f64::from(rank) * (U_BYTES * receivers as f64 + VT_BYTES * keys as f64);
    RECEIVER_BYTES * receivers + COLUMN_BYTES * keys + NEAR_BYTES * near_hits + numbers as u64
}

/// Memory of an element, decoded and as walks read it, in bytes, and its bytes in a chunk, about.
const ELEMENT_BYTES: u64 = 72;
const STORED_BYTES: u64 = 4;

/// Memory of patches and overview.
pub(super) fn base_memory(set: &PatchSet, overview: &[ClusterTransport]) -> u64 {
    let of_overview = overview.iter().map(|cluster| memory_of(cluster, cluster.near.surface.len()));
    PATCH_BYTES * set.patches.len() as u64 + of_overview.sum::<u64>()
}

/// Memory of voxels of so many bytes.
pub(super) fn voxel_memory(bytes: u64) -> u64 {
    bytes * ELEMENT_BYTES / STORED_BYTES
}
