//! Cluster coefficients to irradiance, on the processor.

use glam::Vec4;
use rayon::prelude::*;

use crate::bake::{Cluster, ClusterTable};

/// `E_ind(r) = max(N(r) + U_r · b_c, −E_emit(r))` in W·m⁻², by slot; METHOD §2 "Clusters and factors".
///
/// Truncation and ringing can make a sum slightly negative. What is clamped at 0 is the sum with E_emit, as in
/// [`lightkiln_proto::prt::reconstruct::irradiance`], so that no light is gained by clamping parts.
pub fn reconstruct(table: &ClusterTable, b: &[Vec4], e_near: &[Vec4], e_emit: &[Vec4]) -> Vec<Vec4> {
    let receivers = |cluster: &Cluster| {
        let cluster = *cluster;
        (0..cluster.receiver_count).map(move |receiver| {
            let slot = cluster.first_receiver + receiver;
            row_sum(table, &cluster, receiver, b, e_near[slot]).max(-e_emit[slot])
        })
    };
    table.clusters.par_iter().flat_map_iter(receivers).collect()
}

/// Adds to `near`.
fn row_sum(table: &ClusterTable, cluster: &Cluster, receiver: usize, b: &[Vec4], near: Vec4) -> Vec4 {
    let u = &table.u[cluster.first_u + receiver * cluster.rank..][..cluster.rank];
    let b = &b[cluster.first_b..][..cluster.rank];
    u.iter().zip(b).fold(near, |sum, (u, b)| sum + *u * *b)
}
