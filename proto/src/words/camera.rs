//! Cameras.

use glam::Vec3;

use super::{Words, WordsError};
use crate::scene::SceneCamera;

const CAMERA: &str = "eye=x,y,z target=x,y,z fov=degrees [up=x,y,z]";
/// Vertical field of view unless given, in degrees.
const FOV_DEG: f32 = 50.0;

/// Reads `eye=x,y,z target=x,y,z fov=deg`, lengths in metres, vertical field of view in degrees.
pub fn camera_from_text(text: &str) -> Result<SceneCamera, WordsError> {
    let mut words = Words::from_text(text.split_whitespace(), CAMERA)?;
    let eye = words.vector(&["eye"])?;
    let eye = words.required("eye", eye)?;
    let target = words.vector(&["target"])?;
    let target = words.required("target", target)?;
    let fov_deg = words.number(&["fov"], 1.0, 170.0)?.unwrap_or(FOV_DEG);
    let Some(forward) = (target - eye).try_normalize() else {
        return Err(words.wrong("eye and target are the same point"));
    };
    let up = words.direction(&["up"])?.unwrap_or_else(|| upright(forward));
    if forward.cross(up).length() < 1e-4 {
        return Err(words.wrong("up points along the view"));
    }
    words.end()?;
    Ok(SceneCamera {
        name: "command line".to_owned(),
        eye_m: eye.into(),
        target_m: target.into(),
        up: up.into(),
        fov_y_rad: fov_deg.to_radians(),
        orthographic_half_height_m: None,
    })
}

/// Words that [`camera_from_text`] reads as that camera's view, with up as that chooses it.
pub fn camera_to_text(camera: &SceneCamera) -> String {
    let place = |[x, y, z]: [f32; 3]| format!("{x},{y},{z}");
    let (eye, target) = (place(camera.eye_m), place(camera.target_m));
    let fov_deg = (100.0 * camera.fov_y_rad.to_degrees()).round() / 100.0;
    format!("eye={eye} target={target} fov={fov_deg}")
}

/// Straight up, or the view's top when it looks straight up or down.
fn upright(forward: Vec3) -> Vec3 {
    if forward.y.abs() > 0.999 { Vec3::NEG_Z } else { Vec3::Y }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_is_read_in_degrees_and_must_look_somewhere() {
        let camera = camera_from_text("eye=0,1,5 target=0,1,0 fov=40").unwrap();
        assert!((camera.fov_y_rad - 40_f32.to_radians()).abs() < 1e-6);
        let same = camera_from_text(&camera_to_text(&camera)).unwrap();
        assert!((same.eye_m, same.target_m) == (camera.eye_m, camera.target_m), "{same:?}");
        assert!((same.fov_y_rad - camera.fov_y_rad).abs() < 1e-4, "{same:?}");
        let error = camera_from_text("eye=0,0,0 target=0,0,0").unwrap_err().to_string();
        assert!(error.contains("same point"), "{error}");
    }
}
