//! The relightable bake with a field on a lattice.

mod settings;
pub mod tasks;

use serde_json::Value;

use super::voxels::with_voxels;
use super::{Figures, Kind, Rates, Warning, field, prt};
use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{Manifest, ManifestError};
use crate::settings::{SettingRow, SettingsError};

pub use settings::{LatticeSettings, Settings};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "grid";

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Grid;

impl Kind for Grid {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "as prt, with light at probes in free space for objects that move"
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
        prt::Prt.rates(&Settings::from_json(settings)?.relightable().stated())
    }

    fn beside_objects(&self, settings: &Value) -> Option<Value> {
        with_voxels(settings)
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[field::ROW]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        field::check(manifest)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        field::summary(manifest, &[field::FIELD])
    }

    fn warnings(&self, manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        field::warnings(manifest)
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        field::inspection(manifest, &[field::FIELD])
    }
}
