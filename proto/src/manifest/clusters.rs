//! Clusters as a bake's directory lists them, and sums over them, for kinds whose chunks are factorised clusters.

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{ChunkRef, Manifest, ManifestError};
use crate::ids::Digest;
use crate::kinds::{Figures, count_above};

/// Role of cluster chunks.
pub const CLUSTERS: &str = "clusters";

/// Role of clusters of an overview: light of some of the receivers from coarse patches, which a client may have first.
pub const OVERVIEW: &str = "overview";

/// A cluster, as one must know it to choose how much of its chunk to fetch. Row i belongs to the i-th chunk of role
/// [`CLUSTERS`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClusterRow {
    /// Bounds of its receivers, in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Receivers.
    pub receivers: u32,
    /// Keys of its columns.
    pub keys: u32,
    /// Rank.
    pub rank: u32,
    /// Relative truncation error √(Σ_{i>k} s²/Σ s²).
    pub truncation_error: f32,
    /// Relative error of quantisation, ‖decoded − exact‖/‖exact‖ of U·ΣVᵀ.
    pub quantisation_error: f32,
    /// Share of the rays along which light can come, weighted by albedo, whose end the columns do not know.
    pub uncovered_fraction: f32,
    /// Prefixes of the chunk that are coarser versions, smallest first; the last is the whole chunk.
    pub layers: Vec<Layer>,
    /// A check of each prefix but the last, which the chunk's digest checks.
    pub checks: Vec<PrefixCheck>,
}

/// First eight bytes of the digest of a prefix: a truncated or damaged one is known before the rest has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PrefixCheck(pub [u8; 8]);

impl PrefixCheck {
    /// That of some bytes.
    pub fn of(bytes: &[u8]) -> Self {
        let Digest(digest) = Digest::of(bytes);
        Self(std::array::from_fn(|index| digest[index]))
    }

    /// The checks of a chunk's prefixes, but for the last layer, which is the whole chunk.
    pub fn of_prefixes(bytes: &[u8], layers: &[Layer]) -> Vec<Self> {
        let prefixes = layers.split_last().map_or(&[][..], |(_, prefixes)| prefixes);
        prefixes.iter().map(|layer| Self::of(&bytes[..layer.bytes as usize])).collect()
    }
}

/// A usable prefix of a cluster chunk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Bytes from the start of the chunk.
    pub bytes: u64,
    /// Finest receiver level in it (0 is finest of all).
    pub level: u32,
    /// Highest band in it.
    pub bands: u32,
    /// Rank in it.
    pub rank: u32,
}

/// Sums over the clusters of a bake.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClusterTotals {
    /// Receivers.
    pub receivers: u64,
    /// Clusters.
    pub clusters: u64,
    /// Mean rank over clusters, weighted by receivers.
    pub mean_rank: f64,
    /// Highest rank.
    pub rank_max: u32,
    /// Share of the rays along which light can come, weighted by albedo, whose end the columns do not know.
    pub uncovered_fraction: f64,
    /// Part of it that is left out; the rest is spread over columns that the receiver sees.
    pub left_out_fraction: f64,
    /// Receivers that no light can reach, left out of the clusters: inside solids, or where no probe could stand.
    pub receivers_without_light: u64,
}

impl ClusterTotals {
    /// Counts and ranks of `rows`; the fractions are the caller's.
    pub fn of(rows: &[ClusterRow]) -> Self {
        let receivers: u64 = rows.iter().map(|row| u64::from(row.receivers)).sum();
        let rank_sum: f64 = rows.iter().map(|row| f64::from(row.receivers) * f64::from(row.rank)).sum();
        Self {
            receivers,
            clusters: rows.len() as u64,
            mean_rank: rank_sum / receivers.max(1) as f64,
            rank_max: rows.iter().map(|row| row.rank).max().unwrap_or(0),
            ..Self::default()
        }
    }
}

impl ClusterTotals {
    /// Figures of a summary; `carriers` says how many of which carry light, e.g. `900 patches`.
    pub fn summary(&self, manifest: &Manifest, carriers: &str) -> Figures {
        let rows = &manifest.clusters;
        let above = count_above(&manifest.settings, rows);
        let highest = rows.iter().map(|row| f64::from(row.truncation_error)).fold(0.0, f64::max);
        let bytes_per_receiver = manifest.bytes_light() as f64 / self.receivers.max(1) as f64;
        let json = [
            ("receivers", json!(self.receivers)),
            ("clusters", json!(self.clusters)),
            ("mean_rank", json!(self.mean_rank)),
            ("rank_max", json!(self.rank_max)),
            ("clusters_above_rank_error", json!(above)),
            ("truncation_error_max", json!(highest)),
            ("receivers_without_light", json!(self.receivers_without_light)),
            ("uncovered_fraction", json!(self.uncovered_fraction)),
            ("bytes_per_receiver", json!(bytes_per_receiver)),
        ];
        let mut words = format!(
            "{} receivers, {carriers}, {} clusters (mean rank {:.1}, highest {})\n{bytes_per_receiver:.0} bytes a \
             receiver for light\n",
            self.receivers, self.clusters, self.mean_rank, self.rank_max,
        );
        if above > 0 {
            words += &format!("{above} clusters above rank_error, highest error {highest:.3}\n");
        }
        if self.receivers_without_light > 0 {
            words += &format!("{} receivers without light\n", self.receivers_without_light);
        }
        Figures { json: json.map(|(name, value)| (name.to_owned(), value)).into_iter().collect(), words }
    }
}

impl ClusterRow {
    /// Middle of its bounds, in metres.
    pub fn middle_m(&self) -> [f32; 3] {
        let [low, high] = self.bounds_m;
        std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]))
    }
}

/// Errs unless there is a lightmap, and as many clusters as the sums over them say.
pub fn check_clusters(manifest: &Manifest, totals: &ClusterTotals) -> Result<(), ManifestError> {
    manifest.layout()?;
    let (rows, wanted) = (manifest.clusters.len(), totals.clusters);
    if rows as u64 != wanted {
        let problem = format!("its directory has {rows} clusters, wanted {wanted}");
        return Err(ManifestError::Contradiction { problem });
    }
    Ok(())
}

/// The rows with their chunks.
pub fn with_chunks(manifest: &Manifest) -> impl Iterator<Item = (&ClusterRow, &ChunkRef)> {
    manifest.clusters.iter().zip(manifest.chunks(CLUSTERS))
}
