//! Probe coefficients to cluster coefficients, on the processor.

use glam::Vec4;
use rayon::prelude::*;

use crate::bake::{Cluster, ClusterTable};

/// `b_c = (ΣVᵀ) λ|_c`, all clusters' k numbers one after the other; METHOD §2 "Clusters and factors".
///
/// `lambda[p·J + j]` with `coefficients` = J, the sky last.
pub fn basis(table: &ClusterTable, lambda: &[Vec4], coefficients: usize) -> Vec<Vec4> {
    let rows = |cluster: &Cluster| {
        let cluster = *cluster;
        (0..cluster.rank).map(move |row| row_sum(table, &cluster, row, lambda, coefficients))
    };
    table.clusters.par_iter().flat_map_iter(rows).collect()
}

fn row_sum(
    table: &ClusterTable,
    cluster: &Cluster,
    row: usize,
    lambda: &[Vec4],
    coefficients: usize,
) -> Vec4 {
    let columns = cluster.columns();
    let vt = &table.vt[cluster.first_vt + row * columns..][..columns];
    let support = &table.support[cluster.first_support..][..cluster.support_count];
    let mut sum = Vec4::ZERO;
    for (vt, probe) in vt.chunks_exact(cluster.coefficients).zip(support) {
        let lambda = &lambda[*probe as usize * coefficients..][..cluster.coefficients];
        for (vt, lambda) in vt.iter().zip(lambda) {
            sum += *vt * *lambda;
        }
    }
    sum
}
