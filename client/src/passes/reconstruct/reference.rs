//! Cluster coefficients to irradiance, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::ClusterTable;

use crate::threads::Threads;

/// `E_r = max(N_r + U_r · b_c, −F_r)`, or the sum itself without F, as [`ClusterTable::reconstruct`].
pub fn reconstruct(table: &ClusterTable, b: &[Vec4], start: &[Vec4], beside: Option<&[Vec4]>) -> Vec<Vec4> {
    table.reconstruct(&Threads, b, start, beside)
}
