//! Vantage points: places in free space and the view from each, of rays and triangles alone, so that they are the same for
//! every bake of a scene. From them a camera and a light are chosen where the file has none (task `scene.frame`), and the
//! lights that bakes are measured under, and places for objects.

mod camera;
mod light;
mod look;
mod openness;
mod standing;

use std::cell::OnceCell;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::manifest::Framing;

use crate::geometry::Geometry;
use crate::task::{Context, TaskError, TaskOutput};

pub use look::{Look, VantagePoint, in_rooms, vantage_points};
pub use openness::Openness;
pub use standing::{StandingPlace, standing_places};

/// Name under which tasks see the framing.
pub const FRAMING: &str = "frame/framing";

/// Runs task `scene.frame`: input `import/scene`; output `framing` (JSON of [`Framing`]).
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let framing = framing(&*Geometry::of(context)?);
    let json = serde_json::to_vec(&framing)
        .map_err(|error| TaskError::bad_input_from("the scene's framing cannot be written", error))?;
    Ok(TaskOutput { artefacts: vec![("framing".into(), json)], ..TaskOutput::default() })
}

/// A camera and a light, each where the file has none; light that next to nothing in sight of the camera has is none.
pub fn framing(geometry: &Geometry) -> Framing {
    let scene = &geometry.scene;
    let glows = scene.materials.iter().any(|material| material.emissive != [0.0; 3]);
    let points = OnceCell::new();
    let points = || points.get_or_init(|| vantage_points(geometry));
    let camera = scene.cameras.is_empty().then(|| camera::chosen(geometry, points()));
    let seen_by = camera.as_ref().map_or_else(|| scene.cameras.first(), |chosen| Some(&chosen.value));
    let wanted = match (scene.lights.is_empty(), glows) {
        (false, _) => None,
        (true, false) => Some("the file has no light"),
        (true, true) => seen_by
            .is_some_and(|camera| camera::sees_no_light(geometry, camera))
            .then_some("what glows in the file lights next to nothing that the camera sees"),
    };
    let light = wanted.map(|reason| light::chosen(geometry, points(), reason));
    Framing { camera, light }
}

#[cfg(test)]
mod tests;
