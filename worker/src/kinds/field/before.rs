//! Tasks alike that gathered the same probes before: their results stand while nothing that they read has changed.

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::TaskKind;
use serde_json::json;

use super::fit::Around;
use super::{GatherParams, Survey};
use crate::emitters::EmitterSet;
use crate::factors::ClusterCell;
use crate::reads::Common;

/// The name of the task of a cell's probes: of all that it surely depends on. The rest is in its record.
pub fn alike(
    common: &Common,
    gather: TaskKind,
    survey: &Survey,
    (cell, settings): (&ClusterCell, &GatherParams),
    bounds_m: [Vec3; 2],
    emitters: &EmitterSet,
) -> Digest {
    let around = Around::of(survey, &cell.receivers, settings.is_fitted);
    let probes: Vec<_> = around.probes.iter().map(|&probe| survey.probes[probe as usize]).collect();
    let cells: Vec<[i32; 3]> = around.cells.iter().map(|cell| cell.to_array()).collect();
    let numbers = [bounds_m[0], bounds_m[1]].map(|corner_m| corner_m.to_array().map(f32::to_bits));
    let radiance: Vec<[u32; 3]> = emitters.radiance().iter().map(|of| of.map(f32::to_bits)).collect();
    // Which of the cells it is says nothing about it.
    let settings = GatherParams { cell: 0, ..settings.clone() };
    let all = json!([
        gather.name,
        gather.version,
        settings,
        survey.step_m.to_bits(),
        cell.receivers.len(),
        probes,
        cells,
        around.tetrahedra,
        numbers,
        radiance,
    ]);
    common.name(all.to_string().as_bytes())
}
