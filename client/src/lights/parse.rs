//! `--camera` and `--light` as the command line writes them.

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};

use super::words::Words;
use crate::error::{ClientError, Result};

const CAMERA: &str = "eye=x,y,z target=x,y,z fov=degrees [up=x,y,z]";
const POINT: &str = "point pos=x,y,z color=r,g,b power=W";
const SPOT: &str =
    "spot pos=x,y,z target=x,y,z (or dir=x,y,z) color=r,g,b power=W inner=degrees outer=degrees";
const SUN: &str = "sun dir=x,y,z color=r,g,b irradiance=W/m2";
const SKY: &str = "sky zenith=r,g,b horizon=r,g,b strength=s";
/// Vertical field of view unless given, in degrees.
const FOV_DEG: f32 = 50.0;

/// Reads `eye=x,y,z target=x,y,z fov=deg`, lengths in metres, vertical field of view in degrees.
pub fn parse_camera(text: &str) -> Result<SceneCamera> {
    let mut words = Words::new(text, text.split_whitespace(), CAMERA)?;
    let eye = words.vector("eye")?;
    let eye = words.required("eye", eye)?;
    let target = words.vector("target")?;
    let target = words.required("target", target)?;
    let fov_deg = words.number_in("fov", 1.0, 170.0)?.unwrap_or(FOV_DEG);
    let Some(forward) = (target - eye).try_normalize() else {
        return Err(words.wrong("eye and target are the same point"));
    };
    let up = words.direction("up")?.unwrap_or_else(|| upright(forward));
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

/// Straight up, or the view's top when it looks straight up or down.
pub(super) fn upright(forward: Vec3) -> Vec3 {
    if forward.y.abs() > 0.999 { Vec3::NEG_Z } else { Vec3::Y }
}

/// Reads a light: `point`, `spot`, `sun` or `sky` and its words.
///
/// `power` P in watts is that of a lamp that shines all around, `I = color · P/4π`; a spot is such a lamp behind a
/// shade. `irradiance` is on a surface that faces the sun.
pub fn parse_light(text: &str) -> Result<SceneLight> {
    let mut words = text.split_whitespace();
    let kind = words.next().unwrap_or_default();
    match kind {
        "point" => point(Words::new(text, words, POINT)?),
        "spot" => spot(Words::new(text, words, SPOT)?),
        "sun" => sun(Words::new(text, words, SUN)?),
        "sky" => sky(Words::new(text, words, SKY)?),
        _ => Err(ClientError::Argument {
            what: format!("\"{text:.200}\""),
            problem: format!("'{kind}' is no kind of light; write \"{POINT}\", or spot, sun or sky"),
        }),
    }
}

fn named(kind: LightKind, strength: Vec3) -> SceneLight {
    SceneLight { name: "command line".to_owned(), kind, strength: strength.into() }
}

fn intensity(words: &mut Words<'_>) -> Result<Vec3> {
    let colour = words.colour("color")?;
    let power = words.number_in("power", 0.0, f32::MAX)?;
    Ok(colour * words.required("power", power)? / (4.0 * PI))
}

fn point(mut words: Words<'_>) -> Result<SceneLight> {
    let position = words.vector("pos")?;
    let position_m = words.required("pos", position)?.into();
    let strength = intensity(&mut words)?;
    words.end()?;
    Ok(named(LightKind::Point { position_m, range_m: None }, strength))
}

fn spot(mut words: Words<'_>) -> Result<SceneLight> {
    let position = words.vector("pos")?;
    let position = words.required("pos", position)?;
    let direction = match (words.direction("dir")?, words.vector("target")?) {
        (Some(_), Some(_)) => return Err(words.wrong("give 'dir' or 'target', not both")),
        (Some(direction), None) => direction,
        (None, Some(target)) => match (target - position).try_normalize() {
            Some(direction) => direction,
            None => return Err(words.wrong("pos and target are the same point")),
        },
        (None, None) => return Err(words.wrong("'target' (or 'dir') is missing")),
    };
    let strength = intensity(&mut words)?;
    let outer_deg = words.number_in("outer", 0.1, 89.0)?.unwrap_or(30.0);
    let inner_deg = words.number_in("inner", 0.0, 89.0)?.unwrap_or(0.8 * outer_deg);
    if inner_deg > outer_deg {
        return Err(words.wrong(format!("inner={inner_deg} is wider than outer={outer_deg}")));
    }
    words.end()?;
    let kind = LightKind::Spot {
        position_m: position.into(),
        direction: direction.into(),
        inner_rad: inner_deg.to_radians(),
        outer_rad: outer_deg.to_radians(),
        range_m: None,
    };
    Ok(named(kind, strength))
}

fn sun(mut words: Words<'_>) -> Result<SceneLight> {
    let direction = words.direction("dir")?;
    let direction = words.required("dir", direction)?.into();
    let colour = words.colour("color")?;
    let irradiance = words.number_in("irradiance", 0.0, f32::MAX)?;
    let irradiance = words.required("irradiance", irradiance)?;
    words.end()?;
    Ok(named(LightKind::Sun { direction }, colour * irradiance))
}

fn sky(mut words: Words<'_>) -> Result<SceneLight> {
    let zenith = words.colour("zenith")?.into();
    let horizon = words.colour("horizon")?.into();
    let strength = words.number_in("strength", 0.0, f32::MAX)?.unwrap_or(1.0);
    words.end()?;
    Ok(named(LightKind::Sky { zenith, horizon }, Vec3::splat(strength)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn point_power_becomes_radiant_intensity() {
        let light = parse_light("point pos=1,2,3 color=1,0.5,0 power=12.566371").unwrap();
        assert_eq!(light.kind, LightKind::Point { position_m: [1.0, 2.0, 3.0], range_m: None });
        assert!((light.strength[0] - 1.0).abs() < 1e-6 && (light.strength[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn every_kind_of_light_and_a_camera_are_read() {
        let texts = [
            "spot pos=0,2,0 target=0,0,0 power=100 inner=20 outer=30",
            "spot pos=0,2,0 dir=0,-1,0 power=100",
            "sun dir=0,-1,0 color=1,1,1 irradiance=3",
            "sky zenith=0.1,0.2,0.4 horizon=1,1,1 strength=2",
        ];
        for text in texts {
            parse_light(text).unwrap();
        }
        let camera = parse_camera("eye=0,1,5 target=0,1,0 fov=40").unwrap();
        assert!((camera.fov_y_rad - 40_f32.to_radians()).abs() < 1e-6);
    }

    #[test]
    fn errors_name_the_bad_word() {
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
            let error = parse_light(text).unwrap_err().to_string();
            assert!(error.contains(wanted), "{text}: {error}");
        }
        let error = parse_camera("eye=0,0,0 target=0,0,0").unwrap_err().to_string();
        assert!(error.contains("same point"), "{error}");
    }
}
