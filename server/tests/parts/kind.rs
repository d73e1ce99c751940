//! A kind of bake for tests of the queue: two tasks, the second after the first.

use lightkiln_proto::chunk::ChunkRow;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_proto::kind_settings;
use lightkiln_proto::kinds::{Figures, Kind, Kinds};
use lightkiln_proto::manifest::{Manifest, ManifestError};
use lightkiln_proto::settings::{SettingRow, SettingsError, TransportSettings};
use serde_json::Value;

/// Name of the kind.
pub const NAME: &str = "two";
/// Its first task.
pub const FIRST: &str = "two.first";
/// Its second task, which plans more.
pub const SECOND: &str = "two.second";

kind_settings! {
    /// Settings, so that wrong ones can be refused.
    Settings of NAME => {
        /// Rays.
        transport: TransportSettings,
    }
}

/// The kind.
pub struct Two;

/// The kinds of a farm under test.
pub fn kinds() -> Kinds {
    Kinds::new().with(&Two)
}

impl Kind for Two {
    fn name(&self) -> &'static str {
        NAME
    }

    fn about(&self) -> &'static str {
        "two tasks"
    }

    fn settings(&self) -> Vec<SettingRow> {
        Settings::rows()
    }

    fn resolve(&self, settings: &Value) -> Result<Value, SettingsError> {
        Ok(Settings::from_json(settings)?.stated())
    }

    fn first_tasks(&self, scene: Digest, settings: &Value) -> Result<Vec<TaskSpec>, SettingsError> {
        let settings = Settings::from_json(settings)?;
        let bundle = TaskInput::Artefact { name: "bundle".into(), digest: scene };
        let first = TaskSpec::new(FIRST, 1, "scene", Value::Null, vec![bundle], 1);
        let before = TaskInput::Task { name: "first".into(), key: first.key };
        let params = serde_json::json!({ "settings": settings });
        let second = TaskSpec::new(SECOND, 1, "scene", params, vec![before], 10);
        Ok(vec![first, second])
    }

    fn chunks(&self) -> &'static [ChunkRow] {
        &[]
    }

    fn check(&self, _: &Manifest) -> Result<(), ManifestError> {
        Ok(())
    }

    fn summary(&self, _: &Manifest) -> Result<Figures, ManifestError> {
        Ok(Figures::default())
    }

    fn inspection(&self, _: &Manifest) -> Result<Figures, ManifestError> {
        Ok(Figures::default())
    }
}
