//! The bake of voxels alone: receivers and patches without transport, lit by walks at run time; and the settings and tasks of voxels, which
//! bakes of other kinds have beside theirs.

mod settings;
pub mod tasks;

use serde_json::Value;

use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::kinds::{Figures, Kind, Rates, Warning, prt};
use crate::manifest::{Manifest, ManifestError};
use crate::settings::{SettingRow, SettingsError};
use crate::voxels::{ROW, VOXELS};

pub use settings::{
    Presence, Settings, VoxelPresence, VoxelSettings, WalkedSettings, walked_part, with_voxels,
};

/// Name of the kind.
pub const NAME: &str = "voxels";

/// Bakes that the rates are from.
const MEASURED: &str = "a Cornell box, draft and medium, on two threads of a server of 2026";

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Voxels;

impl Kind for Voxels {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "voxels alone: soon there, lights can move; light is that of walks, noisy and costly to draw at first"
    }

    fn settings(&self) -> Vec<SettingRow> {
        Settings::rows()
    }

    fn resolve(&self, settings: &Value) -> Result<Value, SettingsError> {
        Ok(Settings::from_json(settings)?.stated())
    }

    fn first_tasks(&self, scene: Digest, settings: &Value) -> Result<Vec<TaskSpec>, SettingsError> {
        Ok(tasks::first_tasks(scene, &Settings::from_json(settings)?))
    }

    fn rates(&self, settings: &Value) -> Result<Option<Rates>, SettingsError> {
        let settings = Settings::from_json(settings)?;
        Ok(Some(Rates {
            cpu_us: 100.0 + 0.7 * f64::from(settings.walked.emitter_rays),
            bundle_bytes: 12.0,
            memory_bytes: 1200.0,
            cluster_receivers: f64::from(settings.walked.cluster_receivers),
            measured: MEASURED,
        }))
    }

    fn beside_objects(&self, settings: &Value) -> Option<Value> {
        Some(settings.clone())
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[ROW]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        let prt::Body { totals, voxels, .. } = manifest.body()?;
        if voxels.is_none() || manifest.chunks(VOXELS).is_empty() {
            let problem = "it has no voxels, which all of its light comes from".to_owned();
            return Err(ManifestError::Contradiction { problem });
        }
        prt::check_relightable(manifest, &totals)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        prt::Prt.summary(manifest)
    }

    fn warnings(&self, _: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        // Walks find all light that columns do not carry.
        Ok(Vec::new())
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        prt::Prt.inspection(manifest)
    }
}
