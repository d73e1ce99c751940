//! Light of near hits, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::{Irradiance, NearTable, ReceiverTable};

use crate::threads::Threads;

/// `N(r) = w_r Σ_y ρ/π·(E_dir(y) + E_emit + E_ind)`, as [`NearTable::gather`].
pub fn near(
    table: &NearTable,
    receivers: &ReceiverTable,
    dir: &[Vec4],
    irradiance: Irradiance<'_>,
) -> Vec<Vec4> {
    table.gather(&Threads, receivers, dir, irradiance)
}
