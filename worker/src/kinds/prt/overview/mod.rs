//! Task `prt.overview`: light of a few of a bake's receivers from coarse patches, which comes first over a line.
//!
//! Its clusters are of the same form as the bake's, over some of the bake's receivers and of the bake's patches; a client that
//! has no more than these and the patches lets them stand for all others.

mod coarse;
mod factor;
mod rows;

use std::collections::HashSet;

use glam::Vec3;
use lightkiln_proto::chunk::{
    EncodedCluster, QuantisationSettings, decode_cluster, decode_patches, encode_cluster,
};
use lightkiln_proto::content::{ClusterTransport, EmitterIrradiance, PatchSet, Receivers, TransportFactors};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_proto::relight::STAND_IN_LEVEL;
use rayon::prelude::*;

use self::coarse::{Name, OverviewPatches};
use self::factor::{CoarsePart, parts};
use self::rows::{CoarseRow, rows};
use super::plan::PATCH_SET;
use crate::factors::{TruncationBounds, cells};
use crate::lightmap::Numbering;
use crate::task::{Context, Progress, TaskError, TaskOutput};

/// Begin of the names of its chunks among outputs.
pub const OUTPUT: &str = "chunk/";

/// Size of an overview.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// Least level of its patches. More → fewer bytes, less exact.
    pub level: u64,
    /// Its receivers are one of each square of so many texels. More → fewer bytes, less exact.
    pub stride: u16,
    /// Most receivers of a cell.
    pub cell_receivers: u32,
    /// Truncation of its factors.
    pub bounds: TruncationBounds,
    /// Relative error of quantisation.
    pub quantisation_error: f32,
}

impl Size {
    /// The size that bakes have: some three hundredths of the light's bytes in Sponza (`tests/studies/first-light.md`).
    pub const BAKED: Self = Self::new(STAND_IN_LEVEL, 4, 0.05);

    /// Of a level, a stride and a relative error, which truncation and quantisation have each.
    pub const fn new(level: u64, stride: u16, error: f32) -> Self {
        Self {
            level,
            stride,
            cell_receivers: 1024,
            bounds: TruncationBounds { rank_max: 32, error_max: error },
            quantisation_error: error,
        }
    }
}

/// Runs the task: inputs are `patch-set` and `cluster/N/chunk/M` of all cells; outputs `chunk/N`.
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let unread = |error| TaskError::bad_input_from("a chunk of the bake cannot be read", error);
    let set = decode_patches(&context.bytes(PATCH_SET)?).map_err(unread)?;
    let is_chunk =
        |artefact: &&Artefact| artefact.name.starts_with("cluster/") && artefact.name.contains("/chunk/");
    let chunks: Vec<Digest> =
        context.inputs.iter().filter(is_chunk).map(|artefact| artefact.digest).collect();
    context.source.bring(&chunks)?;
    let cluster = |index: usize| decode_cluster(&context.source.get(chunks[index])?).map_err(unread);
    let clusters = overview(&set, chunks.len(), cluster, Size::BAKED, context.progress)?;
    let mut output = TaskOutput::default();
    output.counters.insert("clusters".to_owned(), clusters.len() as f64);
    let named = |(number, cluster): (usize, EncodedCluster)| (format!("{OUTPUT}{number}"), cluster.bytes);
    output.artefacts.extend(clusters.into_iter().enumerate().map(named));
    Ok(output)
}

/// The overview's clusters of a bake with these patches and `count` clusters, each of which `cluster` decodes, twice.
pub fn overview(
    set: &PatchSet,
    count: usize,
    cluster: impl Fn(usize) -> Result<ClusterTransport, TaskError> + Sync,
    size: Size,
    progress: &Progress,
) -> Result<Vec<EncodedCluster>, TaskError> {
    let coarse = OverviewPatches::new(set, size.level);
    let names = |index: usize| -> Result<Vec<Name>, TaskError> {
        progress.check()?;
        let Receivers { blocks, block, texel, .. } = cluster(index)?.receivers;
        Ok(block.iter().map(|&block| blocks[usize::from(block)]).zip(texel).collect())
    };
    let present: Vec<Vec<Name>> = (0..count).into_par_iter().map(names).collect::<Result<_, _>>()?;
    let present: HashSet<Name> = present.into_iter().flatten().collect();
    let chosen = coarse.chosen(&present, size.stride);
    let of_cluster = |index: usize| -> Result<Vec<CoarseRow>, TaskError> {
        progress.check()?;
        Ok(rows(&coarse, &chosen, &cluster(index)?))
    };
    let found: Vec<Vec<CoarseRow>> = (0..count).into_par_iter().map(of_cluster).collect::<Result<_, _>>()?;
    let found: Vec<CoarseRow> = found.into_iter().flatten().collect();
    let positions_m: Vec<Vec3> = found.iter().map(|row| Vec3::from(row.receiver.position_m[0])).collect();
    let of_cell = |cell: &_| -> Result<Vec<ClusterTransport>, TaskError> {
        let parts = parts(&found, &positions_m, cell, size.bounds, progress)?;
        Ok(parts.into_iter().map(|part| transport(&found, part)).collect())
    };
    let cells = cells(&positions_m, size.cell_receivers);
    let clusters: Vec<Vec<ClusterTransport>> = cells.par_iter().map(of_cell).collect::<Result<_, _>>()?;
    let quantisation = QuantisationSettings { relative_error: size.quantisation_error, levels: 1 };
    let encoded = clusters.par_iter().flatten().map(|cluster| encode_cluster(cluster, quantisation));
    encoded
        .collect::<Result<_, _>>()
        .map_err(|error| TaskError::bad_input_from("an overview cannot be stored", error))
}

/// A part of a cell as a cluster.
fn transport(rows: &[CoarseRow], CoarsePart { part, keys }: CoarsePart) -> ClusterTransport {
    let rows: Vec<&CoarseRow> = part.receivers.iter().map(|&at| &rows[at as usize]).collect();
    let factors = part.factored.factors;
    let blocks = Numbering::of(rows.iter().map(|row| row.receiver.blocks[0]));
    let mut receivers = Receivers { blocks: blocks.values().to_vec(), ..Receivers::default() };
    let mut bounds_m = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    for CoarseRow { receiver, .. } in &rows {
        receivers.block.push(blocks.place_u16(receiver.blocks[0]));
        receivers.texel.extend(&receiver.texel);
        receivers.position_m.extend(&receiver.position_m);
        receivers.normal.extend(&receiver.normal);
        receivers.albedo.extend(&receiver.albedo);
        receivers.emission.extend(&receiver.emission);
        receivers.links.extend(&receiver.links);
        receivers.coverage.extend(&receiver.coverage);
        receivers.edge.extend(&receiver.edge);
        let position_m = Vec3::from(receiver.position_m[0]);
        bounds_m = [bounds_m[0].min(position_m), bounds_m[1].max(position_m)];
    }
    let named = rows.iter().flat_map(|row| &row.emitters).map(|(emitter, _)| *emitter);
    let of_emitter = |&emitter: &u16| {
        let at = |row: &&CoarseRow| {
            row.emitters.iter().find(|(other, _)| *other == emitter).map_or([0.0; 3], |(_, e)| *e)
        };
        EmitterIrradiance { emitter, irradiance: rows.iter().map(at).collect() }
    };
    ClusterTransport {
        bounds_m: bounds_m.map(Into::into),
        receivers,
        factors: TransportFactors {
            keys,
            rank: factors.rank as u32,
            u: factors.u,
            vt: factors.vt,
            ..TransportFactors::default()
        },
        emitters: Numbering::of(named).values().iter().map(of_emitter).collect(),
        ..ClusterTransport::default()
    }
}
