//! The contract of the kind: settings, first tasks, its chunk, its figures.

use lightkiln_proto::chunk::bytes::{Reader, put_f32s};
use lightkiln_proto::chunk::container::{Container, ContainerWriter, SectionId};
use lightkiln_proto::chunk::{ChunkError, ChunkKind, ChunkRow};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::{Figures, Kind, SceneTasks, TaskKind};
use lightkiln_proto::manifest::{Manifest, ManifestError};
use lightkiln_proto::settings::{SettingRow, SettingsError};
use lightkiln_proto::{kind_settings, settings_group};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Name of the kind.
pub const NAME: &str = "ambient";
/// Its one task.
pub const TASK: TaskKind = TaskKind { name: "ambient.light", version: 1 };
/// Role of its one chunk.
pub const ROLE: &str = "ambient";
/// Kind of its chunk.
pub const CHUNK: ChunkKind = ChunkKind(200);

/// Tag of the chunk's one section: three floats.
const IRRADIANCE: u8 = 1;
settings_group! {
    /// The light.
    LightSettings {
        /// Irradiance on every surface in W·m⁻². More → brighter.
        irradiance: f32 = [1.0, 1.0, 1.0], |v| (0.0..=1e6).contains(&v), "0..=1000000 W/m²";
    }
}

kind_settings! {
    /// Settings of a bake of ambient light.
    Settings of NAME => {
        /// The light.
        light: LightSettings,
    }
}

/// Body of manifests of this kind.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Irradiance on every surface in W·m⁻².
    pub irradiance: f32,
}

/// The kind's row.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ambient;

impl Kind for Ambient {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "the same light everywhere"
    }

    fn settings(&self) -> Vec<SettingRow> {
        Settings::rows()
    }

    fn resolve(&self, settings: &Value) -> Result<Value, SettingsError> {
        Ok(Settings::from_json(settings)?.stated())
    }

    fn first_tasks(&self, scene: Digest, settings: &Value) -> Result<Vec<TaskSpec>, SettingsError> {
        let settings = Settings::from_json(settings)?;
        Ok(TASK.planned("scene", scene, &settings, SceneTasks::of(scene), &[]))
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[ChunkRow {
            kind: CHUNK,
            name: NAME,
            sections: &[(IRRADIANCE, "irradiance")],
            describe: |bytes| Ok(json!({ "irradiance": decode(bytes)? })),
            layers: None,
        }]
    }

    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError> {
        manifest.body::<Body>()?;
        match manifest.chunks(ROLE).len() {
            1 => Ok(()),
            count => {
                let problem = format!("it has {count} chunks of ambient light, wanted 1");
                Err(ManifestError::Contradiction { problem })
            }
        }
    }

    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        let Body { irradiance } = manifest.body()?;
        let json = [("irradiance".to_owned(), json!(irradiance))].into_iter().collect();
        Ok(Figures { json, words: format!("{irradiance} W/m² everywhere\n") })
    }

    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError> {
        self.summary(manifest)
    }
}

/// The chunk of an irradiance in W·m⁻².
pub fn encode(irradiance: [f32; 3]) -> Result<Vec<u8>, ChunkError> {
    let mut raw = Vec::new();
    put_f32s(&mut raw, &irradiance);
    let mut writer = ContainerWriter::new(CHUNK);
    writer.push(SectionId::new(IRRADIANCE, [0; 3]), &raw)?;
    Ok(writer.finish(&[])?.0)
}

/// The irradiance of a chunk in W·m⁻².
pub fn decode(bytes: &[u8]) -> Result<[f32; 3], ChunkError> {
    let container = Container::whole(CHUNK, bytes)?;
    container.check_sections(&[SectionId::new(IRRADIANCE, [0; 3])])?;
    let raw = container.section(0, "irradiance", 12)?;
    let mut reader = Reader::new("irradiance", &raw);
    let irradiance = [reader.f32("red")?, reader.f32("green")?, reader.f32("blue")?];
    reader.end()?;
    Ok(irradiance)
}
