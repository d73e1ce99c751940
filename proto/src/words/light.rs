//! Lights. Lengths in metres, half angles in degrees, directions those of travel.
//!
//! Strength of a point or spot: `strength` in W·sr⁻¹, or `color` and `power` P in watts of a lamp that shines all around,
//! `I = color · P/4π`; a spot is such a lamp behind a shade. Of a sun: `strength` in W·m⁻² on a surface that faces it, or
//! `color` and `irradiance`. Of a rectangle: `strength` in W·m⁻²·sr⁻¹, `color` and `radiance`, or `color` and `power` P in
//! watts of all that leaves its front, `L = color · P/(π·w·h)`.

use core::f32::consts::PI;

use glam::Vec3;
use serde_json::{Map, Value};

use super::{Words, WordsError};
use crate::rectangle::{RECT_POINTS, RECT_POINTS_MAX, Rectangle, default_up};
use crate::scene::{LightKind, SceneLight};

const POINT: &str = "point pos=x,y,z color=r,g,b power=W";
const SPOT: &str =
    "spot pos=x,y,z target=x,y,z (or dir=x,y,z) color=r,g,b power=W inner=degrees outer=degrees";
const SUN: &str = "sun dir=x,y,z color=r,g,b irradiance=W/m2";
const SKY: &str = "sky zenith=r,g,b horizon=r,g,b strength=s";
const RECT: &str = "rect pos=x,y,z target=x,y,z (or dir=x,y,z) size=w,h color=r,g,b power=W (or radiance=W/m2/sr) up=x,y,z points=n";
const EMITTERS: &str = "emitters scale=s";

const POSITION: [&str; 2] = ["pos", "position_m"];
const DIRECTION: [&str; 2] = ["dir", "direction"];
/// Outer half angle of a spot unless given, in degrees.
const OUTER_DEG: f32 = 30.0;

/// A light as a person asks for it.
#[derive(Clone, Debug, PartialEq)]
pub enum LightSpec {
    /// A point, a spot, a sun, a rectangle or a sky.
    Scene(SceneLight),
    /// The scene's emissive surfaces, times a scale.
    Emitters(f32),
}

impl LightSpec {
    /// Reads `kind key=value …`.
    pub fn from_text(name: &str, text: &str) -> Result<Self, WordsError> {
        let mut words = text.split_whitespace();
        let (read, grammar) = kind(words.next().unwrap_or_default())?;
        finish(read, name, Words::from_text(words, grammar)?)
    }

    /// Reads `{"type": kind, key: value, …}`.
    pub fn from_json(name: &str, mut object: Map<String, Value>) -> Result<Self, WordsError> {
        let (read, grammar) =
            kind(object.remove("type").as_ref().and_then(Value::as_str).unwrap_or_default())?;
        finish(read, name, Words::from_json(&object, grammar)?)
    }
}

/// Words that [`LightSpec::from_text`] reads as that light, but for a cut-off distance, which has none.
pub fn light_to_text(light: &SceneLight) -> String {
    let three = |[x, y, z]: [f32; 3]| format!("{x},{y},{z}");
    let strength = three(light.strength);
    match &light.kind {
        LightKind::Point { position_m, .. } => {
            format!("point pos={} strength={strength}", three(*position_m))
        }
        LightKind::Spot { position_m, direction, inner_rad, outer_rad, .. } => {
            let (position, direction) = (three(*position_m), three(*direction));
            let degrees = |rad: f32| (100.0 * rad.to_degrees()).round() / 100.0;
            let outer = degrees(*outer_rad).clamp(0.1, 90.0);
            let inner = degrees(*inner_rad).clamp(0.0, outer);
            format!("spot pos={position} dir={direction} strength={strength} inner={inner} outer={outer}")
        }
        LightKind::Sun { direction } => format!("sun dir={} strength={strength}", three(*direction)),
        LightKind::Rect { position_m, direction, up, size_m: [width, height], points } => {
            let [position, direction, up] = [position_m, direction, up].map(|vector| three(*vector));
            let points = if *points == RECT_POINTS { String::new() } else { format!(" points={points}") };
            format!(
                "rect pos={position} dir={direction} up={up} size={width},{height} strength={strength}{points}"
            )
        }
        LightKind::Sky { zenith, horizon } => {
            let scaled = |colour: [f32; 3]| three((Vec3::from(colour) * Vec3::from(light.strength)).into());
            format!("sky zenith={} horizon={}", scaled(*zenith), scaled(*horizon))
        }
    }
}

type Read = fn(&str, &mut Words) -> Result<LightSpec, WordsError>;

fn kind(name: &str) -> Result<(Read, &'static str), WordsError> {
    match name {
        "point" => Ok((point, POINT)),
        "spot" => Ok((spot, SPOT)),
        "sun" => Ok((sun, SUN)),
        "sky" => Ok((sky, SKY)),
        "rect" => Ok((rect, RECT)),
        "emitters" => Ok((emitters, EMITTERS)),
        "panel" => {
            let problem = "'panel' is no kind of light: write rect, a rectangle that shines from its front";
            Err(WordsError { problem: problem.to_owned(), grammar: RECT })
        }
        _ => {
            let problem = format!(
                "'{name:.50}' is no kind of light, which are point, spot, sun, sky, rect and emitters"
            );
            Err(WordsError { problem, grammar: POINT })
        }
    }
}

fn finish(read: Read, name: &str, mut words: Words) -> Result<LightSpec, WordsError> {
    let light = read(name, &mut words)?;
    words.end()?;
    Ok(light)
}

fn scene(name: &str, kind: LightKind, strength: Vec3) -> Result<LightSpec, WordsError> {
    Ok(LightSpec::Scene(SceneLight { name: name.to_owned(), kind, strength: strength.into() }))
}

/// `strength`, or `color` times `key` times `unit`.
fn strength(words: &mut Words, key: &str, unit: f32) -> Result<Vec3, WordsError> {
    if let Some(strength) = words.colour("strength")? {
        return Ok(strength);
    }
    let colour = words.colour("color")?.unwrap_or(Vec3::ONE);
    let scale = words.number(&[key], 0.0, f32::MAX)?;
    Ok(colour * words.required(key, scale)? * unit)
}

fn position(words: &mut Words) -> Result<Vec3, WordsError> {
    let position = words.vector(&POSITION)?;
    words.required(POSITION[0], position)
}

fn point(name: &str, words: &mut Words) -> Result<LightSpec, WordsError> {
    let position_m = position(words)?.into();
    let strength = strength(words, "power", 1.0 / (4.0 * PI))?;
    scene(name, LightKind::Point { position_m, range_m: None }, strength)
}

/// Direction of travel: `dir`, or from the position to `target`.
fn aim(words: &mut Words, position: Vec3) -> Result<Vec3, WordsError> {
    match (words.direction(&DIRECTION)?, words.vector(&["target"])?) {
        (Some(_), Some(_)) => Err(words.wrong("give 'dir' or 'target', not both")),
        (Some(direction), None) => Ok(direction),
        (None, Some(target)) => (target - position)
            .try_normalize()
            .ok_or_else(|| words.wrong("pos and target are the same point")),
        (None, None) => Err(words.wrong("'target' (or 'dir') is missing")),
    }
}

fn spot(name: &str, words: &mut Words) -> Result<LightSpec, WordsError> {
    let position = position(words)?;
    let direction = aim(words, position)?;
    let strength = strength(words, "power", 1.0 / (4.0 * PI))?;
    let outer_deg = words.number(&["outer", "outer_deg"], 0.1, 90.0)?.unwrap_or(OUTER_DEG);
    let inner_deg = words.number(&["inner", "inner_deg"], 0.0, 90.0)?.unwrap_or(0.8 * outer_deg);
    if inner_deg > outer_deg {
        return Err(words.wrong(format!("inner={inner_deg} is wider than outer={outer_deg}")));
    }
    let kind = LightKind::Spot {
        position_m: position.into(),
        direction: direction.into(),
        inner_rad: inner_deg.to_radians(),
        outer_rad: outer_deg.to_radians(),
        range_m: None,
    };
    scene(name, kind, strength)
}

fn sun(name: &str, words: &mut Words) -> Result<LightSpec, WordsError> {
    let direction = words.direction(&DIRECTION)?;
    let direction = words.required(DIRECTION[0], direction)?.into();
    let strength = strength(words, "irradiance", 1.0)?;
    scene(name, LightKind::Sun { direction }, strength)
}

fn sky(name: &str, words: &mut Words) -> Result<LightSpec, WordsError> {
    let [zenith, horizon] =
        [words.colour("zenith")?, words.colour("horizon")?].map(|colour| colour.unwrap_or(Vec3::ONE).into());
    let strength = words.number(&["strength"], 0.0, f32::MAX)?.unwrap_or(1.0);
    scene(name, LightKind::Sky { zenith, horizon }, Vec3::splat(strength))
}

fn rect(name: &str, words: &mut Words) -> Result<LightSpec, WordsError> {
    let position = position(words)?;
    let direction = aim(words, position)?;
    let up = words.direction(&["up"])?.unwrap_or_else(|| default_up(direction));
    let size_m = words.pair(&["size", "size_m"])?;
    let size_m = words.required("size", size_m)?;
    let points = words.number(&["points"], 1.0, RECT_POINTS_MAX as f32)?.unwrap_or(RECT_POINTS as f32);
    if points.fract() != 0.0 {
        return Err(words.wrong(format!("points={points} is no whole number")));
    }
    let kind = LightKind::Rect {
        position_m: position.into(),
        direction: direction.into(),
        up: up.into(),
        size_m,
        points: points as u32,
    };
    let Some(area_m2) = Rectangle::of(&kind).map(|rectangle| rectangle.area_m2()) else {
        return Err(words.wrong(format!("size={},{} has no area", size_m[0], size_m[1])));
    };
    let has_power = words.has("power");
    let strength = match has_power {
        true => strength(words, "power", 1.0 / (PI * area_m2))?,
        false => strength(words, "radiance", 1.0)?,
    };
    scene(name, kind, strength)
}

fn emitters(_name: &str, words: &mut Words) -> Result<LightSpec, WordsError> {
    let scale = words.number(&["scale"], 0.0, f32::MAX)?;
    words.required("scale", scale).map(LightSpec::Emitters)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from_text(text: &str) -> Result<LightSpec, WordsError> {
        LightSpec::from_text("a", text)
    }

    fn from_json(json: &str) -> Result<LightSpec, WordsError> {
        LightSpec::from_json("a", serde_json::from_str(json).unwrap())
    }

    #[test]
    fn point_power_becomes_radiant_intensity() {
        let LightSpec::Scene(light) = from_text("point pos=1,2,3 color=1,0.5,0 power=12.566371").unwrap()
        else {
            panic!("a point is a light of a scene");
        };
        assert_eq!(light.kind, LightKind::Point { position_m: [1.0, 2.0, 3.0], range_m: None });
        assert!((light.strength[0] - 1.0).abs() < 1e-6 && (light.strength[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn light_is_read_back_from_its_words() {
        let texts = [
            "point pos=0,2,-0.125 strength=10,9,8",
            "spot pos=0,2,0 dir=0,-1,0 strength=1,2,3 inner=20 outer=30.25",
            "sun dir=0,-1,0 strength=3,2,1",
            "sky zenith=0.5,0.25,1 horizon=1,1,0.5",
            "rect pos=0,2,0 dir=0,-1,0 up=1,0,0 size=0.5,0.25 strength=3,2,1",
            "rect pos=0,2,0 dir=0,0,1 up=0,1,0 size=0.5,0.25 strength=3,2,1 points=9",
        ];
        for text in texts {
            let LightSpec::Scene(light) = from_text(text).unwrap() else { panic!("{text}") };
            assert_eq!(light_to_text(&light), text);
        }
        let LightSpec::Scene(sky) = from_text("sky zenith=0.5,0.25,1 strength=2").unwrap() else {
            panic!("a sky is a light of a scene");
        };
        assert_eq!(light_to_text(&sky), "sky zenith=1,0.5,2 horizon=2,2,2");
    }

    #[test]
    fn words_and_json_say_the_same_light() {
        let pairs = [
            (
                "point pos=0,2,0 strength=10,9,8",
                r#"{"type": "point", "position_m": [0, 2, 0], "strength": [10, 9, 8]}"#,
            ),
            (
                "spot pos=0,2,0 target=0,0,0 power=100 inner=20 outer=30",
                r#"{"type": "spot", "pos": [0, 2, 0], "dir": [0, -2, 0], "power": 100, "inner_deg": 20, "outer_deg": 30}"#,
            ),
            (
                "spot pos=0,2,0 dir=0,-1,0 power=100",
                r#"{"type": "spot", "position_m": [0, 2, 0], "direction": [0, -1, 0], "power": 100}"#,
            ),
            (
                "sun dir=0,-1,0 color=1,1,1 irradiance=3",
                r#"{"type": "sun", "direction": [0, -1, 0], "strength": [3, 3, 3]}"#,
            ),
            (
                "sky zenith=0.1,0.2,0.4 horizon=1,1,1",
                r#"{"type": "sky", "zenith": [0.1, 0.2, 0.4], "horizon": [1, 1, 1]}"#,
            ),
            (
                "rect pos=0,2,0 target=0,0,0 size=2,0.5 color=1,0.5,0 radiance=3",
                r#"{"type": "rect", "position_m": [0, 2, 0], "direction": [0, -1, 0], "up": [0, 0, -1],
                    "size_m": [2, 0.5], "strength": [3, 1.5, 0], "points": 4}"#,
            ),
            ("emitters scale=2", r#"{"type": "emitters", "scale": 2}"#),
        ];
        for (text, json) in pairs {
            assert_eq!(from_text(text).unwrap(), from_json(json).unwrap(), "{text}");
        }
    }

    #[test]
    fn errors_name_the_bad_word_as_it_was_given() {
        let error = from_json(r#"{"type": "sun", "direction": [0, 0, 0], "irradiance": 1}"#).unwrap_err();
        assert!(error.problem.contains("'direction'"), "{error}");
        let error = from_json(r#"{"type": "panel", "size": [1, 1], "radiance": 1}"#).unwrap_err();
        assert!(error.problem.contains("write rect"), "{error}");
        let cases = [
            ("lamp pos=0,0,0", "'lamp'"),
            ("point pos=0,0 power=1", "'pos=0,0'"),
            ("point pos=0,0,0", "'power' is missing"),
            ("point pos=0,0,x power=1", "'x'"),
            ("point pos=0,0,0 power=-1", "power=-1"),
            ("point pos=0,0,0 power=nan", "'nan'"),
            ("point pos=0,0,0 power=1 size=3", "unknown word 'size'"),
            ("point pos=0,0,0 pos=0,0,0 power=1", "'pos' is given twice"),
            ("sun dir=0,0,0 irradiance=1", "'dir' has no length"),
            ("spot pos=0,0,0 target=0,1,0 power=1 inner=50 outer=20", "wider"),
        ];
        for (text, wanted) in cases {
            let error = from_text(text).unwrap_err().to_string();
            assert!(error.contains(wanted), "{text}: {error}");
        }
    }
}
