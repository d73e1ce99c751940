//! Cluster coefficients to irradiance, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::ClusterTable;

use crate::threads::Threads;

/// `E_ind(r) = max(N(r) + U_r · b_c, −E_emit(r))`, as [`ClusterTable::reconstruct`].
pub fn reconstruct(table: &ClusterTable, b: &[Vec4], e_near: &[Vec4], e_emit: &[Vec4]) -> Vec<Vec4> {
    table.reconstruct(&Threads, b, e_near, e_emit)
}
