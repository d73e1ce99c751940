//! Light at receivers, read from the adapter.

use glam::Vec4;

use crate::bake::{LightPasses, ReceiverBuffers, ReceiverLight};
use crate::error::Result;
use crate::passes::gpu::Gpu;

/// Light of passes at their receivers, E_ind with what objects give and take, after a wait; `None` for a kind without receivers.
pub(super) fn read(gpu: &Gpu, light: &dyn LightPasses) -> Result<Option<ReceiverLight>> {
    let Some(ReceiverBuffers { direct, emit, indirect, count, probes }) = light.at_receivers() else {
        return Ok(None);
    };
    let probes = probes.filter(|(_, rows)| *rows > 0);
    let mut found = ReceiverLight {
        direct: gpu.read(direct, count)?,
        emit: gpu.read(emit, count)?,
        indirect: gpu.read(indirect, count)?,
        probes: probes.map_or(Ok(Vec::new()), |(rows, count)| gpu.read(rows, count))?,
    };
    if let Some(at) = light.moved() {
        let moved: Vec<Vec4> = gpu.read(at.moved, count)?;
        found.add_moved(&moved);
    }
    Ok(Some(found))
}
