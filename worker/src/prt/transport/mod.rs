//! Transport task: α of a cluster's receivers, factorised and encoded (METHOD.md §2 "Reconstruct", "Clusters").

mod alpha;
mod components;
mod emitters;
mod split;
mod supporters;

use std::collections::BTreeMap;

use lightkiln_proto::chunk::{QuantisationSettings, encode_cluster};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::ClusterRef;
use lightkiln_proto::prt::Settings;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use alpha::{AlphaSampler, Row};
pub use emitters::{EmitterSet, emitter_of_material};
pub use split::{Piece, pieces};
pub use supporters::{Supporter, Supporters};

use super::runner::{Context, checked};
use crate::task::{TaskError, TaskOutput};

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// Cluster cell of the stage.
    cluster: usize,
    /// Settings of the bake.
    settings: Settings,
}

/// Free path, in texels, below which a place that nothing can see is a cavity of a solid: the inside of a column, say.
pub const CAVITY_TEXELS: f32 = 4.0;

/// Runs the task: inputs `scene`, `stage`; outputs `chunk/N` and `index` (a [`CellIndex`] as JSON).
pub fn run(context: &Context, params: &Params) -> Result<TaskOutput, TaskError> {
    checked(&params.settings)?;
    let world = context.world()?;
    let cell = world
        .stage
        .clusters
        .get(params.cluster)
        .ok_or_else(|| TaskError::bad_input("the task names a cluster that the stage does not have"))?;
    let sampler = AlphaSampler::new(&world, &params.settings, &cell.receivers);
    let rows = trace(context, &sampler, &cell.receivers)?;
    let pieces = pieces(&world, &params.settings, sampler.probes(), cell, &rows);
    store(&pieces, CellIndex::of(&rows, CAVITY_TEXELS * world.stage.texel_m))
}

/// α of every receiver of the cell, in order.
fn trace(context: &Context, sampler: &AlphaSampler, receivers: &[u32]) -> Result<Vec<Row>, TaskError> {
    let progress = context.progress;
    progress.begin(0.0, 0.9, receivers.len() as u64);
    receivers
        .par_iter()
        .map(|&receiver| {
            progress.check()?;
            let row = sampler.row(receiver);
            progress.add_rays_closest(row.rays_closest);
            progress.add_rays_occlusion(row.rays_occlusion);
            progress.advance(1);
            Ok(row)
        })
        .collect()
}

/// What assemble needs to know of a cell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellIndex {
    /// Its clusters; chunk N is output `chunk/N`.
    pub clusters: Vec<ClusterRef>,
    /// Upper bound of S1's own criterion for each cluster.
    pub s1_criterion_bounds: Vec<f32>,
    /// Sums over its receivers of [`alpha::Row`]'s `lit`, `uncovered` and `left_out`; without those of cavities.
    pub lit: f64,
    /// See `lit`.
    pub uncovered: f64,
    /// See `lit`.
    pub left_out: f64,
    /// Receivers that no light can reach: left out of the clusters.
    pub receivers_without_light: u64,
}

impl CellIndex {
    /// Sums of rows. Dead receivers with less than `cavity_m` of free path are inside solids and miss nothing; other dead
    /// ones count as uncovered with all that they see.
    fn of(rows: &[Row], cavity_m: f32) -> Self {
        let mut index = Self::default();
        for row in rows {
            index.receivers_without_light += u64::from(row.is_dead());
            if !(row.is_dead() && row.mean_path_m < cavity_m) {
                index.lit += f64::from(row.lit);
                index.uncovered += f64::from(row.uncovered);
                index.left_out += f64::from(row.left_out);
            }
        }
        index
    }
}

/// Encodes the pieces of a cell.
fn store(pieces: &[Piece], mut index: CellIndex) -> Result<TaskOutput, TaskError> {
    let mut output = TaskOutput::default();
    let counters = BTreeMap::from([
        ("clusters".to_owned(), pieces.len() as f64),
        ("receivers_without_light".to_owned(), index.receivers_without_light as f64),
    ]);
    for (number, piece) in pieces.iter().enumerate() {
        let encoded = encode_cluster(&piece.transport, QuantisationSettings::default())
            .map_err(|error| TaskError::bad_input_from("a cluster cannot be stored", error))?;
        index.s1_criterion_bounds.push(piece.s1_criterion_bound);
        index.clusters.push(ClusterRef {
            digest: Digest::of(&encoded.bytes),
            bytes: encoded.bytes.len() as u64,
            bounds_m: piece.transport.bounds_m,
            receivers: piece.transport.receivers.len() as u32,
            probes: piece.transport.probes.len() as u32,
            rank: piece.transport.rank,
            truncation_error: piece.truncation_error,
            quantisation_error: encoded.quantisation_error,
            uncovered_fraction: piece.uncovered_fraction,
            layers: encoded.layers,
        });
        output.artefacts.push((format!("chunk/{number}"), encoded.bytes));
    }
    let json = serde_json::to_vec(&index)
        .map_err(|error| TaskError::bad_input_from("the cluster's index cannot be written", error))?;
    output.artefacts.push(("index".into(), json));
    output.counters = counters;
    Ok(output)
}
