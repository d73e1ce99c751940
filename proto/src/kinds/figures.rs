//! Figures of a bake, for people and as JSON.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::manifest::{ChunkRef, ClusterRow, ClusterTotals, Manifest, with_chunks};

/// Clusters listed as the worst.
const WORST_COUNT: usize = 5;

/// Figures by name, and the same in lines for people.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// By name, as `--json` prints them.
    pub json: Map<String, Value>,
    /// Lines, each ended.
    pub words: String,
}

/// Figures of factorised clusters: counts, bytes by layer, ranks, errors, the worst.
pub fn cluster_figures(manifest: &Manifest, totals: &ClusterTotals) -> Figures {
    let rows = &manifest.clusters;
    let mut ranks: BTreeMap<u32, u64> = BTreeMap::new();
    for row in rows {
        *ranks.entry(row.rank).or_default() += 1;
    }
    let layer_bytes = layer_bytes(rows);
    let truncation = Spread::of(rows, |row| row.truncation_error);
    let quantisation = Spread::of(rows, |row| row.quantisation_error);
    let worst_truncated = worst(manifest, |row| row.truncation_error);
    let bytes_per_receiver = manifest.bytes_light() as f64 / totals.receivers.max(1) as f64;
    let mut words = format!(
        "receivers   {}\nclusters    {}, mean rank {:.2}, highest {}\n\
         light       {bytes_per_receiver:.1} bytes a receiver\nlayers      {layer_bytes:?} bytes, coarsest first\nranks      ",
        totals.receivers, totals.clusters, totals.mean_rank, totals.rank_max,
    );
    for (rank, count) in &ranks {
        words += &format!(" {rank}×{count}");
    }
    words += &format!(
        "\ntruncation  mean {:.4}, highest {:.4}\nrounding    mean {:.4}, highest {:.4}\nuncovered   {:.4}\n",
        truncation.mean, truncation.max, quantisation.mean, quantisation.max, totals.uncovered_fraction,
    );
    words += "worst truncated:\n";
    words.extend(worst_truncated.iter().map(Worst::line));
    let json = json!({
        "receivers": totals.receivers,
        "clusters": totals.clusters,
        "mean_rank": totals.mean_rank,
        "rank_max": totals.rank_max,
        "uncovered_fraction": totals.uncovered_fraction,
        "left_out_fraction": totals.left_out_fraction,
        "receivers_without_light": totals.receivers_without_light,
        "bytes_per_receiver": bytes_per_receiver,
        "layer_bytes": layer_bytes,
        "ranks": ranks,
        "truncation_error": truncation.json(),
        "quantisation_error": quantisation.json(),
        "worst_truncated": worst_truncated.iter().map(Worst::json).collect::<Vec<_>>(),
    });
    let Value::Object(json) = json else { unreachable!("it was made an object above") };
    Figures { json, words }
}

/// Bytes that each layer adds, over all clusters.
fn layer_bytes(rows: &[ClusterRow]) -> Vec<u64> {
    let mut sums = Vec::new();
    for row in rows {
        let mut before = 0;
        for (index, layer) in row.layers.iter().enumerate() {
            if sums.len() == index {
                sums.push(0);
            }
            sums[index] += layer.bytes.saturating_sub(before);
            before = layer.bytes;
        }
    }
    sums
}

/// Receiver-weighted mean and maximum of something that clusters have.
struct Spread {
    mean: f64,
    max: f64,
}

impl Spread {
    fn of(rows: &[ClusterRow], value: impl Fn(&ClusterRow) -> f32) -> Self {
        let receivers: f64 = rows.iter().map(|row| f64::from(row.receivers)).sum();
        let weighted = rows.iter().map(|row| f64::from(value(row)) * f64::from(row.receivers));
        let mean = weighted.sum::<f64>() / receivers.max(1.0);
        Self { mean, max: rows.iter().map(|row| f64::from(value(row))).fold(0.0, f64::max) }
    }

    fn json(&self) -> Value {
        json!({ "mean": self.mean, "max": self.max })
    }
}

/// A cluster with a high error.
struct Worst<'a> {
    row: &'a ClusterRow,
    chunk: &'a ChunkRef,
}

/// Highest first; equal ones by digest, so that the list is the same each time.
fn worst(manifest: &Manifest, value: impl Fn(&ClusterRow) -> f32) -> Vec<Worst<'_>> {
    let mut sorted: Vec<Worst<'_>> = with_chunks(manifest).map(|(row, chunk)| Worst { row, chunk }).collect();
    sorted.sort_by(|a, b| value(b.row).total_cmp(&value(a.row)).then(a.chunk.digest.cmp(&b.chunk.digest)));
    sorted.truncate(WORST_COUNT);
    sorted
}

impl Worst<'_> {
    fn json(&self) -> Value {
        json!({
            "digest": self.chunk.digest,
            "middle_m": self.row.middle_m(),
            "receivers": self.row.receivers,
            "keys": self.row.keys,
            "rank": self.row.rank,
            "bytes": self.chunk.bytes,
            "truncation_error": self.row.truncation_error,
            "uncovered_fraction": self.row.uncovered_fraction,
        })
    }

    fn line(&self) -> String {
        let [x, y, z] = self.row.middle_m();
        format!(
            "  {} at {x:.2},{y:.2},{z:.2}: {} receivers, {} column keys, rank {}, {} bytes, truncation {:.4}, uncovered {:.4}\n",
            &self.chunk.digest.to_string()[..12],
            self.row.receivers,
            self.row.keys,
            self.row.rank,
            self.chunk.bytes,
            self.row.truncation_error,
            self.row.uncovered_fraction
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::Layer;

    fn row(receivers: u32, truncation_error: f32, layers: &[u64]) -> ClusterRow {
        let layer = |bytes: &u64| Layer { bytes: *bytes, level: 0, bands: 0, rank: 1 };
        ClusterRow {
            bounds_m: [[0.0; 3], [2.0; 3]],
            receivers,
            keys: 4,
            rank: 3,
            truncation_error,
            quantisation_error: 0.0,
            uncovered_fraction: 0.0,
            layers: layers.iter().map(layer).collect(),
            checks: Vec::new(),
        }
    }

    #[test]
    fn layers_count_the_bytes_that_each_adds() {
        assert_eq!(layer_bytes(&[row(1, 0.0, &[10, 30, 100]), row(1, 0.0, &[5, 6])]), [15, 21, 70]);
    }

    #[test]
    fn mean_error_is_weighted_by_receivers() {
        let errors = Spread::of(&[row(3, 0.1, &[]), row(1, 0.5, &[])], |row| row.truncation_error);
        assert!((errors.mean - 0.2).abs() < 1e-6 && (errors.max - 0.5).abs() < 1e-6);
    }
}
