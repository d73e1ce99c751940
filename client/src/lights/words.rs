//! Lights and cameras of the command line.

use lightkiln_proto::scene::{SceneCamera, SceneLight};
use lightkiln_proto::words::{LightSpec, camera_from_text};

use crate::error::{ClientError, Result};

/// Reads `eye=x,y,z target=x,y,z fov=deg`, lengths in metres, vertical field of view in degrees.
pub fn parse_camera(text: &str) -> Result<SceneCamera> {
    camera_from_text(text).map_err(|error| wrong(text, error.to_string()))
}

/// Lights as words ask for them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParsedLights {
    /// Points, spots, suns, rectangles and skies.
    pub lights: Vec<SceneLight>,
    /// Strength of the scene's emissive surfaces relative to the bake, if a text says it.
    pub emitter_scale: Option<f32>,
}

/// Reads a light: `point`, `spot`, `sun`, `rect` or `sky` and its words.
pub fn parse_light(text: &str) -> Result<SceneLight> {
    match spec(text)? {
        LightSpec::Scene(light) => Ok(light),
        LightSpec::Emitters(_) => {
            Err(wrong(text, "it is no single light; write point, spot, sun, rect or sky".to_owned()))
        }
    }
}

/// Reads lights, each as [`parse_light`] or `emitters scale=s`; of several scales the last counts.
pub fn parse_lights(texts: &[impl AsRef<str>]) -> Result<ParsedLights> {
    let mut parsed = ParsedLights::default();
    for text in texts.iter().map(AsRef::as_ref) {
        match spec(text)? {
            LightSpec::Scene(light) => parsed.lights.push(light),
            LightSpec::Emitters(scale) => parsed.emitter_scale = Some(scale),
        }
    }
    Ok(parsed)
}

/// A word as a shell takes it.
pub fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-._,/:=+@%".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

fn spec(text: &str) -> Result<LightSpec> {
    LightSpec::from_text("command line", text).map_err(|error| wrong(text, error.to_string()))
}

fn wrong(text: &str, problem: String) -> ClientError {
    ClientError::Argument { what: format!("\"{text:.200}\""), problem }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn emitters_stand_beside_other_lights() {
        let parsed = parse_lights(&["emitters scale=0.5", "sun dir=0,-1,0 irradiance=2"]).unwrap();
        assert_eq!((parsed.lights.len(), parsed.emitter_scale), (1, Some(0.5)));
        assert_eq!(parse_lights(&[] as &[&str]).unwrap(), ParsedLights::default());
    }

    #[test]
    fn errors_repeat_the_argument_and_say_what_would_be_right() {
        let of_light = |text| parse_light(text).unwrap_err().to_string();
        for (text, wanted) in [
            ("point pos=0,0,0", "'power' is missing"),
            ("lamp pos=0,0,0", "'lamp'"),
            ("emitters scale=1", "point, spot, sun, rect or sky"),
            ("rect pos=0,0,0 dir=0,1,0 size=1,0 power=1", "no area"),
        ] {
            let error = of_light(text);
            assert!(error.contains(text) && error.contains(wanted), "{error}");
        }
        let error = parse_camera("eye=0,0,0 target=0,0,0").unwrap_err().to_string();
        assert!(error.contains("same point") && error.contains("fov=degrees"), "{error}");
    }
}
