//! The relightable bake with a field in tetrahedra: probes stand in free space, evenly dense whatever its shape, and light between them is
//! that of the corners of the tetrahedron around a point (\[Cupisz2012\]).

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

pub use settings::{CloudSettings, Placement, Settings};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "cloud";
/// Role of the chunk of tetrahedra.
pub const TETRAHEDRA: &str = "tetrahedra";

/// Roles of all chunks of the field.
const ROLES: [&str; 2] = [field::FIELD, TETRAHEDRA];

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cloud;

impl Kind for Cloud {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "as prt, with light at probes that stand evenly in free space of any shape, and tetrahedra between them"
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
        &[field::MESH_ROW]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        let sets = manifest.chunks(TETRAHEDRA).len();
        if sets != 1 {
            let problem = format!("it has {sets} sets of tetrahedra, wanted 1");
            return Err(ManifestError::Contradiction { problem });
        }
        field::check(manifest)
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        field::summary(manifest, &ROLES)
    }

    fn warnings(&self, manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        field::warnings(manifest)
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        field::inspection(manifest, &ROLES)
    }
}
