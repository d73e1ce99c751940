//! Radiance at the probes' hits, projected to spherical harmonics, on the processor.

use glam::Vec4;
use lightkiln_proto::kinds::sh::ProbeTable;
use lightkiln_proto::relight::{Columns, Irradiance, ReceiverTable};

use crate::threads::Threads;

/// `λ_pj = 4π/K Σ_k L(y_pk) Y_j(ω_k)`, as [`ProbeTable::surface_lambda`]; the sky's coefficients are left out.
pub fn relight(table: &ProbeTable, receivers: &ReceiverTable, irradiance: Irradiance<'_>) -> Vec<Vec4> {
    table.surface_lambda(&Threads, receivers, irradiance)
}
