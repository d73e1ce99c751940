//! Edits of a scene before they are baked.

use serde_json::Value;

use super::LoadedBake;

/// A bake that is soon done, of an edited scene, beside which the bake of the scene as it was is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct QuickBake {
    /// Its kind.
    pub kind: &'static str,
    /// Its settings.
    pub settings: Value,
}

/// The light of an edited scene, of both bakes.
#[derive(Debug)]
pub struct Edited {
    /// It.
    pub bake: LoadedBake,
    /// Share of each receiver's light, by slot, that walks tell and a bake will tell better, 0 to 1.
    pub provisional: Vec<f32>,
}
