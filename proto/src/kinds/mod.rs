//! Kinds of bake: a table that says of each kind its settings, its first tasks, its chunks and its figures. The server asks
//! the table and reads nothing of a kind; worker and client have tables of their own beside it.
//!
//! A kind is one folder here, one in `worker/src/kinds`, one in `client/src/kinds`, and one row in each table.

pub mod captured;
pub mod cloud;
pub mod field;
mod figures;
pub mod grid;
pub mod prt;
mod rates;
mod scene_tasks;
pub mod sh;
mod tasks;
pub mod transfer;
mod under_way;
pub mod voxels;
mod warnings;

use serde_json::Value;
use thiserror::Error;

use crate::chunk::{self, ChunkKind, ChunkRow};
use crate::ids::Digest;
use crate::jobs::TaskSpec;
use crate::manifest::{Manifest, ManifestError};
use crate::settings::{SettingRow, SettingsError};

pub use figures::{Figures, cluster_figures};
pub use rates::Rates;
pub use scene_tasks::{SceneTask, SceneTasks};
pub use tasks::TaskKind;
pub use under_way::{OUTLINE_OUTPUT, PAGE_OUTPUT, UnderWay};
pub(crate) use warnings::count_above;
pub use warnings::{Warning, cluster_warnings};

/// A kind of bake, as far as every role knows it. Pure.
pub trait Kind: Send + Sync {
    /// Name on the wire and in manifests: lower-case letters.
    fn name(&self) -> &'static str;

    /// One line for people.
    fn about(&self) -> &'static str;

    /// Every setting.
    fn settings(&self) -> Vec<SettingRow>;

    /// All settings, checked; given as a request has them, `null` for all defaults.
    fn resolve(&self, settings: &Value) -> Result<Value, SettingsError>;

    /// First tasks over a scene; settings as a request gives them, `null` for all defaults.
    fn first_tasks(&self, scene: Digest, settings: &Value) -> Result<Vec<TaskSpec>, SettingsError>;

    /// Cost of a receiver under these settings, if bakes of the kind have been measured.
    fn rates(&self, settings: &Value) -> Result<Option<Rates>, SettingsError> {
        let _ = settings;
        Ok(None)
    }

    /// Tasks whose results are light while a bake goes on; none of a kind whose bakes are seen only once they have ended.
    fn under_way(&self) -> Option<UnderWay> {
        None
    }

    /// Whether its bakes are those of objects that move through other bakes.
    fn is_of_objects(&self) -> bool {
        false
    }

    /// Settings under which bakes of the kind light objects that have bakes of their own, and are lit by them: those given, with what that
    /// takes where they leave it open. `None` where they rule it out, or the kind does.
    fn beside_objects(&self, settings: &Value) -> Option<Value> {
        let _ = settings;
        None
    }

    /// Rows of chunk kinds that are the kind's own.
    fn chunks(&self) -> &'static [ChunkRow];

    /// Checks a manifest of this kind, all but its settings: those who draw a bake need none, and whoever reads them
    /// ([`Manifest::settings`]) is told what is wrong with them.
    fn check(&self, manifest: &Manifest) -> Result<(), ManifestError>;

    /// Figures of a bake for its summary: a few, whose names are a contract.
    fn summary(&self, manifest: &Manifest) -> Result<Figures, ManifestError>;

    /// Warnings of a bake that came out worse than its settings ask for; none of a kind that cannot tell.
    fn warnings(&self, _manifest: &Manifest) -> Result<Vec<Warning>, ManifestError> {
        Ok(Vec::new())
    }

    /// Figures of a bake for whoever looks into it: all of them.
    fn inspection(&self, manifest: &Manifest) -> Result<Figures, ManifestError>;
}

/// Why a bake cannot be planned.
#[derive(Debug, Error)]
pub enum BakeError {
    /// No such kind.
    #[error("there is no bake kind '{kind:.40}'; known kinds: {known}")]
    UnknownKind {
        /// Name asked for.
        kind: String,
        /// Names of the table.
        known: String,
    },
    /// The settings are wrong.
    #[error("the settings cannot be used")]
    Settings(#[from] SettingsError),
}

/// A table of kinds; the first is the default.
#[derive(Clone)]
pub struct Kinds(Vec<&'static dyn Kind>);

impl Kinds {
    /// The kinds of this crate.
    pub fn new() -> Self {
        Self(vec![
            &prt::Prt,
            &sh::Sh,
            &grid::Grid,
            &cloud::Cloud,
            &captured::Captured,
            &voxels::Voxels,
            &transfer::Transfer,
        ])
    }

    /// The table with one more kind.
    ///
    /// # Panics
    /// If the table has a kind or a chunk kind of that name or number: two kinds must never be mistaken.
    #[must_use]
    pub fn with(mut self, kind: &'static dyn Kind) -> Self {
        assert!(self.get(kind.name()).is_none(), "two kinds are named '{}'", kind.name());
        self.0.push(kind);
        for row in kind.chunks() {
            let like = self.chunks().filter(|known| known.kind == row.kind).count();
            assert!(like == 1, "two chunk kinds have the number {}", row.kind.0);
        }
        self
    }

    /// All kinds, the default first.
    pub fn iter(&self) -> impl Iterator<Item = &'static dyn Kind> + '_ {
        self.0.iter().copied()
    }

    /// The default kind.
    pub fn default_kind(&self) -> &'static dyn Kind {
        self.0[0]
    }

    /// The kind of that name.
    pub fn get(&self, name: &str) -> Option<&'static dyn Kind> {
        self.iter().find(|kind| kind.name() == name)
    }

    /// The kind of that name, the default for an empty one.
    pub fn named(&self, name: &str) -> Result<&'static dyn Kind, BakeError> {
        if name.is_empty() {
            return Ok(self.default_kind());
        }
        self.get(name).ok_or_else(|| BakeError::UnknownKind { kind: name.to_owned(), known: self.names() })
    }

    /// The first tasks of a bake of `kind` over `scene`.
    pub fn first_tasks(
        &self,
        kind: &str,
        scene: Digest,
        settings: &Value,
    ) -> Result<Vec<TaskSpec>, BakeError> {
        Ok(self.named(kind)?.first_tasks(scene, settings)?)
    }

    /// Checks what [`Manifest::from_json`] leaves to the kind, and gives the kind.
    pub fn check(&self, manifest: &Manifest) -> Result<&'static dyn Kind, ManifestError> {
        let unknown = || ManifestError::Kind { kind: manifest.kind.clone(), known: self.names() };
        let kind = self.get(&manifest.kind).ok_or_else(unknown)?;
        kind.check(manifest)?;
        Ok(kind)
    }

    /// Rows of all chunk kinds.
    pub fn chunks(&self) -> impl Iterator<Item = &'static ChunkRow> + '_ {
        chunk::SHARED.iter().chain(self.iter().flat_map(Kind::chunks))
    }

    /// The row of a chunk kind.
    pub fn chunk(&self, kind: ChunkKind) -> Option<&'static ChunkRow> {
        self.chunks().find(|row| row.kind == kind)
    }

    /// The kind of objects that move through other bakes.
    pub fn of_objects(&self) -> Option<&'static dyn Kind> {
        self.iter().find(|kind| kind.is_of_objects())
    }

    /// Names, for messages.
    pub fn names(&self) -> String {
        self.iter().map(Kind::name).collect::<Vec<_>>().join(", ")
    }
}

impl Default for Kinds {
    fn default() -> Self {
        Self::new()
    }
}

impl std::fmt::Debug for Kinds {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter().map(Kind::name)).finish()
    }
}

#[cfg(test)]
mod tests;
