//! Transport task: α of a cluster's receivers, factorised and encoded (METHOD.md §2 "Reconstruct", "Clusters").

mod alpha;
mod components;
mod cut;
mod emitters;
mod expectation;
mod hemisphere;
mod near;
mod patches;
mod split;
mod supporters;

use std::collections::BTreeMap;

use lightkiln_proto::chunk::{QuantisationSettings, encode_cluster};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::ClusterRef;
use lightkiln_proto::prt::{BasisKind, ProbeKey, Settings};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use alpha::AlphaSampler;
pub use alpha::Row;
pub use emitters::{EmitterSet, emitter_of_material};
pub use split::{Piece, pieces};
pub use supporters::{Supporter, Supporters};

use super::runner::{Context, checked};
use super::world::World;
use crate::task::{Cancelled, Progress, TaskError, TaskOutput};

/// Parameters of the task.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// Cluster cell of the stage.
    cluster: usize,
    /// Settings of the bake.
    settings: Settings,
}

/// Free path, in texels, below which a place that no light can reach misses nothing: the inside of a column, say.
pub const DEAD_PATH_TEXELS: f32 = 4.0;

/// Error of quantisation as a share of that of truncation, with patches.
const QUANTISATION_SHARE: f32 = 0.7;
/// Least and most error of quantisation.
const QUANTISATION_ERROR: [f32; 2] = [2e-4, 0.05];

/// Runs the task: inputs `scene`, `stage`; outputs `chunk/N` and `index` (a [`CellIndex`] as JSON).
pub fn run(context: &Context, params: &Params) -> Result<TaskOutput, TaskError> {
    checked(&params.settings)?;
    let world = context.world()?;
    let cell = world
        .stage
        .clusters
        .get(params.cluster)
        .ok_or_else(|| TaskError::bad_input("the task names a cluster that the stage does not have"))?;
    let settings = &params.settings;
    let cell_rows = rows(&world, settings, &cell.receivers, Detail::AsBaked, context.progress)?;
    let pieces = pieces(&world, settings, &cell_rows.keys, cell, &cell_rows.rows);
    store(&pieces, settings, CellIndex::of(&cell_rows.rows, DEAD_PATH_TEXELS * world.stage.texel_m))
}

/// The transport matrix of some receivers.
pub struct CellRows {
    /// What each group of columns stands for, ascending; the sky's group follows.
    pub keys: Vec<ProbeKey>,
    /// One row per receiver, in order.
    pub rows: Vec<Row>,
}

/// How finely light is told apart that comes from patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// As the bake has it.
    AsBaked,
    /// By the finest patches: what the cut through their tree stands in for.
    Finest,
}

/// Traces rows.
pub fn rows(
    world: &World,
    settings: &Settings,
    receivers: &[u32],
    detail: Detail,
    progress: &Progress,
) -> Result<CellRows, Cancelled> {
    progress.begin(0.0, 0.9, receivers.len() as u64);
    match settings.basis {
        BasisKind::Sh => {
            let sampler = AlphaSampler::new(world, settings, receivers);
            let keys = sampler.probes().iter().map(|&probe| world.stage.probes[probe as usize].key).collect();
            let trace = |&receiver: &u32| {
                progress.check()?;
                let row = sampler.row(receiver);
                row.count(progress);
                Ok(row)
            };
            Ok(CellRows { keys, rows: receivers.par_iter().map(trace).collect::<Result<_, Cancelled>>()? })
        }
        BasisKind::Patches => patches::trace(world, settings, receivers, detail, progress),
    }
}

/// Quantisation may lose about as much as truncation, with patches: columns are differences there, and most of them are
/// then worth no bits.
fn quantisation(settings: &Settings) -> QuantisationSettings {
    match settings.basis {
        BasisKind::Sh => QuantisationSettings::default(),
        BasisKind::Patches => QuantisationSettings {
            relative_error: (QUANTISATION_SHARE * settings.rank_error)
                .clamp(QUANTISATION_ERROR[0], QUANTISATION_ERROR[1]),
            ..QuantisationSettings::default()
        },
    }
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
fn store(pieces: &[Piece], settings: &Settings, mut index: CellIndex) -> Result<TaskOutput, TaskError> {
    let quantisation = quantisation(settings);
    let mut output = TaskOutput::default();
    let counters = BTreeMap::from([
        ("clusters".to_owned(), pieces.len() as f64),
        ("receivers_without_light".to_owned(), index.receivers_without_light as f64),
    ]);
    let encoded: Vec<_> = pieces
        .par_iter()
        .map(|piece| encode_cluster(&piece.transport, quantisation))
        .collect::<Result<_, _>>()
        .map_err(|error| TaskError::bad_input_from("a cluster cannot be stored", error))?;
    for (number, (piece, encoded)) in pieces.iter().zip(encoded).enumerate() {
        index.s1_criterion_bounds.push(piece.s1_criterion_bound);
        index.clusters.push(ClusterRef {
            digest: Digest::of(&encoded.bytes),
            bytes: encoded.bytes.len() as u64,
            bounds_m: piece.transport.bounds_m,
            receivers: piece.transport.receivers.len() as u32,
            probes: encoded.probes,
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
