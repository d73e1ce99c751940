//! The relightable bake as \[Sedlacek2019\] has it: light carried by spherical harmonics at probes. Kept for comparison with
//! surface patches, and for the source's own studies.

mod chunk;
mod content;
mod relight;
mod settings;
pub mod tasks;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{Figures, Kind, Rates, Warning, cluster_figures, cluster_warnings};
use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{ClusterTotals, Manifest, ManifestError, all_finite, check_clusters};
use crate::settings::{SettingRow, SettingsError};

pub use chunk::{
    BATCH_PROBES_MAX, HITS_MAX, PROBES as PROBES_CHUNK, RAY_GROUPS, RELIGHT_RAYS_MAX, ROW,
    decode_probe_batch, decode_probe_batch_prefix, encode_probe_batch,
};
pub use content::{Probe, ProbeBatch, ProbeKey, RelightHit};
pub use relight::{HIT_DARK, HIT_SKY, ProbeTable, relight_basis, sky_coefficients};
pub use settings::{ProbeSettings, Settings};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "sh";
/// Role of the chunks of probes.
pub const PROBES: &str = "probes";

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sh;

/// Body of manifests of this kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Sums over clusters.
    pub totals: ClusterTotals,
    /// Probes.
    pub probes: u64,
    /// Distance between probes in metres.
    pub probe_spacing_m: f32,
}

impl Kind for Sh {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "relightable lightmap by spherical harmonics at probes, as its source has it; for comparison"
    }

    fn settings(&self) -> Vec<SettingRow> {
        Settings::rows()
    }

    fn resolve(&self, settings: &Value) -> Result<Value, SettingsError> {
        Ok(Settings::from_json(settings)?.stated())
    }

    fn first_tasks(&self, scene: Digest, settings: &Value) -> Result<Vec<TaskSpec>, SettingsError> {
        Ok(first_tasks(scene, &Settings::from_json(settings)?))
    }

    fn rates(&self, settings: &Value) -> Result<Option<Rates>, SettingsError> {
        Ok(Some(Settings::from_json(settings)?.rates()))
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[ROW]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        let body: Body = manifest.body()?;
        all_finite("the probes' spacing", &[body.probe_spacing_m])?;
        check_clusters(manifest, &body.totals)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { totals, probes, .. } = manifest.body()?;
        let mut figures = totals.summary(manifest, &format!("{probes} probes"));
        figures.json.insert("probes".into(), json!(probes));
        figures.words +=
            &format!("{:.2} % of the light reaches no probe\n", 100.0 * totals.uncovered_fraction);
        Ok(figures)
    }

    fn warnings(&self, manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        let Body { totals, probe_spacing_m, .. } = manifest.body()?;
        let finer = format!("probe_spacing_m={:.3}", probe_spacing_m / 2.0);
        Ok(cluster_warnings(&manifest.settings, &totals, &manifest.clusters, Some(finer)))
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { totals, probes, probe_spacing_m } = manifest.body()?;
        let mut figures = cluster_figures(manifest, &totals);
        figures.json.insert("probes".into(), json!(probes));
        figures.json.insert("probe_spacing_m".into(), json!(probe_spacing_m));
        figures.words.insert_str(0, &format!("probes      {probes}, spacing {probe_spacing_m} m\n"));
        Ok(figures)
    }
}
