//! The relightable bake (METHOD.md §2): light from surface patches and parts of the sky to lightmap receivers, factorised
//! by cluster, relit at run time.

mod settings;
pub mod tasks;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::voxels::with_voxels;
use super::{Figures, Kind, Rates, UnderWay, Warning, cluster_figures, cluster_warnings};
use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{ClusterTotals, Manifest, ManifestError, OVERVIEW, check_clusters};
use crate::settings::{SettingRow, SettingsError};
use crate::voxels::{VOXELS, VoxelTotals};

pub use settings::{PatchSettings, Settings};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "prt";
/// Role of the chunk of surface patches.
pub const PATCHES: &str = "patches";

/// Clusters that the overview of a small bake may have; of a larger one as many as the bake itself.
const OVERVIEW_MAX: usize = 1024;

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Prt;

/// Body of manifests of this kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Sums over clusters.
    pub totals: ClusterTotals,
    /// Surface patches.
    pub patches: u64,
    /// Voxels, if there are some.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voxels: Option<VoxelTotals>,
}

impl Kind for Prt {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "relightable lightmap: lights can move, every bounce follows"
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

    fn under_way(&self) -> Option<UnderWay> {
        Some(UnderWay { outline: tasks::PLAN.name, clusters: tasks::COLOUR.name })
    }

    fn beside_objects(&self, settings: &Value) -> Option<Value> {
        with_voxels(settings)
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        check_relightable(manifest, &manifest.body::<Body>()?.totals)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { totals, patches, voxels } = manifest.body()?;
        let mut figures = summary(manifest, &totals, patches);
        add_voxels(&mut figures, manifest, voxels);
        Ok(figures)
    }

    fn warnings(&self, manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        warnings(manifest, &manifest.body::<Body>()?.totals)
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { totals, patches, voxels } = manifest.body()?;
        let mut figures = inspection(manifest, &totals, patches);
        add_voxels(&mut figures, manifest, voxels);
        Ok(figures)
    }
}

/// Adds the figures of voxels.
pub(super) fn add_voxels(figures: &mut Figures, manifest: &Manifest, voxels: Option<VoxelTotals>) {
    let Some(voxels) = voxels else { return };
    let bytes = manifest.chunks(VOXELS).iter().map(|chunk| chunk.bytes).sum();
    figures.words += &format!("voxels      {}", voxels.words(bytes));
    figures.json.insert("voxels".into(), json!(voxels));
}

/// Checks the relightable part of a manifest, whatever else its kind has.
pub(super) fn check_relightable(manifest: &Manifest, totals: &ClusterTotals) -> Result<(), ManifestError> {
    check_clusters(manifest, totals)?;
    let (overview, most) = (manifest.chunks(OVERVIEW).len(), manifest.clusters.len().max(OVERVIEW_MAX));
    if overview > most {
        let problem = format!("its overview has {overview} clusters, wanted {most} at most");
        return Err(ManifestError::Contradiction { problem });
    }
    match manifest.chunks(PATCHES).len() {
        1 => Ok(()),
        count => {
            let problem = format!("it has {count} sets of surface patches, wanted 1");
            Err(ManifestError::Contradiction { problem })
        }
    }
}

/// Figures of the relightable part for a summary.
pub(super) fn summary(manifest: &Manifest, totals: &ClusterTotals, patches: u64) -> Figures {
    let mut figures = totals.summary(manifest, &format!("{patches} patches"));
    figures.json.insert("patches".into(), json!(patches));
    figures
}

/// Warnings of the relightable part.
pub(super) fn warnings(manifest: &Manifest, totals: &ClusterTotals) -> Result<Vec<Warning>, ManifestError> {
    let finer = manifest.layout()?.texel_m / 2.0;
    Ok(cluster_warnings(&manifest.settings, totals, &manifest.clusters, Some(format!("texel_m={finer}"))))
}

/// All figures of the relightable part.
pub(super) fn inspection(manifest: &Manifest, totals: &ClusterTotals, patches: u64) -> Figures {
    let mut figures = cluster_figures(manifest, totals);
    figures.json.insert("patches".into(), json!(patches));
    figures.words.insert_str(0, &format!("patches     {patches}\n"));
    figures
}
