//! Cameras and lights of a bake: the file's own, else those chosen when it was baked.

use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::scene::{SceneCamera, SceneLight};

use crate::error::{ClientError, Result};

/// The first camera of the file, else the chosen one with a note that says how it was chosen.
pub fn camera_of(manifest: &Manifest) -> Result<(SceneCamera, Option<String>)> {
    if let Some(camera) = manifest.cameras.first() {
        return Ok((camera.clone(), None));
    }
    let chosen = manifest.framing.camera.as_ref().ok_or_else(|| ClientError::Argument {
        what: "the bake".to_owned(),
        problem: "has no camera; give one, e.g. --camera \"eye=0,1.6,4 target=0,1,0\"".to_owned(),
    })?;
    Ok((chosen.value.clone(), Some(chosen.note.clone())))
}

/// The lights of the file, else the chosen one with a note that says how it was chosen. There is none where emissive surfaces
/// light the scene; where they light next to nothing of it there is one beside them.
pub fn lights_of(manifest: &Manifest) -> (Vec<SceneLight>, Option<String>) {
    match &manifest.framing.light {
        Some(chosen) if manifest.lights.is_empty() => (vec![chosen.value.clone()], Some(chosen.note.clone())),
        _ => (manifest.lights.clone(), None),
    }
}
