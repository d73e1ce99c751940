//! Kinds of bake: how settings become the first tasks. The server calls this and reads nothing of it.

use thiserror::Error;

use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::prt;

/// The relightable bake (METHOD.md §2).
pub const PRT: &str = "prt";

/// Why a bake cannot be planned.
#[derive(Debug, Error)]
pub enum BakeError {
    /// No such kind.
    #[error("there is no bake kind '{kind}'; known kinds: {PRT}")]
    UnknownKind {
        /// What was asked for.
        kind: String,
    },
    /// The settings are wrong.
    #[error("the settings cannot be used")]
    Settings(#[from] prt::SettingsError),
}

/// The first tasks of a bake of `kind` over `scene`. Pure.
pub fn initial_plan(
    kind: &str,
    scene: Digest,
    settings: &serde_json::Value,
) -> Result<Vec<TaskSpec>, BakeError> {
    match kind {
        PRT => Ok(prt::initial_plan(scene, &prt::Settings::from_json(settings)?)),
        _ => Err(BakeError::UnknownKind { kind: kind.chars().take(40).collect() }),
    }
}
