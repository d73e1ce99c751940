//! The relightable bake's contract: settings, first tasks, what its chunks hold, and reconstruction on the CPU.

mod content;
pub mod reconstruct;
mod settings;
mod tasks;

pub use content::*;
pub use settings::{BasisKind, Preset, RawSettings, SettingRow, Settings, SettingsError};
pub use tasks::{TaskKind, initial_plan};
