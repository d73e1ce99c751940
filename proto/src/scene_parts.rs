//! Scene bundles on their way to the farm, whole or in parts.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::ids::Digest;

/// Answer to a stored scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SceneStored {
    /// Digest of the stored bundle.
    pub scene: Digest,
    /// Its length.
    pub bytes: u64,
}

/// Size of the parts in which clients upload scenes that are bigger. Smaller → an interruption costs less, in more calls.
pub const SCENE_PART_BYTES: usize = 8 << 20;
/// Most bytes of one part of a scene: 64 MiB.
pub const MAX_SCENE_PART_BYTES: u64 = 64 << 20;
/// Most parts of a scene.
pub const MAX_SCENE_PARTS: usize = 1024;

/// The parts of a scene bundle, in order; its bytes are theirs, one after the other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneParts {
    /// 1 to 1024 of them; the same part may come several times.
    #[schema(min_items = 1, max_items = 1024)]
    pub parts: Vec<ScenePart>,
}

/// A part of a scene bundle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ScenePart {
    /// Digest of its bytes.
    pub digest: Digest,
    /// Its length, 1..=67108864.
    #[schema(minimum = 1, maximum = 67108864)]
    pub bytes: u64,
}

/// How far the upload of a scene is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SceneProgress {
    /// The scene is stored as a whole; nothing is left to do.
    pub is_stored: bool,
    /// Parts to upload, by digest, before the same call puts the scene together.
    pub missing: Vec<Digest>,
}
