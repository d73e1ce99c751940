//! Settings of bakes: numbers and words with presets, in groups that kinds of bake put together.
//!
//! Each field says its unit, its range and what more or less of it does. A group checks the fields that it knows; a kind
//! of bake is a list of groups and refuses every other key.

mod groups;
mod table;
mod value;

use thiserror::Error;

#[doc(hidden)]
pub use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as DeserializeError};
/// JSON, for the macros.
#[doc(hidden)]
pub use serde_json::Value as Json;
/// An object of settings.
pub type Map = serde_json::Map<String, Json>;

pub use groups::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
pub use table::{check_keys, preset_of, preset_row};
pub use value::SettingValue;

/// A setting that is unknown or out of range.
#[derive(Debug, Error, PartialEq)]
pub enum SettingsError {
    /// Not an object of settings.
    #[error("the settings are {found}, wanted an object such as {{\"preset\": \"draft\"}}")]
    NoObject {
        /// JSON type found.
        found: &'static str,
    },
    /// A key that the kind of bake does not have.
    #[error("there is no setting '{name:.40}' in a bake of kind '{kind}'{hint}; it has {known}")]
    Unknown {
        /// Key given.
        name: String,
        /// Kind of bake.
        kind: &'static str,
        /// The name that was meant, in words; empty if none is like it.
        hint: String,
        /// Names that it has.
        known: String,
    },
    /// A value of another type.
    #[error("{name} = {value:.60} is not {wanted}")]
    Type {
        /// Setting.
        name: &'static str,
        /// Value given, as JSON.
        value: String,
        /// Wanted type.
        wanted: &'static str,
    },
    /// A value outside its range.
    #[error("{name} = {value:.60} is out of range: {range}")]
    OutOfRange {
        /// Setting.
        name: &'static str,
        /// Value given.
        value: String,
        /// Allowed range, with unit.
        range: &'static str,
    },
    /// Settings that a bake states without its preset.
    #[error("stated settings name no preset")]
    NoPreset,
    /// A stated setting that this version does not know.
    #[error(
        "stated settings have '{name:.40}', which this version does not know; is it older than the server?"
    )]
    NotRead {
        /// Key found.
        name: String,
    },
    /// A group that is not stated in full.
    #[error("stated settings lack '{name}'; is this version newer than the server?")]
    NotStated {
        /// Key wanted.
        name: &'static str,
    },
}

/// How much work to spend; sets every default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// A look within seconds: coarse texels, noisy.
    Draft,
    /// Everyday bakes.
    #[default]
    Medium,
    /// Final bakes, held to the published error figures.
    High,
}

impl Preset {
    /// All presets with their names, in the order of [`SettingRow::presets`].
    pub const ALL: [(Self, &'static str); 3] =
        [(Self::Draft, "draft"), (Self::Medium, "medium"), (Self::High, "high")];

    /// Index into [`SettingRow::presets`].
    pub fn index(self) -> usize {
        self as usize
    }
}

/// A setting as documentation shows it: a number or a word.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingRow {
    /// Key in settings files and `--set`.
    pub name: &'static str,
    /// Allowed values, with unit.
    pub range: &'static str,
    /// Values under draft, medium and high.
    pub presets: [Json; 3],
    /// Effect, with that of more and less.
    pub effect: &'static str,
}

/// Settings that belong together; [`crate::settings_group!`] makes them.
pub trait SettingsGroup: Sized {
    /// Rows in the order of the fields.
    fn rows() -> Vec<SettingRow>;

    /// Reads the fields from an object, the preset's values where it lacks them.
    fn read(given: &Map, preset: Preset) -> Result<Self, SettingsError>;

    /// Writes every field.
    fn write(&self, to: &mut Map);
}

/// Settings as a task or a manifest states them; of a kind's, all must name their preset.
///
/// Errors on a key without a row. A group by itself, as in a task's parameters, must state every row: nothing says which
/// preset would fill in the rest.
#[doc(hidden)]
pub fn stated<G: SettingsGroup>(object: &Map) -> Result<G, SettingsError> {
    let rows = G::rows();
    if let Some(name) = object.keys().find(|key| rows.iter().all(|row| row.name != key.as_str())) {
        return Err(SettingsError::NotRead { name: name.clone() });
    }
    let names_preset = rows.iter().any(|row| row.name == preset_row().name);
    if let Some(row) = rows.iter().find(|row| !names_preset && !object.contains_key(row.name)) {
        return Err(SettingsError::NotStated { name: row.name });
    }
    G::read(object, Preset::default())
}

#[doc(hidden)]
pub fn custom_error<'de, D: Deserializer<'de>>(error: SettingsError) -> D::Error {
    D::Error::custom(error)
}

#[cfg(test)]
mod tests;
