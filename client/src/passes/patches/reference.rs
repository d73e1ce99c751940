//! Mean radiance of patches, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::{Columns, Irradiance, PatchTable, ReceiverTable};

use crate::threads::Threads;

/// `lambda[s]`: area-weighted mean of `L = ρ/π·(E_dir + E_emit + E_ind)` over patch s, as
/// [`PatchTable::surface_lambda`]; then the differences. The parts of the sky are left out.
pub fn mean_radiance(table: &PatchTable, receivers: &ReceiverTable, irradiance: Irradiance<'_>) -> Vec<Vec4> {
    table.surface_lambda(&Threads, receivers, irradiance)
}
