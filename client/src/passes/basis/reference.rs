//! λ to cluster coefficients, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::ClusterTable;

use crate::threads::Threads;

/// `b_c = s (ΣVᵀ) λ|_c`, as [`ClusterTable::basis`].
pub fn basis(table: &ClusterTable, lambda: &[Vec4]) -> Vec<Vec4> {
    table.basis(&Threads, lambda)
}
