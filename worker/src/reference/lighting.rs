//! Lights on a scene, as a caller says them.

use std::sync::Arc;

use lightkiln_proto::rectangle::{RECT_POINTS_MAX, Rectangle};
use lightkiln_proto::relight::Panorama;
use lightkiln_proto::scene::{LightKind, SceneLight};
use thiserror::Error;

/// All light on a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lighting {
    /// Points, spots, suns, rectangles and skies; skies add up.
    pub lights: Vec<SceneLight>,
    /// A panorama as a sky, on top of the others.
    pub panorama: Option<Arc<Panorama>>,
    /// Strength of the scene's emissive surfaces relative to the file; 0 switches them off.
    pub emitter_scale: f32,
}

/// A light that cannot be traced.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("light '{light}': {problem}")]
pub struct LightingError {
    /// The light's name.
    pub light: String,
    /// Fault and remedy.
    pub problem: String,
}

impl LightingError {
    /// An error of that light.
    pub fn new(light: &str, problem: impl Into<String>) -> Self {
        Self { light: light.to_owned(), problem: problem.into() }
    }
}

impl Lighting {
    /// Errors with the first light whose numbers make no sense.
    pub fn check(&self) -> Result<(), LightingError> {
        self.lights.iter().try_for_each(check_light)?;
        if !(self.emitter_scale.is_finite() && self.emitter_scale >= 0.0) {
            return Err(LightingError::new("emitters", "the scale is negative or not finite"));
        }
        Ok(())
    }
}

fn check_light(light: &SceneLight) -> Result<(), LightingError> {
    let wrong = |problem: &str| Err(LightingError::new(&light.name, problem));
    if !is_strength(light.strength) {
        return wrong("the strength has a number that is negative or not finite");
    }
    match &light.kind {
        LightKind::Point { position_m, range_m } | LightKind::Spot { position_m, range_m, .. }
            if !is_finite(*position_m)
                || range_m.is_some_and(|range| !(range > 0.0 && range.is_finite())) =>
        {
            wrong("the position is not finite, or the range is no length above 0")
        }
        LightKind::Spot { direction, .. } | LightKind::Sun { direction } if !is_direction(*direction) => {
            wrong("the direction has no length or is not finite")
        }
        LightKind::Spot { inner_rad, outer_rad, .. }
            if !(0.0 <= *inner_rad
                && inner_rad <= outer_rad
                && *outer_rad <= std::f32::consts::FRAC_PI_2) =>
        {
            wrong("the cone needs 0 ≤ inner ≤ outer ≤ 90°")
        }
        LightKind::Rect { position_m, .. }
            if !is_finite(*position_m) || Rectangle::of(&light.kind).is_none() =>
        {
            wrong("the position or the direction is not finite, or a side is no length above 0")
        }
        LightKind::Rect { points, .. } if !(1..=RECT_POINTS_MAX).contains(points) => {
            wrong("the points that shadows are cast from are not 1 to 16")
        }
        LightKind::Sky { zenith, horizon } if !is_strength(*zenith) || !is_strength(*horizon) => {
            wrong("a colour of the sky is negative or not finite")
        }
        _ => Ok(()),
    }
}

fn is_finite(vector: [f32; 3]) -> bool {
    vector.iter().all(|axis| axis.is_finite())
}

fn is_direction(vector: [f32; 3]) -> bool {
    glam::Vec3::from(vector).try_normalize().is_some()
}

fn is_strength(colour: [f32; 3]) -> bool {
    colour.iter().all(|channel| channel.is_finite() && *channel >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_make_no_sense_are_refused_by_the_lights_name() {
        let light = |kind, strength| SceneLight { name: "lamp".into(), kind, strength };
        let point = |position_m, range_m| LightKind::Point { position_m, range_m };
        let rect = |direction, size_m, points| {
            let (position_m, up) = ([0.0; 3], [0.0, 0.0, 1.0]);
            light(LightKind::Rect { position_m, direction, up, size_m, points }, [1.0; 3])
        };
        let down = [0.0, -1.0, 0.0];
        let of_light = |light| Lighting { lights: vec![light], ..Lighting::default() };
        let nan = f32::NAN;
        let bad = [
            of_light(light(point([0.0, nan, 0.0], None), [1.0; 3])),
            of_light(light(point([0.0; 3], Some(-1.0)), [1.0; 3])),
            of_light(light(point([0.0; 3], None), [f32::INFINITY, 0.0, 0.0])),
            of_light(light(LightKind::Sun { direction: [0.0; 3] }, [1.0; 3])),
            of_light(light(LightKind::Sky { zenith: [-1.0; 3], horizon: [0.0; 3] }, [1.0; 3])),
            of_light(rect([0.0; 3], [1.0; 2], 4)),
            of_light(rect(down, [1.0, 0.0], 4)),
            of_light(rect(down, [nan, 1.0], 4)),
            of_light(rect(down, [1.0; 2], 17)),
        ];
        for lighting in bad {
            assert_eq!(lighting.check().unwrap_err().light, "lamp");
        }
        assert!(of_light(rect(down, [1.0, 0.5], 4)).check().is_ok());
        assert!(of_light(light(point([0.0; 3], None), [1.0; 3])).check().is_ok());
        assert!(Lighting { emitter_scale: nan, ..Lighting::default() }.check().is_err());
    }
}
