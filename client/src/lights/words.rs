//! Lights and cameras of the command line.

use lightkiln_proto::scene::{SceneCamera, SceneLight};
use lightkiln_proto::words::{LightSpec, camera_from_text};

use crate::error::{ClientError, Result};

/// Reads `eye=x,y,z target=x,y,z fov=deg`, lengths in metres, vertical field of view in degrees.
pub fn parse_camera(text: &str) -> Result<SceneCamera> {
    camera_from_text(text).map_err(|error| wrong(text, error.to_string()))
}

/// Reads a light: `point`, `spot`, `sun` or `sky` and its words.
pub fn parse_light(text: &str) -> Result<SceneLight> {
    match LightSpec::from_text("command line", text) {
        Ok(LightSpec::Scene(light)) => Ok(light),
        Ok(LightSpec::Panel(_) | LightSpec::Emitters(_)) => {
            Err(wrong(text, "a preview has no such light; write point, spot, sun or sky".to_owned()))
        }
        Err(error) => Err(wrong(text, error.to_string())),
    }
}

fn wrong(text: &str, problem: String) -> ClientError {
    ClientError::Argument { what: format!("\"{text:.200}\""), problem }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_repeat_the_argument_and_say_what_would_be_right() {
        let of_light = |text| parse_light(text).unwrap_err().to_string();
        for (text, wanted) in [
            ("point pos=0,0,0", "'power' is missing"),
            ("lamp pos=0,0,0", "'lamp'"),
            ("emitters scale=1", "point, spot, sun or sky"),
        ] {
            let error = of_light(text);
            assert!(error.contains(text) && error.contains(wanted), "{error}");
        }
        let error = parse_camera("eye=0,0,0 target=0,0,0").unwrap_err().to_string();
        assert!(error.contains("same point") && error.contains("fov=degrees"), "{error}");
    }
}
