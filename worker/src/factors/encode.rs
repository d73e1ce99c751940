//! A cell's clusters as chunks, and the account that assemble gives of them.

use std::collections::BTreeMap;

use lightkiln_proto::chunk::{EncodedCluster, QuantisationSettings, encode_cluster};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{ChunkRef, ClusterRow, ClusterTotals, PrefixCheck};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::Piece;
use crate::task::{Context, TaskError, TaskOutput};
use crate::transport::Row;

/// Clusters that the report lists as the worst.
const WORST: usize = 10;

/// Account of one cell, or of all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellIndex {
    /// Its clusters.
    pub clusters: Vec<ClusterRow>,
    /// Chunk of each; that of cluster N is output `chunk/N`.
    pub chunks: Vec<ChunkRef>,
    /// Upper bound of S1's own criterion for each cluster.
    pub s1_criterion_bounds: Vec<f32>,
    /// Sums over its receivers of [`Row`]'s `lit`, `uncovered` and `left_out`; without those of cavities.
    pub lit: f64,
    /// See `lit`.
    pub uncovered: f64,
    /// See `lit`.
    pub left_out: f64,
    /// Receivers that no light can reach: left out of the clusters.
    pub receivers_without_light: u64,
}

impl CellIndex {
    /// Sums of rows, each with whether it is dead. Dead receivers with less than `cavity_m` of free path are inside solids
    /// and miss nothing; other dead ones count as uncovered with all that they see.
    pub fn of<'a>(rows: impl Iterator<Item = (&'a Row, bool)>, cavity_m: f32) -> Self {
        let mut index = Self::default();
        for (row, is_dead) in rows {
            index.receivers_without_light += u64::from(is_dead);
            if !(is_dead && row.mean_path_m < cavity_m) {
                index.lit += f64::from(row.lit);
                index.uncovered += f64::from(row.uncovered);
                index.left_out += f64::from(row.left_out);
            }
        }
        index
    }

    /// Accounts of all cells among a task's inputs, in the order of the plan.
    pub fn of_inputs(context: &Context) -> Result<Self, TaskError> {
        let mut all = Self::default();
        let is_index = |name: &str| name.starts_with("cluster/") && name.ends_with("/index");
        let indices = context.inputs.iter().filter(|artefact| is_index(&artefact.name));
        let digests: Vec<Digest> = indices.map(|artefact| artefact.digest).collect();
        context.source.bring(&digests)?;
        for digest in digests {
            let bytes = context.source.get(digest)?;
            let part = Self::decoded(&bytes)?;
            all.clusters.extend(part.clusters);
            all.chunks.extend(part.chunks);
            all.s1_criterion_bounds.extend(part.s1_criterion_bounds);
            all.lit += part.lit;
            all.uncovered += part.uncovered;
            all.left_out += part.left_out;
            all.receivers_without_light += part.receivers_without_light;
        }
        Ok(all)
    }
}

impl CellIndex {
    /// Name of the account among a task's outputs.
    pub const OUTPUT: &str = "index";

    /// The account of a cell from its artefact.
    pub fn decoded(bytes: &[u8]) -> Result<Self, TaskError> {
        serde_json::from_slice(bytes)
            .map_err(|error| TaskError::bad_input_from("the index of a cluster cannot be read", error))
    }

    /// The account as an artefact.
    pub fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        serde_json::to_vec(self)
            .map_err(|error| TaskError::bad_input_from("the cluster's index cannot be written", error))
    }

    /// The account with the clusters of the cell, but for their chunks.
    #[must_use]
    pub fn with_clusters(mut self, pieces: &[Piece], encoded: &[EncodedCluster]) -> Self {
        for (piece, encoded) in pieces.iter().zip(encoded) {
            self.s1_criterion_bounds.push(piece.s1_criterion_bound);
            self.clusters.push(ClusterRow {
                bounds_m: piece.transport.bounds_m,
                receivers: piece.transport.receivers.len() as u32,
                keys: encoded.keys,
                rank: piece.transport.factors.rank,
                truncation_error: piece.truncation_error,
                quantisation_error: encoded.quantisation_error,
                uncovered_fraction: piece.uncovered_fraction,
                layers: Vec::new(),
                checks: Vec::new(),
            });
        }
        self
    }

    /// Counts for people.
    pub fn counters(&self) -> BTreeMap<String, f64> {
        BTreeMap::from([
            ("clusters".to_owned(), self.clusters.len() as f64),
            ("receivers_without_light".to_owned(), self.receivers_without_light as f64),
        ])
    }

    /// Sums for the manifest.
    pub fn totals(&self) -> ClusterTotals {
        ClusterTotals {
            uncovered_fraction: self.uncovered / self.lit.max(1.0),
            left_out_fraction: self.left_out / self.lit.max(1.0),
            receivers_without_light: self.receivers_without_light,
            ..ClusterTotals::of(&self.clusters)
        }
    }

    /// The report's part about clusters: S1's own criterion, and the worst clusters.
    pub fn report(&self, rank_error: f32) -> Value {
        let bounds = &self.s1_criterion_bounds;
        let worst = |value: fn(&ClusterRow) -> f32| {
            let mut order: Vec<(&ClusterRow, &ChunkRef)> = self.clusters.iter().zip(&self.chunks).collect();
            order.sort_by(|a, b| value(b.0).total_cmp(&value(a.0)).then(a.1.digest.cmp(&b.1.digest)));
            let entry = |(row, chunk): &(&ClusterRow, &ChunkRef)| json!({ "digest": chunk.digest, "bounds_m": row.bounds_m, "value": value(row) });
            order.iter().take(WORST).filter(|(row, _)| value(row) > 0.0).map(entry).collect::<Vec<_>>()
        };
        json!({
            "totals": self.totals(),
            "s1_criterion_at_most": {
                "mean": bounds.iter().map(|bound| f64::from(*bound)).sum::<f64>() / bounds.len().max(1) as f64,
                "max": bounds.iter().fold(0.0_f32, |max, bound| max.max(*bound)),
            },
            "clusters_above_rank_error":
                self.clusters.iter().filter(|row| row.truncation_error > rank_error).count(),
            "worst_clusters": {
                "truncation_error": worst(|row| row.truncation_error),
                "quantisation_error": worst(|row| row.quantisation_error),
                "uncovered_fraction": worst(|row| row.uncovered_fraction),
            },
        })
    }
}

/// Encodes the pieces of a cell: outputs `chunk/N` and `index`.
pub fn stored(
    pieces: &[Piece],
    quantisation: QuantisationSettings,
    index: CellIndex,
) -> Result<TaskOutput, TaskError> {
    let encoded = encoded(pieces, quantisation)?;
    let index = index.with_clusters(pieces, &encoded);
    Ok(stored_as(encoded, index)?.0)
}

/// The pieces of a cell as chunks.
pub fn encoded(
    pieces: &[Piece],
    quantisation: QuantisationSettings,
) -> Result<Vec<EncodedCluster>, TaskError> {
    pieces
        .par_iter()
        .map(|piece| encode_cluster(&piece.transport, quantisation))
        .collect::<Result<_, _>>()
        .map_err(|error| TaskError::bad_input_from("a cluster cannot be stored", error))
}

/// Outputs `chunk/N` and `index` of a cell whose clusters are encoded, and whose account has all of them but their chunks; and
/// the whole account.
pub fn stored_as(
    encoded: Vec<EncodedCluster>,
    mut index: CellIndex,
) -> Result<(TaskOutput, CellIndex), TaskError> {
    let mut output = TaskOutput::default();
    index.chunks.clear();
    for (number, (encoded, row)) in encoded.into_iter().zip(&mut index.clusters).enumerate() {
        index.chunks.push(ChunkRef { digest: Digest::of(&encoded.bytes), bytes: encoded.bytes.len() as u64 });
        row.checks = PrefixCheck::of_prefixes(&encoded.bytes, &encoded.layers);
        row.layers = encoded.layers;
        output.artefacts.push((format!("chunk/{number}"), encoded.bytes));
    }
    output.artefacts.push((CellIndex::OUTPUT.into(), index.encoded()?));
    output.counters = index.counters();
    Ok((output, index))
}
