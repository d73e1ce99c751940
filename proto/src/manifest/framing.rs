//! A camera and a light for scenes whose file has none, chosen when they are baked.

use serde::{Deserialize, Serialize};

use crate::scene::{SceneCamera, SceneLight};

/// Choices for files without a camera or a light; none where the file has its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Framing {
    /// Camera, where the file has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Chosen<SceneCamera>>,
    /// Light, where the file has no lights and no emissive surfaces that light what its camera sees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Chosen<SceneLight>>,
}

/// A choice, and how it was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chosen<T> {
    /// The choice.
    pub value: T,
    /// How it was made, for people, e.g. `the file has no camera; chose one inside the scene, …`.
    pub note: String,
}
