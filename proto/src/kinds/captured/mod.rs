//! A field without surfaces: light captured at probes under the lights of the scene's file, as \[Sukys2014\] and \[Luo2022\] have it. Its lights
//! cannot change afterwards, and what lightmaps light elsewhere is lit by it.
//!
//! Chunks are those of every field: coefficients are transport over three columns, one a colour, whose light is 1.

mod settings;
pub mod tasks;

use glam::Vec4;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Figures, Kind, field};
use crate::chunk::ChunkRow;
use crate::content::{PatchKey, PatchSet};
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{Manifest, ManifestError, all_finite};
use crate::relight::{Inconsistent, PatchTable, SlotTable};
use crate::settings::{SettingRow, SettingsError};

pub use settings::{CaptureSettings, Settings, Structure};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "captured";
/// Role of the chunk of tetrahedra, where probes stand on no lattice.
pub const TETRAHEDRA: &str = "tetrahedra";

/// Light of the three columns: one of each colour.
pub const LAMBDA: [Vec4; 3] = [Vec4::X, Vec4::Y, Vec4::Z];

/// Roles of all chunks of the field.
const ROLES: [&str; 2] = [field::FIELD, TETRAHEDRA];

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Captured;

/// Body of manifests of this kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// The field.
    pub field: field::FieldTotals,
}

/// Keys of the three columns.
pub fn keys() -> [u64; 3] {
    [0, 1, 2].map(|colour| PatchKey::of_sky(colour).0)
}

/// The three columns: parts of a sky that nothing else is beside.
pub fn columns() -> Result<PatchTable, Inconsistent> {
    let set = PatchSet { leaf_starts: vec![0], sky_parts: LAMBDA.len() as u32, ..PatchSet::default() };
    PatchTable::new(&set, &SlotTable::new([])?)
}

impl Kind for Captured {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "probes alone, with the light of the scene file's lights: no lightmap, and lights that stay as they are"
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

    fn chunks(&self) -> &'static [ChunkRow] {
        &[]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        let body: Body = manifest.body()?;
        all_finite("the probes' spacing", &[body.field.spacing_m])?;
        let contradiction = |problem: String| Err(ManifestError::Contradiction { problem });
        let sets = manifest.chunks(TETRAHEDRA).len();
        if sets > 1 {
            return contradiction(format!("it has {sets} sets of tetrahedra, wanted 1 at most"));
        }
        if manifest.lightmap.is_some() {
            return contradiction("it has a lightmap, which bakes of its kind have none of".into());
        }
        Ok(())
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        figures(manifest, "")
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        figures(manifest, "field       ")
    }
}

fn figures(manifest: &Manifest, before: &str) -> Result<Figures, ManifestError> {
    let Body { field } = manifest.body()?;
    let words = format!("{before}{}", field.words(field::bytes_of(manifest, &ROLES)));
    let json = Map::from_iter([("field".to_owned(), json!(field))]);
    Ok(Figures { json, words })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relight::Columns;

    #[test]
    fn columns_are_the_three_colours() {
        assert_eq!(columns().unwrap().lambda_count(), LAMBDA.len());
    }
}
