//! A field without surfaces: light captured at probes under the lights of the scene's file, as \[Sukys2014\] and \[Luo2022\] have it. Its lights
//! cannot change afterwards, and what lightmaps light elsewhere is lit by it.
//!
//! Chunks are those of every field, without transport: the light is stored as that of one emitter.

mod settings;
pub mod tasks;

use glam::Vec4;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::field::{FieldPart, FieldTable, TetrahedronSet};
use super::{Figures, Kind, field};
use crate::chunk::ChunkRow;
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{Manifest, ManifestError, all_finite};
use crate::relight::{Inconsistent, Parallel, PatchTable};
use crate::settings::{SettingRow, SettingsError};

pub use settings::{CaptureSettings, Settings, Structure};
pub use tasks::first_tasks;

/// Name of the kind.
pub const NAME: &str = "captured";
/// Role of the chunk of tetrahedra, where probes stand on no lattice.
pub const TETRAHEDRA: &str = "tetrahedra";

/// Emitters that parts of a field name: the light is stored as that of one.
pub const EMITTERS: usize = 1;
/// Strength of that one.
pub const EMITTER_SCALE: [f32; EMITTERS] = [1.0];

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

/// The field of a manifest's decoded parts; tetrahedra where probes stand on no lattice.
pub fn joined(
    body: &Body,
    parts: &[FieldPart],
    tetrahedra: Option<&TetrahedronSet>,
) -> Result<FieldTable, Inconsistent> {
    let field = FieldTable::join(parts, tetrahedra, EMITTERS, &PatchTable::default())?;
    body.field.check(&field)?;
    Ok(field)
}

/// Coefficients at its probes, W·m⁻².
pub fn light(field: &FieldTable, parallel: &impl Parallel) -> Vec<Vec4> {
    field.relit(parallel, &[], &EMITTER_SCALE)
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
        let settings: Settings = manifest.settings()?;
        // Before there are probes, there is nothing between them.
        let wanted = match settings.capture.structure() {
            Structure::Tetrahedra(_) if body.field.probes > 0 => 1..=1,
            Structure::Tetrahedra(_) => 0..=1,
            Structure::Lattice(_) => 0..=0,
        };
        let sets = manifest.chunks(TETRAHEDRA).len();
        if !wanted.contains(&sets) {
            let structure = settings.capture.field_structure;
            return contradiction(format!(
                "it has {sets} sets of tetrahedra, wanted {} for field_structure = {structure}",
                wanted.end()
            ));
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
    use crate::content::EmitterIrradiance;
    use crate::kinds::field::{MAP_POINTS, PROBE_ROWS, Probe, ProbeKey};
    use crate::relight::Serial;

    #[test]
    fn light_of_probes_is_what_was_stored() {
        let key = ProbeKey::of(glam::IVec3::ONE).unwrap();
        let row = |j: usize| if j == 0 { [4.0, 2.0, 1.0] } else { [0.1 * j as f32, 0.0, 0.0] };
        let part = FieldPart {
            spacing_m: 0.5,
            probes: vec![Probe { key, moved: [0; 3] }],
            depths: vec![0; MAP_POINTS],
            emitters: vec![EmitterIrradiance { emitter: 0, irradiance: (0..PROBE_ROWS).map(row).collect() }],
            ..FieldPart::default()
        };
        let body = Body { field: field::FieldTotals { probes: 1, ..Default::default() } };
        let field = joined(&body, std::slice::from_ref(&part), None).unwrap();
        let found = light(&field, &Serial);
        assert_eq!(found[0].truncate().to_array(), row(0));
        assert_eq!(found[3].truncate().to_array(), row(3));
        // A second emitter is of another kind of bake.
        let second = EmitterIrradiance { emitter: 1, ..part.emitters[0].clone() };
        let other = FieldPart { emitters: vec![second], ..part };
        assert!(joined(&body, &[other], None).is_err());
    }
}
