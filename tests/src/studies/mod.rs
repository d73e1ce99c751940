//! Measured studies: a setting is varied, each bake is held against the path tracer, and a table and a plot say what the
//! setting is worth. Results and the defaults that follow from them are kept in `tests/studies`.

mod causes;
pub mod detail;
pub mod first_light;
mod list;
mod measure;
pub mod papers;
mod plot;
mod report;
pub mod transfer;
pub mod voxels;
pub mod walks;

pub use list::STUDIES;
pub use measure::{Kiln, Measured};
pub use report::write;

/// `KEY=VALUE` as `kiln bake --set` takes it; `kind=NAME` names the kind of bake.
pub type Setting = &'static str;

/// Quantity on a plot's horizontal axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Probes placed.
    Probes,
    /// Receivers.
    Receivers,
    /// Bytes a receiver.
    Bytes,
    /// Rays cast, in millions.
    Megarays,
    /// The value of the setting that is varied.
    Value,
}

/// A setting varied, under some conditions.
#[derive(Clone, Copy, Debug)]
pub struct Study {
    /// Name on the command line and of the files.
    pub name: &'static str,
    /// The question.
    pub question: &'static str,
    /// The answer by the figures, and the default that is chosen.
    pub answer: &'static str,
    /// Scenes of `tests/scenes`.
    pub scenes: &'static [&'static str],
    /// Settings of every bake, after [`BASE`].
    pub fixed: &'static [Setting],
    /// Lines of the plot in each scene: label and settings.
    pub lines: &'static [(&'static str, &'static [Setting])],
    /// Setting that is varied along a line.
    pub varied: &'static str,
    /// Its values.
    pub values: &'static [&'static str],
    /// Quantity on the plot's horizontal axis.
    pub axis: Axis,
}

/// Settings of every study: small bakes, as there are many.
pub const BASE: &[Setting] = &["receivers_target=60000"];
/// Arguments of every evaluation.
pub const EVALUATION: &[&str] = &["--receivers", "600", "--rel-error", "0.1", "--json"];

impl Axis {
    /// In words.
    pub fn words(self, varied: &str) -> String {
        match self {
            Self::Probes => "probes".into(),
            Self::Receivers => "receivers".into(),
            Self::Bytes => "bytes a receiver".into(),
            Self::Megarays => "rays in millions".into(),
            Self::Value => varied.to_owned(),
        }
    }
}
