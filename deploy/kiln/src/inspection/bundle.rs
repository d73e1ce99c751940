//! Figures of a whole bake, from its manifest.

use std::collections::BTreeMap;
use std::fmt;

use lightkiln_proto::manifest::{ChunkRef, ClusterRef, Manifest, Totals};
use serde::Serialize;

/// Clusters listed as the worst.
const WORST_COUNT: usize = 5;

/// A bake in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BundleFigures {
    /// Totals as the manifest states them.
    pub totals: Totals,
    /// Texel size in metres.
    pub texel_m: f32,
    /// Distance between probes in metres.
    pub probe_spacing_m: f32,
    /// Atlas pages: width and height in texels.
    pub pages: Vec<[u32; 2]>,
    /// Blocks in them.
    pub blocks: usize,
    /// Bytes by kind of chunk.
    pub bytes: BTreeMap<&'static str, u64>,
    /// Bytes of the clusters' chunks by layer, coarsest first; the last holds all that the ones before it do not.
    pub layer_bytes: Vec<u64>,
    /// Clusters by rank.
    pub ranks: BTreeMap<u32, u64>,
    /// Truncation error: mean over receivers, and highest.
    pub truncation_error: Spread,
    /// Quantisation error: mean over receivers, and highest.
    pub quantisation_error: Spread,
    /// Clusters with the highest truncation error.
    pub worst_truncated: Vec<ClusterFigures>,
    /// Clusters with the highest uncovered fraction.
    pub worst_covered: Vec<ClusterFigures>,
}

/// Mean over receivers and highest of something that clusters have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean, weighted by receivers.
    pub mean: f64,
    /// Highest.
    pub max: f64,
}

/// One cluster.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClusterFigures {
    /// Its chunk.
    pub digest: String,
    /// Middle of its bounds, in metres.
    pub middle_m: [f32; 3],
    /// Receivers.
    pub receivers: u32,
    /// Supporting probes.
    pub probes: u32,
    /// Rank.
    pub rank: u32,
    /// Bytes of its chunk.
    pub bytes: u64,
    /// Relative truncation error.
    pub truncation_error: f32,
    /// Share of its light that no probe sees.
    pub uncovered_fraction: f32,
}

impl BundleFigures {
    /// Sums a manifest up.
    pub fn of(manifest: &Manifest) -> Self {
        let bytes_of = |chunks: &[ChunkRef]| chunks.iter().map(|chunk| chunk.bytes).sum::<u64>();
        let clusters = &manifest.clusters;
        let mut ranks = BTreeMap::new();
        for cluster in clusters {
            *ranks.entry(cluster.rank).or_insert(0) += 1;
        }
        Self {
            totals: manifest.totals.clone(),
            texel_m: manifest.texel_m,
            probe_spacing_m: manifest.probe_spacing_m,
            pages: manifest.pages.clone(),
            blocks: manifest.blocks.len(),
            bytes: BTreeMap::from([
                ("clusters", clusters.iter().map(|cluster| cluster.bytes).sum()),
                ("geometry", bytes_of(&manifest.geometry)),
                ("patches", bytes_of(&manifest.patches)),
                ("probes", bytes_of(&manifest.probes)),
                ("textures", bytes_of(&manifest.textures)),
            ]),
            layer_bytes: layer_bytes(clusters),
            ranks,
            truncation_error: spread(clusters, |cluster| cluster.truncation_error),
            quantisation_error: spread(clusters, |cluster| cluster.quantisation_error),
            worst_truncated: worst(clusters, |cluster| cluster.truncation_error),
            worst_covered: worst(clusters, |cluster| cluster.uncovered_fraction),
        }
    }
}

/// Bytes that each layer adds, over all clusters.
fn layer_bytes(clusters: &[ClusterRef]) -> Vec<u64> {
    let mut sums = Vec::new();
    for cluster in clusters {
        let mut before = 0;
        for (index, layer) in cluster.layers.iter().enumerate() {
            if sums.len() == index {
                sums.push(0);
            }
            sums[index] += layer.bytes.saturating_sub(before);
            before = layer.bytes;
        }
    }
    sums
}

fn spread(clusters: &[ClusterRef], value: impl Fn(&ClusterRef) -> f32) -> Spread {
    let receivers: f64 = clusters.iter().map(|cluster| f64::from(cluster.receivers)).sum();
    let weighted = clusters.iter().map(|cluster| f64::from(value(cluster)) * f64::from(cluster.receivers));
    let mean = weighted.sum::<f64>() / receivers.max(1.0);
    let max = clusters.iter().map(|cluster| f64::from(value(cluster))).fold(0.0, f64::max);
    Spread { mean, max }
}

/// Highest first; equal ones by digest, so that the list is the same each time.
fn worst(clusters: &[ClusterRef], value: impl Fn(&ClusterRef) -> f32) -> Vec<ClusterFigures> {
    let mut sorted: Vec<&ClusterRef> = clusters.iter().collect();
    sorted.sort_by(|a, b| value(b).total_cmp(&value(a)).then(a.digest.cmp(&b.digest)));
    sorted.into_iter().take(WORST_COUNT).map(ClusterFigures::of).collect()
}

impl ClusterFigures {
    fn of(cluster: &ClusterRef) -> Self {
        let [low, high] = cluster.bounds_m;
        Self {
            digest: cluster.digest.to_string(),
            middle_m: std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis])),
            receivers: cluster.receivers,
            probes: cluster.probes,
            rank: cluster.rank,
            bytes: cluster.bytes,
            truncation_error: cluster.truncation_error,
            uncovered_fraction: cluster.uncovered_fraction,
        }
    }
}

impl fmt::Display for BundleFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let totals = &self.totals;
        writeln!(f, "receivers   {} in {} blocks, texel {} m", totals.receivers, self.blocks, self.texel_m)?;
        writeln!(f, "pages       {:?}", self.pages)?;
        writeln!(f, "probes      {}, spacing {} m", totals.probes, self.probe_spacing_m)?;
        writeln!(f, "patches     {}", totals.patches)?;
        writeln!(
            f,
            "clusters    {}, mean rank {:.2}, highest {}",
            totals.clusters, totals.mean_rank, totals.rank_max
        )?;
        writeln!(f, "triangles   {}", totals.triangles)?;
        write!(f, "bytes       {}:", totals.bytes)?;
        for (kind, bytes) in &self.bytes {
            write!(f, " {kind} {bytes}")?;
        }
        let per_receiver = totals.bytes_light as f64 / totals.receivers.max(1) as f64;
        writeln!(
            f,
            "\n            {per_receiver:.1} a receiver for light (probes or patches, and clusters)"
        )?;
        writeln!(f, "layers      {:?} bytes, coarsest first", self.layer_bytes)?;
        write!(f, "ranks      ")?;
        for (rank, count) in &self.ranks {
            write!(f, " {rank}×{count}")?;
        }
        let (cut, rounded) = (self.truncation_error, self.quantisation_error);
        writeln!(f, "\ntruncation  mean {:.4}, highest {:.4}", cut.mean, cut.max)?;
        writeln!(f, "rounding    mean {:.4}, highest {:.4}", rounded.mean, rounded.max)?;
        writeln!(f, "uncovered   {:.4}", totals.uncovered_fraction)?;
        writeln!(f, "worst truncated:")?;
        self.worst_truncated.iter().try_for_each(|cluster| writeln!(f, "  {cluster}"))?;
        writeln!(f, "worst covered:")?;
        self.worst_covered.iter().try_for_each(|cluster| writeln!(f, "  {cluster}"))
    }
}

impl fmt::Display for ClusterFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.middle_m;
        write!(
            f,
            "{} at {x:.2},{y:.2},{z:.2}: {} receivers, {} probes, rank {}, {} bytes, truncation {:.4}, uncovered {:.4}",
            &self.digest[..12],
            self.receivers,
            self.probes,
            self.rank,
            self.bytes,
            self.truncation_error,
            self.uncovered_fraction
        )
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::ids::Digest;
    use lightkiln_proto::manifest::Layer;

    use super::*;

    fn cluster(name: &str, receivers: u32, error: f32, layers: &[u64]) -> ClusterRef {
        let layer = |bytes: &u64| Layer { bytes: *bytes, level: 0, bands: 0, rank: 1 };
        ClusterRef {
            digest: Digest::of(name.as_bytes()),
            bytes: 100,
            bounds_m: [[0.0; 3], [2.0; 3]],
            receivers,
            probes: 4,
            rank: 3,
            truncation_error: error,
            quantisation_error: 0.0,
            uncovered_fraction: 0.0,
            layers: layers.iter().map(layer).collect(),
        }
    }

    #[test]
    fn layers_count_what_each_adds() {
        let clusters = [cluster("a", 1, 0.0, &[10, 30, 100]), cluster("b", 1, 0.0, &[5, 6])];
        assert_eq!(layer_bytes(&clusters), [15, 21, 70]);
    }

    #[test]
    fn mean_error_is_weighted_by_receivers_and_the_worst_cluster_comes_first() {
        let clusters = [cluster("a", 3, 0.1, &[]), cluster("b", 1, 0.5, &[])];
        let errors = spread(&clusters, |cluster| cluster.truncation_error);
        assert!((errors.mean - 0.2).abs() < 1e-6 && (errors.max - 0.5).abs() < 1e-6, "{errors:?}");
        let first = &worst(&clusters, |cluster| cluster.truncation_error)[0];
        assert_eq!((first.digest.clone(), first.middle_m), (Digest::of(b"b").to_string(), [1.0; 3]));
    }
}
