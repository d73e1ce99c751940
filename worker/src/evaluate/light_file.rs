//! `--lights FILE`: lights to measure with, as JSON.
//!
//! ```json
//! { "lights": [
//!   { "name": "lamp",   "type": "point", "position_m": [0, 2, 0], "strength": [10, 9, 8] },
//!   { "name": "beam",   "type": "spot", "position_m": [0, 2, 0], "direction": [0, -1, 0], "inner_deg": 15,
//!     "outer_deg": 25, "strength": [100, 100, 100] },
//!   { "name": "sun",    "type": "sun", "direction": [0.3, -1, 0.2], "strength": [10, 10, 10] },
//!   { "name": "sky",    "type": "sky", "zenith": [0.4, 0.8, 2], "horizon": [1, 0.8, 0.6] },
//!   { "name": "rect",   "type": "rect", "position_m": [0, 2, 0], "direction": [0, -1, 0], "size_m": [1, 0.5],
//!     "strength": [10, 10, 10] },
//!   { "name": "own",    "type": "emitters", "scale": 1 }
//! ] }
//! ```
//! The bake is measured under each light apart. Units: metres, degrees (half angles), W·sr⁻¹ (points, spots), W·m⁻² (suns),
//! W·m⁻²·sr⁻¹ (skies, rectangles). Directions are those of travel, of rectangles those of their fronts. The words of
//! `kiln preview --light` are good here as well (`lightkiln_proto::words`).

use std::collections::BTreeSet;

use lightkiln_proto::words::LightSpec;
use serde::Deserialize;
use serde_json::Value;

use super::error::EvaluationError;
use super::lights::TestLight;
use crate::reference::Lighting;

/// Most lights in a file.
const LIGHTS_MAX: usize = 64;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    lights: Vec<serde_json::Map<String, Value>>,
}

/// Reads a file of lights; every number is checked.
pub fn lights_of_file(json: &[u8]) -> Result<Vec<TestLight>, EvaluationError> {
    let wrong = |problem: String| EvaluationError::LightFile { problem };
    let file: File = serde_json::from_slice(json).map_err(|error| wrong(error.to_string()))?;
    if file.lights.is_empty() || file.lights.len() > LIGHTS_MAX {
        return Err(wrong(format!("it has {} lights, 1..={LIGHTS_MAX} are wanted", file.lights.len())));
    }
    let mut seen = BTreeSet::new();
    let mut lights = Vec::new();
    for (index, mut entry) in file.lights.into_iter().enumerate() {
        let name = match entry.remove("name") {
            Some(Value::String(name)) if !name.is_empty() => name,
            _ => return Err(wrong(format!("light {index} has no \"name\""))),
        };
        if !seen.insert(name.clone()) {
            return Err(wrong(format!("two lights have the name '{name}'")));
        }
        let light = LightSpec::from_json(&name, entry)
            .map_err(|error| wrong(format!("light '{name}': {}", error.problem)))?;
        let lighting = lighting(light);
        lighting.check()?;
        lights.push(TestLight { words: format!("'{name}' of the file of lights"), name, lighting });
    }
    Ok(lights)
}

fn lighting(light: LightSpec) -> Lighting {
    match light {
        LightSpec::Scene(light) => Lighting { lights: vec![light], ..Lighting::default() },
        LightSpec::Emitters(scale) => Lighting { emitter_scale: scale, ..Lighting::default() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_light_of_the_documented_example_is_read() {
        let text = include_str!("light_file.rs");
        let lines = text.lines().skip_while(|line| !line.contains("```json")).skip(1);
        let json: String = lines.take_while(|line| !line.contains("```")).map(|line| &line[3..]).collect();
        let lights = lights_of_file(json.as_bytes()).unwrap();
        let names: Vec<&str> = lights.iter().map(|light| light.name.as_str()).collect();
        assert_eq!(names, ["lamp", "beam", "sun", "sky", "rect", "own"]);
        assert_eq!(lights[5].lighting.emitter_scale, 1.0);
    }

    #[test]
    fn errors_name_the_light_and_what_is_wrong_with_it() {
        let light = |body: &str| format!("{{\"lights\": [{{\"name\": \"a\", {body}}}]}}");
        let cases = [
            ("{}".to_owned(), "lights"),
            ("{\"lights\": []}".to_owned(), "0 lights"),
            ("{\"lights\": [{\"type\": \"emitters\", \"scale\": 1}]}".to_owned(), "no \"name\""),
            (light("\"type\": \"laser\""), "laser"),
            (light("\"type\": \"emitters\", \"scale\": 1, \"size\": 2"), "size"),
            (light("\"type\": \"emitters\", \"scale\": 1e300"), "not finite"),
            (light("\"type\": \"sun\", \"direction\": [0,0,0], \"strength\": [1,1,1]"), "direction"),
            (light("\"type\": \"point\", \"position_m\": [0,0,NaN], \"strength\": [1,1,1]"), "expected"),
        ];
        for (json, wanted) in cases {
            let error = lights_of_file(json.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(wanted), "{json}: {error}");
        }
    }
}
