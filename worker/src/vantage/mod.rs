//! Vantage points: places in free space and the view from each, of rays and triangles alone, so that they are the same for
//! every bake of a scene. From them a camera and a light are chosen where the file has none (task `scene.frame`), and the
//! lights that bakes are measured under.

mod camera;
mod light;
mod look;
mod openness;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::manifest::Framing;

use crate::geometry::Geometry;
use crate::task::{Context, TaskError, TaskOutput};

pub use look::{Look, VantagePoint, vantage_points};
pub use openness::Openness;

/// Name under which tasks see the framing.
pub const FRAMING: &str = "frame/framing";

/// Runs task `scene.frame`: input `import/scene`; output `framing` (JSON of [`Framing`]).
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let framing = framing(&*Geometry::of(context)?);
    let json = serde_json::to_vec(&framing)
        .map_err(|error| TaskError::bad_input_from("the scene's framing cannot be written", error))?;
    Ok(TaskOutput { artefacts: vec![("framing".into(), json)], ..TaskOutput::default() })
}

/// A camera and a light, each where the file has none.
pub fn framing(geometry: &Geometry) -> Framing {
    let scene = &geometry.scene;
    let is_lit = !scene.lights.is_empty() || scene.materials.iter().any(|m| m.emissive != [0.0; 3]);
    if is_lit && !scene.cameras.is_empty() {
        return Framing::default();
    }
    let points = vantage_points(geometry);
    Framing {
        camera: scene.cameras.is_empty().then(|| camera::chosen(geometry, &points)),
        light: (!is_lit).then(|| light::chosen(geometry, &points)),
    }
}

#[cfg(test)]
mod tests;
